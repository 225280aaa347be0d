"""Frames without a pose: those of a robot that stands are no fault, since some odometry is silent then.

Between two poses their difference tells whether the camera moved; before the first and after the last the images do.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import RecordingError
from hickory_stream.geometry.rigid import compose, invert, rotation_vector

# The difference of poses around a gap in which the camera moved.
_MOVED = 0.15
# So many images of a gap are compared, this wide; a camera that stands shifts them by less, and they correlate.
_IMAGES, _WIDTH_PX, _SHIFT_PX, _RESPONSE = 8, 160, 1.0, 0.15
_LEAST, _SHARE = 5, 0.25

Pixels = Callable[[], NDArray[np.uint8]]


class PoseGaps:
    """Numbers of frames with and without a pose, added in the order of their stamps."""

    def __init__(self) -> None:
        self.num_posed = self._num_moving = self._num_waiting = 0
        self._before: NDArray[np.float64] | None = None
        self._every, self._images = 1, list[Pixels]()

    def posed(self, world_from_camera: NDArray[np.float64]) -> None:
        """Add a frame with a pose."""
        if self._num_waiting:
            self._num_moving += round(self._num_waiting * self._moving_share(world_from_camera))
            self._num_waiting, self._every, self._images = 0, 1, []
        self.num_posed += 1
        self._before = world_from_camera

    def unposed(self, pixels: Pixels) -> None:
        """Add a frame without a pose; `pixels` returns its colour (H, W, 3)."""
        if self._num_waiting % self._every == 0:
            self._images.append(pixels)
        if len(self._images) > _IMAGES:
            self._images, self._every = self._images[::2], 2 * self._every
        self._num_waiting += 1

    @property
    def num_moving(self) -> int:
        """The number of frames without a pose while the camera moves."""
        return self._num_moving + round(self._num_waiting * self._moving_share(None))

    def finding(self) -> str:
        """Return that too many frames have no pose while the camera moves, with their share; else ""."""
        number = self.num_moving
        total = self.num_posed + number
        if number < max(_LEAST, _SHARE * total):
            return ""
        return (
            f"{number} of {total} frames ({number / total:.0%}) have no pose while the camera moves, and are left out: "
            "name others with --pose-topic or --poses, widen --max-pose-gap, or estimate poses with --odometry depth"
        )

    def _moving_share(self, after: NDArray[np.float64] | None) -> float:
        if self._before is None or after is None:
            return _differing_share(self._images)
        motion = compose(invert(self._before), after)
        return float(max(*np.abs(motion[:3, 3]), *np.abs(rotation_vector(motion[:3, :3]))) > _MOVED)


def _differing_share(images: Sequence[Pixels]) -> float:
    # The share of neighbours that differ by more than noise, exposure and what moves before the camera.
    grays, moves = list[NDArray[np.float32]](), list[bool]()
    for pixels in images:
        with suppress(RecordingError):
            gray = cv2.cvtColor(pixels(), cv2.COLOR_RGB2GRAY)
            size = (_WIDTH_PX, max(2, gray.shape[0] * _WIDTH_PX // gray.shape[1]))
            grays.append(cv2.resize(gray, size, interpolation=cv2.INTER_AREA).astype(np.float32))
    for before, after in pairwise(grays):
        shift, response = cv2.phaseCorrelate(before, after, cv2.createHanningWindow(before.shape[::-1], cv2.CV_32F))
        moves.append(bool(np.hypot(*shift) > _SHIFT_PX or response < _RESPONSE))
    return float(np.mean(moves)) if moves else 0.0
