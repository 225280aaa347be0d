"""Position of a run in its log, and the outcome of every frame."""

from collections import Counter
from collections.abc import Sequence
from enum import StrEnum

from hickory_stream.engine.modes import Mode
from hickory_stream.engine.reading import QueuedFrame
from hickory_stream.events import TimeJumped
from hickory_stream.geometry.camera import Camera
from hickory_stream.journal.step import FramePose
from hickory_stream.map_folder.history.resume import ResumePoint
from hickory_stream.mapping.rules.keyframes import Keyframe, KeyframeConfig, is_keyframe, keyframe_reason


class RunClock:
    """The last frame, its round of the log, and totals; detects jumps of the stamps.

    A gap of up to `time_jump_s` is no jump. `counts` are frames by outcome.
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
        self._mapped: Keyframe | None = None

    def resume(self, point: ResumePoint) -> None:
        """Continue from an interrupted run."""
        step = point.step
        self.last, self.camera, self.first_ns = point.last_frame, step.camera, step.first_ns
        self.round_index, self.first_index = step.round_index, step.first_index
        self.num_frames, self.num_keyframes = step.num_frames, step.num_keyframes
        self.counts.update(step.counts)
        self._mapped = point.position.keyframe

    def jump_before(self, read: QueuedFrame) -> TimeJumped | None:
        """Return the jump of time before a frame, None if its stamp follows the one before."""
        if self.last is None or self.first_ns is None:
            return None
        from_ns, to_ns = self.last.stamp_ns, read.raw.stamp_ns
        if read.round_index != self.round_index:
            return TimeJumped(from_ns=from_ns, to_ns=to_ns, kind="loop")
        if 0 <= to_ns - from_ns <= self._time_jump_s * 1e9:
            return None
        return TimeJumped(from_ns=from_ns, to_ns=to_ns, kind="restart" if to_ns < self.first_ns else "seek")

    def advance(self, read: QueuedFrame) -> FramePose:
        """Advance to a frame, and return its pose."""
        raw = read.raw
        self.num_frames += 1
        self.round_index, self.first_index = read.round_index, read.first_index
        self.camera = raw.camera
        self.first_ns = raw.stamp_ns if self.first_ns is None else self.first_ns
        self.last = FramePose(index=raw.index, stamp_ns=raw.stamp_ns, world_from_camera=raw.world_from_camera)
        return self.last

    def map_keyframe(self, read: QueuedFrame, config: KeyframeConfig) -> None:
        """Count a keyframe, and whether the camera was at rest since the one before."""
        stamp_ns, pose = read.raw.stamp_ns, read.raw.world_from_camera
        reason = keyframe_reason(self._mapped, stamp_ns, pose, config)
        self.num_keyframes += 1
        self.counts["keyframes_at_rest"] += reason == "at_rest"
        self._mapped = Keyframe(stamp_ns=stamp_ns, world_from_camera=pose)


class FrameOutcome(StrEnum):
    """The outcome of a frame; the values are the names of the counts.

    `DROPPED`: mapping could not keep up. `UNDECODABLE`: the images of a keyframe are torn. `KEPT_OUT`: a keyframe does
    not fit the map. `FAILED`: a network failed on it.
    """

    MAPPED = "keyframes"
    BETWEEN = "between_keyframes"
    DROPPED = "keyframes_dropped"
    UNDECODABLE = "frames_undecodable"
    KEPT_OUT = "keyframes_kept_out"
    FAILED = "keyframes_failed"


class KeyframeChoice:
    """Chooses the frame to map among arrived frames: in a live run the newest that is a keyframe."""

    def __init__(self, mode: Mode, config: KeyframeConfig) -> None:
        self._mode = mode
        self._config = config
        self._mapped: Keyframe | None = None

    def outcomes(self, reads: Sequence[QueuedFrame]) -> list[FrameOutcome]:
        """Return the outcome of each frame, as far as it is known before decoding."""
        if self._mode == "playback":
            return [_outcome_of(read) for read in reads]
        poses = [(read.raw.stamp_ns, read.raw.world_from_camera) for read in reads]
        keyframes = [i for i, pose in enumerate(poses) if is_keyframe(self._mapped, *pose, self._config)]
        chosen = keyframes[-1] if keyframes else None
        dropped = [i for i, read in enumerate(reads) if read.is_candidate and i != chosen]
        if chosen is not None:
            raw = reads[chosen].raw
            self._mapped = Keyframe(stamp_ns=raw.stamp_ns, world_from_camera=raw.world_from_camera)
            if not reads[chosen].is_candidate:
                # It replaces the newest candidate.
                dropped = dropped[:-1]
        outcomes = [FrameOutcome.DROPPED if i in dropped else FrameOutcome.BETWEEN for i in range(len(reads))]
        if chosen is not None:
            outcomes[chosen] = FrameOutcome.MAPPED
        return outcomes


def _outcome_of(read: QueuedFrame) -> FrameOutcome:
    if read.is_candidate:
        return FrameOutcome.MAPPED
    if read.has_failed:
        return FrameOutcome.FAILED
    return FrameOutcome.UNDECODABLE if read.is_corrupt else FrameOutcome.BETWEEN
