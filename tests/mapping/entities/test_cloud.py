import math
from dataclasses import replace
from functools import reduce
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hickory_stream.geometry.lattice import STEPS_PER_M, on_steps, packed_points, points_of
from hickory_stream.geometry.voxels import cells_of_keys, keys_of_cells, keys_of_points
from hickory_stream.mapping.entities.cloud import (
    NAMES,
    Cloud,
    cloud_of,
    fuse,
    is_near,
    is_packed,
    pack,
    pack_part,
    share_near,
    solid_part,
    without,
)
from tests.strategies import frame_clouds, integer_cells, seeds

VOXEL_M = 0.01
STEP_M = 1 / STEPS_PER_M
"""A fused mean is off by half of it at most."""


def assert_same(a, b):
    assert np.array_equal(a.keys, b.keys)
    assert np.array_equal(a.hits, b.hits)
    assert np.allclose(a.points, b.points, atol=2 * STEP_M + 1e-6)
    assert np.allclose(a.colors, b.colors, atol=1e-3)


def cells_cloud(cells):
    keys = np.unique(keys_of_cells(cells))
    points = np.zeros((len(keys), 3), dtype=np.float32)
    return Cloud(keys=keys, points=points, colors=points, hits=np.ones(len(keys), dtype=np.int32))


@given(frame_clouds(), frame_clouds(), frame_clouds())
def test_fusing_is_commutative_and_associative(a, b, c):
    assert_same(fuse(a, b), fuse(b, a))
    assert_same(fuse(fuse(a, b), c), fuse(a, fuse(b, c)))


@given(frame_clouds(), frame_clouds())
def test_a_fused_cloud_has_the_voxels_and_the_hits_of_both(a, b):
    fused = fuse(a, b)
    hits = {int(key): 0 for key in [*a.keys, *b.keys]}
    for cloud in (a, b):
        for key, count in zip(cloud.keys, cloud.hits, strict=True):
            hits[int(key)] += int(count)
    assert dict(zip(fused.keys.tolist(), fused.hits.tolist(), strict=True)) == hits
    assert (np.diff(fused.keys) > 0).all()


@given(seeds, st.integers(1, 6))
def test_a_voxels_point_and_colour_are_the_means_over_its_frames(seed, num_frames):
    rng = np.random.default_rng(seed)
    frames = [rng.uniform(0, VOXEL_M, (1, 3)).astype(np.float32) for _ in range(num_frames)]
    colors = [rng.integers(0, 256, (1, 3), dtype=np.uint8) for _ in range(num_frames)]
    fused = reduce(fuse, [cloud_of(p, c, VOXEL_M) for p, c in zip(frames, colors, strict=True)])
    assert fused.hits.tolist() == [num_frames]
    assert np.allclose(fused.points[0], np.mean(frames, axis=(0, 1)), atol=0.5 * num_frames * STEP_M + 1e-6)
    assert np.allclose(fused.colors[0], np.mean(colors, axis=(0, 1)), atol=1e-3)


@given(seeds, st.integers(1, 6), st.integers(-20_000, 20_000))
def test_means_of_points_at_steps_are_at_steps_in_the_same_voxel(seed, num_frames, cell):
    rng = np.random.default_rng(seed)
    steps = range(math.ceil(cell * VOXEL_M * STEPS_PER_M) + 1, math.floor((cell + 1) * VOXEL_M * STEPS_PER_M))
    frames = [points_of(rng.integers(steps.start, steps.stop, (1, 3)).astype(np.int32)) for _ in range(num_frames)]
    gray = np.zeros((1, 3), dtype=np.uint8)
    fused = reduce(fuse, [cloud_of(points, gray, VOXEL_M) for points in frames])
    assert packed_points(fused.points) is not None
    assert np.array_equal(keys_of_points(fused.points, VOXEL_M), fused.keys)
    assert len(fused.keys) == 1


@given(seeds)
def test_one_frame_hits_a_voxel_once(seed):
    points = np.random.default_rng(seed).uniform(0, 2 * VOXEL_M, (300, 3)).astype(np.float32)
    cloud = cloud_of(points, np.zeros((300, 3), dtype=np.uint8), VOXEL_M)
    assert np.array_equal(cloud.keys, np.unique(keys_of_points(points, VOXEL_M)))
    assert (cloud.hits == 1).all()


@given(frame_clouds(), seeds)
def test_dropping_voxels_leaves_the_others_as_they_were(cloud, seed):
    drop = np.random.default_rng(seed).random(len(cloud.keys)) > 0.5
    left = without(cloud, drop)
    assert np.array_equal(left.keys, cloud.keys[~drop])
    assert np.array_equal(left.points, cloud.points[~drop])


@given(integer_cells(largest=5, max_size=25), integer_cells(largest=6, max_size=25))
def test_near_is_what_a_search_of_all_27_cells_finds(cells, queries):
    expected = [bool((np.abs(cells - query).max(axis=1) <= 1).any()) if len(cells) else False for query in queries]
    assert is_near(keys_of_cells(queries), cells_cloud(cells)).tolist() == expected


def test_shares_near_count_all_of_few_voxels_and_sample_many():
    cloud = cells_cloud(np.array([[0, 0, 0]]))
    queries = keys_of_cells(np.array([[0, 0, 0], [1, 1, 1], [2, 0, 0], [9, 9, 9]]))
    assert share_near(queries, cloud) == pytest.approx(0.5)
    assert share_near(queries[:0], cloud) == 0.0
    cells = np.unique(np.random.default_rng(8).integers(0, 60, (6000, 3)), axis=0)
    cloud = cells_cloud(cells[cells[:, 0] < 30])
    keys = np.unique(keys_of_cells(cells))
    assert share_near(keys, cloud) == pytest.approx(is_near(keys, cloud).mean(), abs=0.05)


def with_hits(hits):
    cloud = cells_cloud(np.array([[i, 0, 0] for i in range(len(hits))]))
    return Cloud(keys=cloud.keys, points=cloud.points, colors=cloud.colors, hits=np.array(hits, dtype=np.int32))


@pytest.mark.parametrize(
    ("sightings", "hits", "kept"),
    [
        (3, [1, 1, 3, 3, 3], 5), (4, [1, 1, 3, 3, 3], 3), (11, [1, 2, 3, 3, 3], 4), (12, [1, 2, 3, 3, 3], 3),
        (12, [1, 1, 2, 3, 3], 5),
    ],
    ids=[
        "young: all", "seen again: what one frame saw goes", "still two are enough", "seen often: three",
        "far: more than half would go",
    ],
)  # fmt: skip
def test_the_solid_part_is_what_was_seen_again_unless_little(sightings, hits, kept):
    assert len(solid_part(with_hits(hits), sightings).keys) == kept


@pytest.mark.parametrize(
    ("tail_cells", "sightings", "is_cut"),
    [
        (100, 20, True),
        # Young: what was seen once may be all there is.
        (100, 4, False),
        # Beside it, not beyond: a side that has just come into view.
        (30, 20, False),
    ],
)
def test_a_far_tail_of_one_frame_is_not_solid(tail_cells, sightings, is_cut):
    sheet = np.stack(np.meshgrid(np.arange(40), np.arange(40), [0]), axis=-1).reshape(-1, 3)
    wall = np.stack(np.meshgrid([0], np.arange(40), np.arange(20)), axis=-1).reshape(-1, 3)
    tail = np.stack(np.meshgrid(40 + np.arange(tail_cells), np.arange(8), [0]), axis=-1).reshape(-1, 3)
    points = ((np.concatenate([sheet, wall, tail]) + 0.5) * VOXEL_M).astype(np.float32)
    cloud = cloud_of(points, np.zeros((len(points), 3), np.uint8), VOXEL_M)
    x = cells_of_keys(cloud.keys)[:, 0]
    again = (np.arange(len(x)) % 3 == 0) & (x < 40)
    cloud = replace(cloud, hits=np.where(again, 5, 1).astype(np.int32))
    kept = cells_of_keys(solid_part(cloud, sightings).keys)[:, 0]
    assert kept.max() == (39 if is_cut else 39 + tail_cells)
    assert (kept < 40).sum() == (x < 40).sum()


@given(seeds)
def test_points_that_are_one_per_voxel_already_are_the_cloud(seed):
    rng = np.random.default_rng(seed)
    keys = np.unique(keys_of_cells(rng.integers(-5, 5, (60, 3))))
    points = (cells_of_keys(keys) + rng.uniform(0.1, 0.9, (len(keys), 3))) * VOXEL_M
    points = on_steps(points.astype(np.float32))
    colors = rng.integers(0, 256, (len(keys), 3)).astype(np.uint8)
    order = rng.permutation(len(keys))
    for cloud in (cloud_of(points, colors, VOXEL_M), cloud_of(points[order], colors[order], VOXEL_M)):
        assert np.array_equal(cloud.keys, keys)
        assert np.array_equal(cloud.points, points)
        assert np.array_equal(cloud.colors, colors.astype(np.float32))


def random_cloud(steps, seed):
    count, rng = len(steps), np.random.default_rng(seed)
    return Cloud(
        keys=np.cumsum(steps, dtype=np.int64) - (1 << 40), points=rng.normal(size=(count, 3)).astype(np.float32),
        colors=rng.uniform(0, 255, (count, 3)).astype(np.float32), hits=rng.integers(1, 9, count).astype(np.int32),
    )  # fmt: skip


def bytes_of(cloud):
    return [(array.dtype.str, array.shape, array.tobytes()) for array in [getattr(cloud, name) for name in NAMES]]


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(1, 1 << 45), min_size=1, max_size=20), st.integers(0, 5), st.booleans())
def test_a_cloud_and_a_part_of_it_come_back_to_the_byte(steps, seed, is_other):
    whole = random_cloud(steps, seed)
    part = random_cloud(steps, seed + 1) if is_other else without(whole, whole.hits < 4)
    before, counts = (bytes_of(whole), bytes_of(part)), (len(whole), len(part))
    pack_part(part, whole)
    pack_part(part, whole)
    assert is_packed(whole)
    assert is_packed(part)
    assert (len(whole), len(part)) == counts
    assert is_packed(whole)
    # A part does not wake the whole that it is made from.
    assert bytes_of(part) == before[1]
    assert is_packed(whole)
    assert not is_packed(part)
    assert bytes_of(whole) == before[0]
    pack(whole)
    assert bytes_of(whole) == before[0]


def test_earlier_packed_clouds_are_released_without_compressing():
    cloud, kept = random_cloud([1, 2, 3], 0), list[bytes]()
    before = bytes_of(cloud)

    def keep(data):
        kept.append(data)
        return lambda: data

    pack(cloud, keep)
    assert bytes_of(cloud) == before
    assert not is_packed(cloud)
    pack(cloud, keep)
    assert is_packed(cloud)
    assert len(kept) == len(NAMES)
    assert bytes_of(cloud) == before


def test_a_cloud_that_is_its_own_part_is_packed_once():
    cloud = random_cloud([1, 2, 3], 0)
    before = bytes_of(cloud)
    pack_part(cloud, cloud)
    assert is_packed(cloud)
    assert bytes_of(cloud) == before
    assert not hasattr(cloud, "no_such_array")
