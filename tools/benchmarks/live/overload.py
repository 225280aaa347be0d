"""A live run of the in-memory scene at 30 Hz and 640x480, in a process of its own.

Three times: with perception slowed by a factor, with the embedded one as it is, and with a sink that stalls besides;
each prints one line of JSON. Run by `tools.benchmarks.scale.engine`.
"""

from __future__ import annotations

import argparse
import asyncio
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
from numpy.typing import NDArray

from hickory_stream.box_scene import SceneSource
from hickory_stream.config import MapperConfig
from hickory_stream.engine.journal import Journal
from hickory_stream.engine.map_folder import MapFolder
from hickory_stream.engine.mapper import Mapper
from hickory_stream.engine.saved_map import open_map
from hickory_stream.geometry.camera import Camera
from hickory_stream.json_text import dumps
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.ports import Segmenter, Sink
from hickory_stream.records import Frame, FrameReport, MapPrior, Segmentation
from hickory_stream.sinks.disk_sink import DiskSink

_CAMERA = Camera(width=640, height=480, fx=560.0, fy=560.0, cx=319.5, cy=239.5)
_PERIOD_NS = 33_333_333
_STEPS = 24


class FastScene(SceneSource):
    """The scene at 30 Hz and 640x480 for `seconds`: the camera goes there and back, a step every third of a second."""

    def __init__(self, seconds: float) -> None:
        num_frames = int(seconds * 1e9 / _PERIOD_NS)
        super().__init__(num_frames, camera=_CAMERA, period_ns=_PERIOD_NS, step_of=_there_and_back)
        # Cast before the clock starts.
        self._images = [SceneSource.cast(self, step) for step in range(_STEPS)]

    def cast(self, step: int) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.int32]]:
        """Return the images of a step."""
        return self._images[step]


def _there_and_back(index: int) -> int:
    phase = (index // 10) % (2 * _STEPS - 2)
    return phase if phase < _STEPS else 2 * _STEPS - 2 - phase


class SlowedSegmenter:
    """A segmenter that takes `factor` times as long as another one."""

    def __init__(self, segmenter: Segmenter, factor: float) -> None:
        self._segmenter = segmenter
        self._factor = factor

    def prepare(self, frame: Frame) -> object:
        """Prepare, slowly."""
        started = time.perf_counter()
        prepared = self._segmenter.prepare(frame)
        time.sleep((self._factor - 1) * (time.perf_counter() - started))
        return prepared

    def segment(self, frame: Frame, prior: MapPrior | None = None, prepared: object = None) -> Segmentation:
        """Segment, slowly."""
        started = time.perf_counter()
        segmentation = self._segmenter.segment(frame, prior, prepared)
        time.sleep((self._factor - 1) * (time.perf_counter() - started))
        return segmentation


class StallingSink:
    """A sink that does nothing for `seconds` when it is first shown something."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds

    def show(self, report: FrameReport) -> None:
        """Stall once."""
        del report
        seconds, self._seconds = self._seconds, 0.0
        time.sleep(seconds)

    def close(self) -> None:
        """Do nothing."""


def main() -> None:
    """Run, and print what was measured."""
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("--slower", type=float, required=True)
    parser.add_argument("--stall", type=float, required=True)
    options = parser.parse_args()
    peak_mb = [0.0]
    threading.Thread(target=_watch_memory, args=(peak_mb,), daemon=True).start()
    # What is compiled on first use is no part of a robot's day.
    asyncio.run(_run(options.out, 0.5, 1.0, 0.0))
    for slower, stall_s in ((options.slower, 0.0), (1.0, 0.0), (1.0, options.stall)):
        asyncio.run(_run(options.out, options.seconds, slower, stall_s))
        print(dumps({**_measured(options.out), "peak_mb": peak_mb[0]}), flush=True)


async def _run(out: Path, seconds: float, slower: float, stall_s: float) -> None:
    config = MapperConfig()
    # Shapes are not what is measured here: no job is ever asked for.
    requests = replace(config.mapping.requests, max_failures=0)
    config = replace(config, mapping=replace(config.mapping, requests=requests))
    segmenter = SlowedSegmenter(make_segmenter(config.perception), slower)

    def sinks(folder: MapFolder) -> list[tuple[Sink, bool]]:
        made: list[tuple[Sink, bool]] = [(DiskSink(folder), True)]
        return [*made, (StallingSink(stall_s), False)] if stall_s else made

    async with Mapper(config, out=out, overwrite=True, segmenter=segmenter) as mapper:
        async for _ in mapper.run(FastScene(seconds), sinks=sinks, rate=1.0, mode="live"):
            pass


def _measured(out: Path) -> dict[str, float]:
    frames = dict(open_map(out).ledger["frames"])
    fates = ("keyframes", "between_keyframes", "keyframes_dropped", "frames_dropped", "frames_late")
    with Journal(out) as journal:
        steps = [journal.step(i) for i in range(len(journal)) if journal.step(i).kind == "keyframe"]
    latencies_s = np.array([dict(step.metrics)["time/latency"] for step in steps])
    periods_s = np.diff([step.stamp_ns for step in steps]) / 1e9
    return {
        "keyframes": float(frames["keyframes"]),
        "dropped": float(frames.get("keyframes_dropped", 0) + frames.get("frames_dropped", 0)),
        "unaccounted": float(frames["read"] - sum(frames.get(fate, 0) for fate in fates)),
        "latency_keyframes": float(latencies_s.max() / periods_s.mean()) if len(periods_s) else 0.0,
        "latency_s": float(latencies_s.max()),
        "period_s": float(periods_s.mean()) if len(periods_s) else 0.0,
    }


def _watch_memory(peak_mb: list[float]) -> None:
    process = psutil.Process()
    while True:
        peak_mb[0] = max(peak_mb[0], process.memory_info().rss / 1e6)
        time.sleep(0.05)


if __name__ == "__main__":
    main()
