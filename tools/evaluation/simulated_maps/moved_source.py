"""A source with its poses in another world frame, as if the robot had started elsewhere."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    import numpy as np
    from numpy.typing import NDArray

    from hickory_stream.ports import Source
    from hickory_stream.records import Frame, RawFrame, SourceInfo


class MovedSource:
    """The frames of another source, with `new_from_old` (4, 4) applied to every pose."""

    # The transform must keep z up.
    def __init__(self, source: Source, new_from_old: NDArray[np.float64]) -> None:
        if abs(float(new_from_old[2, 2]) - 1.0) > 1e-9:
            raise ValueError("a source may be moved and turned about the vertical, not tilted")
        self._source = source
        self._new_from_old = new_from_old

    @property
    def info(self) -> SourceInfo:
        return self._source.info

    def frames(self) -> Iterator[RawFrame]:
        for frame in self._source.frames():
            yield replace(
                frame,
                world_from_camera=self._new_from_old @ frame.world_from_camera,
                decode=partial(self._decoded, frame),
            )

    def ledger(self) -> Mapping[str, int]:
        return self._source.ledger()

    def close(self) -> None:
        self._source.close()

    def _decoded(self, raw: RawFrame) -> Frame:
        frame = raw.decode()
        return replace(frame, world_from_camera=self._new_from_old @ frame.world_from_camera)
