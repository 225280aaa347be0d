"""Keyframes with depth on a true object: with fewer than three it is out of reach of any map.

A keyframe has depth on an object if the log has returns at four or more of the cells of the journal's depth that show
it: 64 of 640 x 480 pixels, the smallest mask. Neither masks nor the configuration change the answer.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import MapFolderError
from hickory_stream.evaluation.match import SURFACE_REACH_M, TrueBox
from hickory_stream.evaluation.truth import Truth, frame_at, instances_of
from hickory_stream.geometry.camera import backproject
from hickory_stream.geometry.rigid import apply
from hickory_stream.map_folder.history.recorded import RecordedKeyframe, recorded_steps
from hickory_stream.map_folder.saved_map import SavedMap
from hickory_stream.perception.coarse import coarse_camera, sampled_pixels

_CELLS = 4


def depth_on_objects(saved: SavedMap, truth: Truth) -> Counter[int] | None:
    """Return the number of keyframes with depth on each true object; None without a journal, as for a merged map.

    Raises `RecordingError` for an image of the truth.
    """
    stamps = np.array([frame.stamp_ns for frame in truth.frames], dtype=np.int64)

    def cells_of(keyframe: RecordedKeyframe) -> Counter[int]:
        at = frame_at(stamps, keyframe.observed.stamp_ns)
        if at is None:
            return Counter()
        return _cells(keyframe, instances_of(truth, truth.frames[at]))

    return _keyframes(saved, cells_of)


def reached_in(keyframe: RecordedKeyframe, instances: NDArray[Any]) -> set[int]:
    """Return the true objects on which a keyframe has depth; `instances` (H, W) are those that its pixels show."""
    return _enough(_cells(keyframe, instances))


def _cells(keyframe: RecordedKeyframe, instances: NDArray[Any]) -> Counter[int]:
    depth = keyframe.coarse.depth_mm
    shown = instances[sampled_pixels(instances.shape, keyframe.coarse.stride_px)][: len(depth), : depth.shape[1]]
    return Counter(shown[depth[: len(shown), : shown.shape[1]] > 0].tolist())


def _enough(cells: Counter[int]) -> set[int]:
    return {i for i, count in cells.items() if count >= _CELLS}


def depth_on_labels(saved: SavedMap, labels: Sequence[TrueBox]) -> Counter[int] | None:
    """Return the number of keyframes with depth in each labelled box; None without a journal."""

    def cells_of(keyframe: RecordedKeyframe) -> Counter[int]:
        depth_m = (keyframe.coarse.depth_mm / 1000).astype(np.float32)
        points = backproject(depth_m, coarse_camera(keyframe.coarse.camera))[depth_m > 0]
        world = apply(keyframe.map_from_odometry @ keyframe.observed.world_from_camera, points)
        return Counter({one.id: int(one.boxes[0].contains(world, SURFACE_REACH_M).sum()) for one in labels})

    return _keyframes(saved, cells_of)


def _keyframes(saved: SavedMap, cells_of: Callable[[RecordedKeyframe], Counter[int]]) -> Counter[int] | None:
    keyframes: Counter[int] = Counter()
    try:
        for step in recorded_steps(saved.folder, saved.snapshot):
            if step.keyframe is not None:
                keyframes.update(_enough(cells_of(step.keyframe)))
    except MapFolderError:
        return None
    return keyframes
