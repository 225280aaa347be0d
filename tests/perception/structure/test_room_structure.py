import numpy as np
from hypothesis import given
from hickory_stream.geometry.voxels import contains, keys_of_points
from hickory_stream.perception.structure.room_structure import _in_voxels
from tests.strategies import seeds


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
