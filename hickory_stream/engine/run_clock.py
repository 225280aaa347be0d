"""Where a run stands: the last frame, its round of the log, and what became of all frames so far."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from hickory_stream.engine.step import FramePose
from hickory_stream.events import TimeJumped

if TYPE_CHECKING:
    from hickory_stream.engine.history.resume_point import ResumePoint
    from hickory_stream.engine.reading import Read
    from hickory_stream.geometry.camera import Camera


class RunClock:
    """Goes on with every frame, and tells where the stamps have jumped; a gap of up to `time_jump_s` is no jump.

    `counts` are of frames, by what became of them; `num_frames` and `num_keyframes` are totals.
    """

    def __init__(self, time_jump_s: float) -> None:
        self._time_jump_s = time_jump_s
        self.last: FramePose | None = None
        self.camera: Camera | None = None
        self.first_ns: int | None = None
        self.round_index = 0
        self.first_index = 0
        self.num_frames = 0
        self.num_keyframes = 0
        self.counts: Counter[str] = Counter()

    def resume(self, point: ResumePoint) -> None:
        """Go on where an interrupted run stood."""
        step = point.step
        self.last = point.last_frame
        self.camera = step.camera
        self.first_ns = step.first_ns
        self.round_index, self.first_index = step.round_index, step.first_index
        self.num_frames, self.num_keyframes = step.num_frames, step.num_keyframes
        self.counts.update(step.counts)

    def jump_before(self, read: Read) -> TimeJumped | None:
        """Return the jump of time before a frame, None where its stamp follows that of the frame before."""
        if self.last is None or self.first_ns is None:
            return None
        from_ns, to_ns = self.last.stamp_ns, read.raw.stamp_ns
        if read.round_index != self.round_index:
            return TimeJumped(from_ns=from_ns, to_ns=to_ns, kind="loop")
        if 0 <= to_ns - from_ns <= self._time_jump_s * 1e9:
            return None
        return TimeJumped(from_ns=from_ns, to_ns=to_ns, kind="restart" if to_ns < self.first_ns else "seek")

    def advance(self, read: Read) -> FramePose:
        """Go on to a frame, and return its pose."""
        raw = read.raw
        self.num_frames += 1
        self.round_index, self.first_index = read.round_index, read.first_index
        self.camera = raw.camera
        self.first_ns = raw.stamp_ns if self.first_ns is None else self.first_ns
        self.last = FramePose(index=raw.index, stamp_ns=raw.stamp_ns, world_from_camera=raw.world_from_camera)
        return self.last
