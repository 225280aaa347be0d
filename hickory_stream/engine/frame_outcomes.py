"""What becomes of frames that have come: each has one outcome, and is counted once."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING

from hickory_stream.mapping.keyframes import Keyframe, is_keyframe

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hickory_stream.engine.modes import Mode
    from hickory_stream.engine.reading import Read
    from hickory_stream.mapping.keyframes import KeyframeConfig


class FrameOutcome(StrEnum):
    """What becomes of a frame; the values are the names of the counts.

    `DROPPED`: a keyframe that was left out because mapping could not keep up. `UNDECODABLE`: it was to be one, and its
    images are torn. `KEPT_OUT`: it was to be one, and does not fit the map.
    """

    MAPPED = "keyframes"
    BETWEEN = "between_keyframes"
    DROPPED = "keyframes_dropped"
    UNDECODABLE = "frames_undecodable"
    KEPT_OUT = "keyframes_kept_out"


class KeyframeChoice:
    """Chooses which of the frames that have come is mapped: in a live run the newest that makes a keyframe."""

    def __init__(self, mode: Mode, config: KeyframeConfig) -> None:
        self._mode = mode
        self._config = config
        self._mapped: Keyframe | None = None

    def outcomes(self, reads: Sequence[Read]) -> list[FrameOutcome]:
        """Return what becomes of each frame, as far as is known before any is decoded in a live run."""
        if self._mode == "playback":
            return [
                FrameOutcome.MAPPED
                if r.is_candidate
                else FrameOutcome.UNDECODABLE
                if r.is_torn
                else FrameOutcome.BETWEEN
                for r in reads
            ]
        chosen = next((i for i in range(len(reads) - 1, -1, -1) if self._makes_keyframe(reads[i])), None)
        dropped = [i for i, read in enumerate(reads) if read.is_candidate and i != chosen]
        if chosen is not None:
            raw = reads[chosen].raw
            self._mapped = Keyframe(stamp_ns=raw.stamp_ns, world_from_camera=raw.world_from_camera)
            if not reads[chosen].is_candidate:
                # It is mapped in the place of a candidate, the newest.
                dropped = dropped[:-1]
        outcomes = [FrameOutcome.DROPPED if i in dropped else FrameOutcome.BETWEEN for i in range(len(reads))]
        if chosen is not None:
            outcomes[chosen] = FrameOutcome.MAPPED
        return outcomes

    def _makes_keyframe(self, read: Read) -> bool:
        return is_keyframe(self._mapped, read.raw.stamp_ns, read.raw.world_from_camera, self._config)
