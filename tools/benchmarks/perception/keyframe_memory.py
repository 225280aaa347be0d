"""The memory of layer 1 in a process of its own: a log's keyframes are perceived and mapped, round after round."""
# The memory of the process before is subtracted. Memory that a later round takes beyond the first was not released.
# Linux alone.

from collections import deque
from dataclasses import dataclass
from pathlib import Path

import cv2

from hickory_stream.config import MapperConfig
from hickory_stream.perception.choose import make_segmenter
from tools.benchmarks.common.processes import in_child, resident_mb
from tools.evaluation.masks.first_layer import keyframes_of, play_first_layer

WARM_KEYFRAMES = 5
"""The first ones load weights and kernels."""


@dataclass(frozen=True, kw_only=True, slots=True)
class KeyframeMemory:
    """Megabytes of resident memory, of so many keyframes in each round."""

    # `layer1_mb`: the peak of all rounds; `keyframes_mb`: its rise after `WARM_KEYFRAMES`; `rounds_mb`: later rounds'
    # excess.

    keyframes: int
    layer1_mb: float
    keyframes_mb: float
    rounds_mb: float


def keyframe_memory(log: Path, *, keyframes: int, rounds: int) -> KeyframeMemory:
    """Return the memory of layer 1 on the first keyframes of a log, measured in a child process."""
    found: KeyframeMemory = in_child(_measured, log, keyframes=keyframes, rounds=rounds)
    return found


def _measured(log: Path, *, keyframes: int, rounds: int) -> KeyframeMemory:
    cv2.setNumThreads(1)
    config = MapperConfig()
    # The readers of logs are loaded before anything is counted.
    next(keyframes_of(log, config, 1))
    before_mb = resident_mb()
    segmenter = make_segmenter(config.perception)
    played = play_first_layer(log, config=config, segmenter=segmenter, max_keyframes=keyframes)
    first_mb = [resident_mb("VmHWM") for _ in played]
    for _ in range(rounds - 1):
        deque(play_first_layer(log, config=config, segmenter=segmenter, max_keyframes=keyframes), maxlen=0)
    last_mb = resident_mb("VmHWM")
    return KeyframeMemory(
        keyframes=len(first_mb),
        layer1_mb=last_mb - before_mb,
        keyframes_mb=first_mb[-1] - first_mb[min(WARM_KEYFRAMES, len(first_mb)) - 1],
        # The system updates the peak a little late, by up to some hundred kilobytes.
        rounds_mb=max(0.0, last_mb - first_mb[-1]),
    )
