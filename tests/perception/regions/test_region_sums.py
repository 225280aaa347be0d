from dataclasses import fields, replace
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hickory_stream.geometry.camera import Camera
from hickory_stream.perception.regions.contacts import Contacts, support_contacts_of
from hickory_stream.perception.regions.features import Features, joined, of_both
from hickory_stream.perception.regions.ordered_pairs import pair_geometry
from hickory_stream.perception.regions.region_graph import RegionPairs, Regions
from hickory_stream.perception.regions.region_sums import region_sums
from hickory_stream.perception.surface import Surface
from tests.strategies import seeds

BIN_M = 0.01


@given(seeds, st.integers(1, 6))
@settings(max_examples=25)
def test_the_sums_are_those_over_the_pixels_of_each_part(seed, count):
    rng = np.random.default_rng(seed)
    shape = (12, 17)
    labels = rng.integers(0, count + 1, shape).astype(np.int32)
    labels[0, 0] = count
    supports = rng.integers(0, 3, shape).astype(np.int32)
    points, normals = rng.normal(size=(2, *shape, 3)).astype(np.float32)
    normals[3] = np.nan
    areas, depth = np.abs(rng.normal(size=(2, *shape))).astype(np.float32)
    lab = rng.normal(size=(*shape, 3)).astype(np.float32)
    surface = Surface(
        factor=1, camera=Camera(width=17, height=12, fx=10.0, fy=10.0, cx=8.0, cy=6.0), depth_m=depth,
        points_world=points, normals_world=normals, lab=lab, sigma_m=depth, world_from_camera=np.eye(4),
    )  # fmt: skip
    sums, middle, bottom_m = region_sums(surface, labels, supports, areas, BIN_M)
    place = points.astype(np.float64) - middle
    bins = ((points[..., 2].astype(np.float64) - bottom_m) / BIN_M).astype(np.int64)
    assert np.allclose(middle, points[labels > 0].mean(axis=0, dtype=np.float64))
    assert bottom_m == points[labels > 0, 2].min()
    for i in range(1, count + 1):
        own = labels == i
        assert sums.pixels[i] == own.sum()
        if not own.any():
            continue
        assert np.allclose([sums.area_m2[i], sums.depth_m[i]], [areas[own].sum(), depth[own].sum()], rtol=1e-5)
        assert np.isclose(sums.sigma_m[i], depth[own].sum(), rtol=1e-5)
        beside = own[:, 1:] & own[:, :-1]
        light, green, blue = (lab[:, 1:] - lab[:, :-1])[beside].T.astype(np.float64)
        grain = np.sqrt(0.25 * light**2 + green**2 + blue**2).sum()
        assert np.allclose(sums.grain[i], [grain, beside.sum()], rtol=1e-5)
        assert np.allclose(sums.lab[i], lab[own].sum(axis=0), atol=1e-4)
        assert np.allclose(sums.lab_squares[i], (lab[own] ** 2).sum(axis=0), rtol=1e-5)
        assert np.allclose(sums.place[i], place[own].sum(axis=0))
        assert np.allclose(sums.place_products[i], (place[own].T @ place[own])[np.triu_indices(3)])
        assert np.allclose(sums.normals[i], np.nansum(normals[own], axis=0), atol=1e-5)
        assert np.array_equal(sums.planes[i], np.bincount(supports[own], minlength=sums.planes.shape[1]))
        assert np.array_equal(sums.heights[i], np.bincount(bins[own], minlength=sums.heights.shape[1]))
        assert np.array_equal([sums.low[i], sums.high[i]], [points[own].min(axis=0), points[own].max(axis=0)])
    assert sums.pixels[0] == 0


def test_columns_have_names_and_may_be_taken_in_any_order():
    features = joined(
        Features(("near", "far"), np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])),
        Features(("apart",), np.array([[7.0], [8.0], [9.0]])),
    )
    assert {name: column.tolist() for name, column in features.items()} == {
        "near": [1, 3, 5],
        "far": [2, 4, 6],
        "apart": [7, 8, 9],
    }
    assert features.rows_of(("apart", "near")).tolist() == [[7, 1], [8, 3], [9, 5]]
    with pytest.raises(KeyError):
        features.rows_of(("near", "nowhere"))


def test_features_of_a_pair_are_those_of_larger_and_smaller_part():
    both = of_both(("size",), np.array([[0.0], [10.0], [20.0]]), np.array([1, 2]), np.array([0, 1]))
    assert both["large_size"].tolist() == [10, 20]
    assert both["small_size"].tolist() == [0, 10]


LARGE, SMALL = np.array([0]), np.array([1])
# A table 1.2 m wide of four pixels and a box 0.2 m wide of two on its right end, which it touches with two pixels.
REGIONS = replace(
    Regions(**{field.name: np.zeros(2) for field in fields(Regions)}), pixels=np.array([4.0, 2.0]),
    place=np.array([[0.0, 4.0, 2.0], [1.0, 2.0, 1.6]]), low=np.array([[-0.6, 0.5, 0.4], [0.4, 0.9, 0.6]]),
    high=np.array([[0.6, 1.5, 0.6], [0.6, 1.1, 1.0]]),
)  # fmt: skip
PAIRS = replace(
    RegionPairs(**{field.name: np.zeros(1) for field in fields(RegionPairs)}), touch=np.array([2.0]),
    contact=np.array([[1.0, 1.8, 1.2]]), contact_squares=np.array([[0.5, 1.64, 0.72]]),
)  # fmt: skip


def test_a_pair_is_measured_from_either_part():
    found, turned = pair_geometry(REGIONS, PAIRS, LARGE, SMALL), pair_geometry(REGIONS, PAIRS, SMALL, LARGE)
    np.testing.assert_allclose(found.aside_m, [[0.5, 0.0, 0.3]])
    np.testing.assert_allclose(found.overlap_m, [[0.2, 0.2, 0.0]], atol=1e-12)
    np.testing.assert_allclose(found.inset_m, [[0.0, 0.4, -0.4]], atol=1e-12)
    np.testing.assert_allclose(found.contact_m, [[0.5, 0.9, 0.6]])
    np.testing.assert_allclose(found.contact_spread_m, [[0.0, 0.1, 0.0]], atol=1e-7)
    np.testing.assert_array_equal(turned.aside_m, -found.aside_m)
    np.testing.assert_array_equal(turned.overlap_m, found.overlap_m)


def test_parts_without_contact_or_pixels_give_numbers():
    apart, empty = replace(PAIRS, touch=np.zeros(1)), replace(REGIONS, pixels=np.zeros(2))
    found = pair_geometry(empty, apart, LARGE, SMALL)
    assert all(np.isfinite(getattr(found, field.name)).all() for field in fields(found))


FOOT = 0.35


@given(seeds, st.integers(0, 60), st.integers(1, 5))
def test_the_carrier_is_counted_below_the_outline_of_the_foot(seed, num_contacts, count):
    rng = np.random.default_rng(seed)
    shape = (8, 9)
    heights, level = rng.random(shape).astype(np.float32), rng.random(shape) < 0.5
    pieces = np.append(rng.permutation(count), count)
    here, there, cut = (rng.integers(0, count + 1, n).astype(np.int32) for n in (num_contacts, num_contacts, 12))
    here_px, there_px, cut_px = (rng.integers(0, heights.size, n) for n in (num_contacts, num_contacts, 12))
    is_below, touches, nearer = rng.random((3, num_contacts)) < 0.6
    contacts = Contacts(
        here=here, there=there, here_px=here_px, there_px=there_px, is_below=is_below, touches=touches, nearer=nearer,
        cut=cut, cut_px=cut_px,
    )  # fmt: skip
    support = support_contacts_of(contacts, pieces, heights, level)
    z, flat = heights.ravel(), level.ravel()
    for piece in range(count):
        outer = is_below & (pieces[here] == piece) & (pieces[there] != piece)
        edge = pieces[cut] == piece
        outline = np.concatenate([z[here_px[outer]], z[cut_px[edge]]]).astype(np.float64)
        foot = (1 - FOOT) * outline.min() + FOOT * outline.max() if len(outline) else 0.0
        at_foot = outer & (z[here_px] <= foot)
        assert support.outline[piece] == at_foot.sum() + (z[cut_px[edge]] <= foot).sum()
        assert support.free[piece] == (at_foot & ~touches & ~nearer).sum()
        on = pieces[there[at_foot & touches & flat[there_px]]]
        assert np.array_equal(support.on[piece], np.bincount(on, minlength=count + 1))
