import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.geometry.voxels import keys_of_cells, keys_of_points
from hickory_stream.perception.space import _free_keys
from tests.strategies import seeds


def walked(origin, ends, returns, voxel_m):
    cells = [np.empty((0, 3), dtype=np.int64)]
    for end in ends:
        ray = (end - origin) / voxel_m
        length = np.sqrt((ray**2).sum())
        steps = np.arange(1, max(int((length - 1) / 0.7), 1))
        cells.append(np.floor(origin / voxel_m + steps[:, None] * 0.7 * ray / max(length, 1e-9)).astype(np.int64))
    keys = np.unique(keys_of_cells(np.concatenate(cells)))
    return keys[~np.isin(keys, keys_of_points(returns, voxel_m))]


@given(seeds, st.integers(0, 40), st.sampled_from([0.05, 0.11]), st.sampled_from([0.3, 2.0]))
def test_free_voxels_are_those_that_a_walk_along_the_rays_meets(seed, count, voxel_m, reach_m):
    rng = np.random.default_rng(seed)
    origin = rng.uniform(-3, 3, 3)
    ends = origin + rng.uniform(-reach_m, reach_m, (count, 3))
    returns = origin + rng.uniform(-1.5 * reach_m, 1.5 * reach_m, (300, 3))
    assert np.array_equal(_free_keys(origin, ends, returns, voxel_m), walked(origin, ends, returns, voxel_m))


def test_no_ray_frees_nothing():
    assert len(_free_keys(np.zeros(3), np.empty((0, 3)), np.empty((0, 3)), 0.05)) == 0
