"""Example of a segmenter: connected image regions that rise above the lowest horizontal plane."""

import numpy as np
from skimage.measure import label
from hickory_stream.geometry.camera import backproject
from hickory_stream.geometry.rigid import apply
from hickory_stream.records import Segmentation

_LEVEL_M, _MIN_SHARE, _MIN_PIXELS = 0.02, 0.1, 20


class PlaneSegmenter:
    """Instances are regions more than two height bins above the floor, with at least `_MIN_PIXELS` pixels."""

    def prepare(self, frame):
        """Return (H, W) the height of each pixel's point, NaN without depth; the map is not needed."""
        points_camera = backproject(frame.depth_m, frame.camera).astype(np.float64)
        return apply(frame.world_from_camera, points_camera.reshape(-1, 3))[:, 2].reshape(frame.depth_m.shape)

    def segment(self, frame, prior=None, prepared=None):
        """Return the instances and the floor; `prior` is not used."""
        del prior
        heights = prepared if isinstance(prepared, np.ndarray) else self.prepare(frame)
        levels, counts = np.unique(np.round(heights[np.isfinite(heights)] / _LEVEL_M), return_counts=True)
        if not len(levels):
            return Segmentation(instances=np.zeros(heights.shape, np.int32), structure=np.zeros(heights.shape, bool))
        floor_z_m = float(levels[counts >= _MIN_SHARE * counts.sum()][:1].sum() * _LEVEL_M)
        regions = label(heights > floor_z_m + 2 * _LEVEL_M)
        is_large = np.bincount(regions.ravel()) >= _MIN_PIXELS
        is_large[0] = False
        instances = np.where(is_large, np.cumsum(is_large), 0)[regions].astype(np.int32)
        structure = np.abs(heights - floor_z_m) <= 2 * _LEVEL_M
        return Segmentation(instances=instances, structure=structure & (instances == 0), floor_z_m=floor_z_m)
