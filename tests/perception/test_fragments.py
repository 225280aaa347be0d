import numpy as np
from hypothesis import given
from scipy.ndimage import label
from hickory_stream.perception.fragments.over_segmentation import _label_level
from tests.strategies import seeds


@given(seeds)
def test_large_unlabelled_regions_of_a_level_get_its_label(seed):
    rng = np.random.default_rng(seed)
    shape = (14, 19)
    points, normals = np.zeros((2, *shape, 3), dtype=np.float32)
    points[..., 2] = np.where(rng.random(shape) < 0.6, 0.5, 0.6)
    normals[..., 2] = np.where(rng.random(shape) < 0.9, 1.0, np.nan)
    slack = np.full(shape, 0.02, dtype=np.float32)
    labels = np.where(rng.random(shape) < 0.1, 7, 0).astype(np.int32)
    regions, _ = label((points[..., 2] < 0.55) & (normals[..., 2] > 0.85))
    is_large = np.bincount(regions.ravel()) >= 5
    is_large[0] = False
    expected = np.where(is_large[regions] & (labels == 0), 2, labels)
    _label_level(points, normals, slack, 0.5, 5, 2, labels)
    assert np.array_equal(labels, expected)
