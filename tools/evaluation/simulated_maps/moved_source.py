"""A source with its poses elsewhere: in another world frame, or of another odometry."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hickory_stream.ports import Source, SourceAround
from hickory_stream.records import Frame, RawFrame


class MovedSource(SourceAround):
    """The frames of another source at the poses (4, 4) that `pose_of` gives; these must keep z up."""

    def __init__(self, source: Source, pose_of: Callable[[RawFrame], NDArray[np.float64]]) -> None:
        super().__init__(source)
        self._pose_of = pose_of

    def frames(self) -> Iterator[RawFrame]:
        for raw in self._source.frames():
            pose = self._pose_of(raw)
            yield replace(raw, world_from_camera=pose, decode=partial(_decoded, raw, pose))


def _decoded(raw: RawFrame, pose: NDArray[np.float64]) -> Frame:
    return replace(raw.decode(), world_from_camera=pose)
