"""A live run of the in-memory scene at 30 Hz and 640x480, in a process of its own: part of `tools/bench engine`."""
# Three times: with perception slowed by a factor, with the embedded one as it is, and with a sink that stalls besides.

import asyncio
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.config_text import read_config
from hickory_stream.box_scene import SceneSource
from hickory_stream.config import MapperConfig
from hickory_stream.engine.mapper import Mapper
from hickory_stream.geometry.camera import Camera
from hickory_stream.journal.reader import Journal
from hickory_stream.journal.step import Step
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.map_folder.writer import MapFolder
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.ports import Segmenter, Sink
from hickory_stream.records import Frame, FrameReport, MapPrior, Segmentation
from hickory_stream.sinks.disk_sink import DiskSink
from tools.benchmarks.common.processes import NO_SHAPES, watched_peak_mb

_CAMERA = Camera(width=640, height=480, fx=560.0, fy=560.0, cx=319.5, cy=239.5)
_PERIOD_NS = 33_333_333
_STEPS = 24
_FATES = ("keyframes", "between_keyframes", "keyframes_dropped", "frames_dropped", "frames_late")


class FastScene(SceneSource):
    """The scene at 30 Hz and 640x480 for `seconds`: the camera goes there and back, a step every third of a second."""

    def __init__(self, seconds: float) -> None:
        num_frames = int(seconds * 1e9 / _PERIOD_NS)
        super().__init__(num_frames, camera=_CAMERA, period_ns=_PERIOD_NS, step_of=_there_and_back)
        # Cast before the clock starts.
        self._images = [SceneSource.cast(self, step) for step in range(_STEPS)]

    def cast(self, step: int) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.int32]]:
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
        return self._slowly(self._segmenter.prepare, frame)

    def segment(self, frame: Frame, prior: MapPrior | None = None, prepared: object = None) -> Segmentation:
        return self._slowly(self._segmenter.segment, frame, prior, prepared)

    def _slowly(self, work: Any, *arguments: object) -> Any:
        started = time.perf_counter()
        result = work(*arguments)
        time.sleep((self._factor - 1) * (time.perf_counter() - started))
        return result


class StallingSink:
    """A sink that sleeps for `seconds` on its first report."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds

    def show(self, _report: FrameReport) -> None:
        seconds, self._seconds = self._seconds, 0.0
        time.sleep(seconds)

    def close(self) -> None:
        """Do nothing."""


def keyframe_steps(out: Path) -> list[Step]:
    with Journal(out) as journal:
        return [step for step in map(journal.step, range(len(journal))) if step.kind == "keyframe"]


def overloads(out: Path, seconds: float, slower: float, stall_s: float) -> list[dict[str, float]]:
    """Return the figures of the runs that `_run` makes into a folder, with the peak memory of this process so far."""
    peak_mb, found = watched_peak_mb(), []
    # Compilation on first use is not measured.
    asyncio.run(_run(out, 0.5, 1.0, 0.0))
    for factor, stall in ((slower, 0.0), (1.0, 0.0), (1.0, stall_s)):
        asyncio.run(_run(out, seconds, factor, stall))
        found.append({**_measured(out), "peak_mb": peak_mb[0]})
    return found


async def _run(out: Path, seconds: float, slower: float, stall_s: float) -> None:
    config = read_config(MapperConfig, None, (NO_SHAPES,))
    segmenter = SlowedSegmenter(make_segmenter(config.perception), slower)

    def sinks(folder: MapFolder) -> list[tuple[Sink, bool]]:
        return [(DiskSink(folder), True), *([(StallingSink(stall_s), False)] if stall_s else [])]

    async with Mapper(config, out=out, overwrite=True, segmenter=segmenter) as mapper:
        async for _ in mapper.run(FastScene(seconds), sinks=sinks, rate=1.0, mode="live"):
            pass


def _measured(out: Path) -> dict[str, float]:
    frames, steps = dict(open_map(out).ledger["frames"]), keyframe_steps(out)
    latency_s = max(dict(step.metrics)["time/latency"] for step in steps)
    periods_s = np.diff([step.stamp_ns for step in steps]) / 1e9
    return {
        "keyframes": float(frames["keyframes"]),
        "unaccounted": float(frames["read"] - sum(frames.get(fate, 0) for fate in _FATES)),
        "latency_keyframes": float(latency_s / periods_s.mean()) if len(periods_s) else 0.0,
    }
