"""Reading logs: against the plain readers, in memory, damaged, and in every container."""

import gc
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from players import open_source
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.processes import best_s, in_child, resident_mb
from tools.benchmarks.logs import damaged_logs
from tools.damage.damaging import messages, write_bag, write_mcap, write_small_logs
from tools.worlds.ros_bags import RosMessages

_SIZE = (640, 480)
_FRAME_MB = 640 * 480 * 5 / 1e6  # rgb8 and 16UC1
_RATIO_FRAMES = round(500 / _FRAME_MB)


def measure(options: Options) -> list[Figure]:
    """Return the figures; a quick run compares the memory for 60 and 240 MB instead of 500 and 2,000."""
    # The ratios are taken of 500 MB always: opening a log takes the same time whatever its length.
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        return [
            figure("read_ratio_mcap", _read_ratio_mcap(folder / "ratio.mcap"), "x", "lower"),
            figure("read_ratio_bag", _read_ratio_bag(folder / "ratio.bag"), "x", "lower"),
            _memory_growth(folder, *((60, 240) if options.quick else (500, 2000))),
            *damaged_logs.measure(options),
            figure("layouts_equal", _layouts_equal(folder)),
        ]


def _read_ratio_mcap(log: Path) -> float:
    from mcap.reader import make_reader

    write_mcap(log, messages(RosMessages(2), _RATIO_FRAMES, _SIZE), "lz4", 4 << 20)

    def plain() -> int:
        with log.open("rb") as stream:
            return sum(len(message.data) for _, _, message in make_reader(stream).iter_messages())

    return _ratio(log, plain)


def _read_ratio_bag(log: Path) -> float:
    from rosbags.highlevel import AnyReader

    write_bag(log, _RATIO_FRAMES, "lz4", 4 << 20, _SIZE)

    def plain() -> int:
        with AnyReader([log]) as reader:
            return sum(len(data) for _, _, data in reader.messages())

    return _ratio(log, plain)


def _ratio(log: Path, plain: Callable[[], int]) -> float:
    # Return the processor time of reading and synchronising frames over the time of a plain reader. The best of three
    # each, in turns: the machine is shared.
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(3):
        for task, taken in zip((lambda: sum(1 for _ in open_source(log).frames()), plain), times, strict=True):
            gc.collect()
            taken.append(best_s(task, 1))
    log.unlink()
    return min(times[0]) / min(times[1])


def _memory_growth(folder: Path, *sizes_mb: float) -> Figure:
    peaks, log = [], folder / "memory.mcap"
    for size_mb in sizes_mb:
        write_mcap(log, messages(RosMessages(2), round(size_mb / _FRAME_MB), _SIZE), "none", 4 << 20)
        peaks.append(in_child(_peak_mb, log))
        print(f"  memory: {peaks[-1]:.0f} MB at {size_mb} MB")
    log.unlink()
    return figure("memory_growth_mb", max(0.0, peaks[1] - peaks[0]), "MB", "lower")


def _peak_mb(log: Path) -> float:
    return max(resident_mb() for frame in open_source(log).frames() if frame.index % 10 == 0)


def _layouts_equal(folder: Path) -> bool:
    first: list[Any] | None = None
    for name, log in write_small_logs(folder, num_frames=10).items():
        frames = [raw.decode() for raw in open_source(log).frames()]
        first = first or frames
        same = len(frames) == len(first) == 10 and all(
            a.stamp_ns == b.stamp_ns
            and np.array_equal(a.rgb, b.rgb)
            and np.array_equal(a.depth_m, b.depth_m, equal_nan=True)
            and np.allclose(a.world_from_camera, b.world_from_camera, atol=1e-9)
            for a, b in zip(first, frames, strict=True)
        )
        if not same:
            print(f"  {name} gives other frames than mcap_none")
            return False
    return True
