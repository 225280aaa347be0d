from dataclasses import replace
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.geometry.voxels import contains, keys_of_points
from hickory_stream.perception.structure import detection
from hickory_stream.perception.structure.detection import pixel_areas_m2
from hickory_stream.perception.structure.room_structure import _in_voxels
from hickory_stream.perception.surface import SurfaceConfig, surface_of
from tests.perception.perception_scenes import CAMERA, Block, floor, looking, render
from tests.strategies import seeds


def numbers(seed, *shape):
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


@given(seeds)
def test_a_wall_is_what_is_near_it_and_faces_as_it_does(seed):
    distance, facing, tolerance = numbers(seed, 7, 9), numbers(seed + 2, 7, 9), np.abs(numbers(seed + 3, 7, 9))
    distance[0, 0] = facing[0, 1] = np.nan
    for is_end in (True, False):
        away = distance if is_end else np.abs(distance)
        expected = (away < 1.5 * tolerance) & ((facing > 0.8) | (away < 0.6 * tolerance))
        assert np.array_equal(detection._on_wall(distance, facing, tolerance, is_end=is_end), expected)


@given(seeds, st.integers(1, 60))
def test_upright_pixels_have_an_area_and_a_level_normal(seed, count):
    normals, areas = numbers(seed, count, 3), np.maximum(numbers(seed + 2, count), 0)
    points, sigma = numbers(seed + 3, count, 3), np.abs(numbers(seed + 4, count))
    normals[::7] = np.nan
    upright = (areas > 0) & (np.abs(normals[:, 2]) < 0.2)
    found = detection._upright(points, normals, sigma, areas)
    assert np.array_equal(found.pixels, np.flatnonzero(upright))
    length = np.linalg.norm(normals[upright, :2], axis=1, keepdims=True)
    assert np.array_equal(found.direction, normals[upright, :2] / length)
    assert np.array_equal(found.at, points[upright])
    assert np.array_equal(found.sigma, sigma[upright])
    assert np.array_equal(found.weight, areas[upright].astype(np.float64))
    few = found.among(found.at[:, 0] > 0)
    assert np.array_equal(few.at, points[upright & (points[:, 0] > 0)])
    assert np.array_equal(few.azimuths, found.azimuths[found.at[:, 0] > 0])


def test_areas_are_flat_ones_over_the_slant():
    view = looking((0.0, 0.0, 0.3), start=(-2.2, -0.3, 1.5))
    frame, _ = render([floor(), Block(low=(-0.3, -0.3, 0.0), high=(0.3, 0.3, 0.5), color=(190, 40, 40))], view)
    near = np.where(frame.depth_m < 6.0, frame.depth_m, np.nan)
    surface = surface_of(replace(frame, depth_m=near), SurfaceConfig(width_px=CAMERA.width))
    rays = surface.points_world - surface.world_from_camera[:3, 3].astype(np.float32)
    cosine = np.abs(np.einsum("ijk,ijk->ij", rays, surface.normals_world)) / np.linalg.norm(rays, axis=2)
    flat = surface.depth_m**2 / (CAMERA.fx * CAMERA.fy)
    expected = np.nan_to_num(flat / np.maximum(cosine, np.float32(0.15)))
    areas = pixel_areas_m2(surface)
    assert np.allclose(areas, expected, rtol=1e-6)
    assert (areas == 0).sum() == np.isnan(cosine).sum() > 0


@given(seeds, st.integers(1, 60), st.sampled_from([2, 3]))
def test_along_is_an_inner_product_and_azimuths_split_evenly(seed, count, columns):
    rows, angle = numbers(seed, count, columns), seed % 360 / 57.3
    direction = np.array([np.cos(angle), np.sin(angle)], dtype=np.float32)
    assert np.allclose(detection._along(rows, direction), rows[:, :2] @ direction, atol=1e-6)
    middles = (detection._bins_of_azimuth(rows, 12) + 0.5) / 12 * 2 * np.pi - np.pi
    towards = rows[:, 0] * np.cos(middles) + rows[:, 1] * np.sin(middles)
    assert (towards >= np.linalg.norm(rows[:, :2], axis=1) * np.cos(np.pi / 12) - 1e-6).all()


@given(seeds, st.integers(2, 60))
def test_the_spread_is_the_weighted_covariance(seed, count):
    at, weight = numbers(seed, count, 2), np.abs(numbers(seed + 2, count)).astype(np.float64) + 0.1
    middle, spread = detection._spread(at, weight / weight.sum())
    assert np.allclose(middle, np.average(at, axis=0, weights=weight))
    assert np.allclose(spread, np.cov(at.T, aweights=weight, ddof=0), atol=1e-9)


@given(seeds)
def test_points_lie_in_known_structure_where_voxels_are_known(seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.3, 0.3, (9, 11, 3)).astype(np.float32)
    points[::2] = np.round(points[::2], 1)  # neighbours in one voxel, too
    points[4, 3:7] = np.nan
    known = np.unique(keys_of_points(rng.uniform(-0.3, 0.3, (120, 3)), 0.1))
    seen = np.isfinite(points[..., 2])
    expected = np.zeros(seen.shape, dtype=bool)
    expected[seen] = contains(known, keys_of_points(points[seen], 0.1))
    assert np.array_equal(_in_voxels(points, known, 0.1), expected)
