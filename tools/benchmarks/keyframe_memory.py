"""The memory of layer 1 in a process of its own: a log's keyframes are perceived and mapped, round after round.

It is what the operating system counts, so that weights, the network's and OpenCV's buffers, compiled kernels and the
map are in it; what the process has before, with a frame read from the log, is taken off. Each round has a map of its
own and does the same work: what a later one takes beyond the first was not given back. Linux alone.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections import deque
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2

from hickory_stream.base.json_text import dumps
from hickory_stream.config import MapperConfig
from hickory_stream.perception.choose import make_segmenter
from tools.benchmarks.first_layer import keyframes_of, play_first_layer
from tools.benchmarks.processes import ROOT

WARM_KEYFRAMES = 5
"""The first ones load weights and kernels."""
_STATUS = Path("/proc/self/status")


@dataclass(frozen=True, kw_only=True, slots=True)
class KeyframeMemory:
    """Megabytes of resident memory, of so many keyframes in each round.

    Attributes:
        layer1_mb: the peak over all rounds.
        keyframes_mb: by how much the first round's peak rises after the `WARM_KEYFRAMES`: with the map that is made.
        rounds_mb: by how much later rounds exceed the first one's peak.
    """

    keyframes: int
    layer1_mb: float
    keyframes_mb: float
    rounds_mb: float


def keyframe_memory(log: Path, *, keyframes: int, rounds: int) -> KeyframeMemory:
    """Return the memory of layer 1 on the first keyframes of a log, measured in a child process.

    Raises:
        RuntimeError: the child failed.
    """
    command = [sys.executable, "-m", "tools.benchmarks.keyframe_memory", str(log)]
    command += ["--keyframes", str(keyframes), "--rounds", str(rounds)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}: {done.stderr.splitlines()[-1:]}")
    return KeyframeMemory(**json.loads(done.stdout))


def _measured(log: Path, *, keyframes: int, rounds: int) -> KeyframeMemory:
    cv2.setNumThreads(1)
    config = MapperConfig()
    # What reads logs is loaded before anything is counted.
    next(keyframes_of(log, config, 1))
    before_mb = _resident_mb("VmRSS")
    segmenter = make_segmenter(config.perception)
    played = play_first_layer(log, config=config, segmenter=segmenter, max_keyframes=keyframes)
    first_mb = [_resident_mb("VmHWM") for _ in played]
    for _ in range(rounds - 1):
        deque(play_first_layer(log, config=config, segmenter=segmenter, max_keyframes=keyframes), maxlen=0)
    last_mb = _resident_mb("VmHWM")
    return KeyframeMemory(
        keyframes=len(first_mb),
        layer1_mb=last_mb - before_mb,
        keyframes_mb=first_mb[-1] - first_mb[min(WARM_KEYFRAMES, len(first_mb)) - 1],
        # The peak is told a little late, by up to some hundred kilobytes.
        rounds_mb=max(0.0, last_mb - first_mb[-1]),
    )


def _resident_mb(name: str) -> float:
    """Return the resident memory of this process, now (VmRSS) or the most since it began (VmHWM)."""
    (line,) = (line for line in _STATUS.read_text().splitlines() if line.startswith(f"{name}:"))
    return int(line.split()[1]) * 1024 / 1e6


def main() -> None:
    """Measure, and print one line of JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("log", type=Path)
    parser.add_argument("--keyframes", type=int, required=True)
    parser.add_argument("--rounds", type=int, required=True)
    options = parser.parse_args()
    print(dumps(asdict(_measured(options.log, keyframes=options.keyframes, rounds=options.rounds))))


if __name__ == "__main__":
    main()
