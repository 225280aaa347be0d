from dataclasses import fields, replace
import numpy as np
from hickory_stream.perception.regions.ordered_pairs import pair_geometry
from hickory_stream.perception.regions.region_graph import RegionPairs, Regions

LARGE, SMALL = np.array([0]), np.array([1])
# A table 1.2 m wide of four pixels and a box 0.2 m wide of two on its right end, which it touches with two pixels.
REGIONS = replace(
    Regions(**{field.name: np.zeros(2) for field in fields(Regions)}),
    pixels=np.array([4.0, 2.0]),
    place=np.array([[0.0, 4.0, 2.0], [1.0, 2.0, 1.6]]),
    low=np.array([[-0.6, 0.5, 0.4], [0.4, 0.9, 0.6]]),
    high=np.array([[0.6, 1.5, 0.6], [0.6, 1.1, 1.0]]),
)
PAIRS = replace(
    RegionPairs(**{field.name: np.zeros(1) for field in fields(RegionPairs)}),
    touch=np.array([2.0]),
    contact=np.array([[1.0, 1.8, 1.2]]),
    contact_squares=np.array([[0.5, 1.64, 0.72]]),
)


def test_the_small_part_beside_the_large_one_is_measured():
    found = pair_geometry(REGIONS, PAIRS, LARGE, SMALL)
    np.testing.assert_allclose(found.aside_m, [[0.5, 0.0, 0.3]])
    np.testing.assert_allclose(found.overlap_m, [[0.2, 0.2, 0.0]], atol=1e-12)
    np.testing.assert_allclose(found.inset_m, [[0.0, 0.4, -0.4]], atol=1e-12)


def test_a_contact_has_the_mean_and_the_spread_of_its_pixels():
    found = pair_geometry(REGIONS, PAIRS, LARGE, SMALL)
    np.testing.assert_allclose(found.contact_m, [[0.5, 0.9, 0.6]])
    np.testing.assert_allclose(found.contact_spread_m, [[0.0, 0.1, 0.0]], atol=1e-7)


def test_seen_from_the_small_part_it_is_the_other_way_round():
    found, turned = pair_geometry(REGIONS, PAIRS, LARGE, SMALL), pair_geometry(REGIONS, PAIRS, SMALL, LARGE)
    np.testing.assert_array_equal(turned.aside_m, -found.aside_m)
    np.testing.assert_array_equal(turned.overlap_m, found.overlap_m)


def test_parts_without_contact_or_pixels_give_numbers():
    apart, empty = replace(PAIRS, touch=np.zeros(1)), replace(REGIONS, pixels=np.zeros(2))
    found = pair_geometry(empty, apart, LARGE, SMALL)
    assert all(np.isfinite(getattr(found, field.name)).all() for field in fields(found))
