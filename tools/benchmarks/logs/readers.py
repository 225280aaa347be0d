"""Reading logs: against the plain readers, in memory, damaged, and in every layout and container."""

from __future__ import annotations

import gc
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from hickory_stream.geometry.rigid import invert, rotation_angle_rad
from hickory_stream.worlds.layouts import layout_files
from hickory_stream.worlds.recording import make_recording
from hickory_stream.worlds.recording_config import RecordingConfig
from hickory_stream.worlds.ros_messages import RosMessages
from players import open_source
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.processes import ROOT
from tools.benchmarks.logs import damaged_logs as damage
from tools.benchmarks.logs.small_logs import messages, write_bag, write_mcap, write_small_logs

_SIZE = (640, 480)
_FRAME_MB = 640 * 480 * 5 / 1e6  # rgb8 and 16UC1
_ODOMETRY_HZ = 5.0
_RATIO_MB = 500


def measure(options: Options) -> list[Figure]:
    """Return the figures; a quick run reads 60 MB instead of 500, and 240 instead of 2,000.

    The ratios are taken of 500 MB always: opening a log takes the same time whatever its length.
    """
    short_mb, long_mb = (60, 240) if options.quick else (500, 2000)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        return [
            _read_ratio_mcap(folder, _RATIO_MB),
            _read_ratio_bag(folder, _RATIO_MB),
            _memory_growth(folder, short_mb, long_mb),
            *damage.measure(options),
            figure("layouts_equal", _layouts_equal(folder), "", "higher"),
        ]


def _frames_for(megabytes: float) -> int:
    return round(megabytes / _FRAME_MB)


def _read_ratio_mcap(folder: Path, megabytes: float) -> Figure:
    from mcap.reader import make_reader

    log = write_mcap(folder / "ratio.mcap", messages(RosMessages(2), _frames_for(megabytes), _SIZE), "lz4", 4 << 20)

    def plain() -> int:
        with log.open("rb") as stream:
            return sum(len(message.data) for _, _, message in make_reader(stream).iter_messages())

    ratio = _ratio(lambda: _play(log), plain)
    log.unlink()
    return figure("read_ratio_mcap", ratio, "x", "lower")


def _read_ratio_bag(folder: Path, megabytes: float) -> Figure:
    from rosbags.highlevel import AnyReader

    log = write_bag(folder / "ratio.bag", _frames_for(megabytes), "lz4", 4 << 20, _SIZE)

    def plain() -> int:
        with AnyReader([log]) as reader:
            return sum(len(data) for _, _, data in reader.messages())

    ratio = _ratio(lambda: _play(log), plain)
    log.unlink()
    return figure("read_ratio_bag", ratio, "x", "lower")


def _play(log: Path) -> int:
    """Return the number of frames, read and synchronised, not decoded."""
    source = open_source(log)
    return sum(1 for _ in source.frames())


def _ratio(ours: Callable[[], Any], theirs: Callable[[], Any]) -> float:
    """Return the best of three times of processor time, in turns: the machine is shared."""
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(3):
        for task, taken in zip((ours, theirs), times, strict=True):
            gc.collect()
            started = time.process_time()
            task()
            taken.append(time.process_time() - started)
    return min(times[0]) / min(times[1])


_PEAK = """
import sys
from pathlib import Path
from players import open_source
source = open_source(sys.argv[1])
peak = 0
for frame in source.frames():
    if frame.index % 10 == 0:
        status = Path("/proc/self/status").read_text()
        peak = max(peak, int(status.split("VmRSS:")[1].split()[0]))
print(peak / 1024)
"""


def _memory_growth(folder: Path, short_mb: float, long_mb: float) -> Figure:
    """Return how much more memory a process holds at most on a log four times as long."""
    peaks = []
    for megabytes in (short_mb, long_mb):
        log = write_mcap(
            folder / "memory.mcap", messages(RosMessages(2), _frames_for(megabytes), _SIZE), "none", 4 << 20
        )
        done = subprocess.run(
            [sys.executable, "-c", _PEAK, str(log)], check=True, capture_output=True, text=True, cwd=ROOT
        )
        peaks.append(float(done.stdout))
        log.unlink()
    print(f"  memory: {peaks[0]:.0f} MB at {short_mb} MB, {peaks[1]:.0f} MB at {long_mb} MB")
    return figure("memory_growth_mb", max(0.0, peaks[1] - peaks[0]), "MB", "lower")


def _layouts_equal(folder: Path) -> bool:
    """Return whether the same scene gives the same frames in every container and in the layouts of the data sets."""
    return _containers_equal(folder) and all(_layout_true(folder, name) for name in ("zed", "kimera_multi", "nus_clb"))


def _containers_equal(folder: Path) -> bool:
    """Compare colour and depth byte by byte, and poses, of one scene in seven containers."""
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


def _layout_true(folder: Path, layout: str) -> bool:
    """Compare the poses of a layout with the truth: within 1 mm and 0.05 degrees where the odometry has a pose.

    Images come at the rate of the visual odometry: between its poses the truth of a walk cannot be known to 1 mm.
    Frames after a jump of the odometry are as right as the jump can be known: 1 cm and half a degree.
    """
    config = RecordingConfig(layout=layout, seconds=4.0, rate_hz=_ODOMETRY_HZ, width=320, height=240)
    truth = make_recording(config, folder, layout)
    true = {frame.stamp_ns: frame.world_from_camera for frame in truth.frames}
    source = open_source([folder / file for file in layout_files(layout, layout)])
    has_jumped, worst_m, worst_rad, number = False, 0.0, 0.0, 0
    for frame in source.frames():
        has_jumped = has_jumped or frame.after_from_before is not None
        error = invert(true[frame.stamp_ns]) @ frame.world_from_camera
        slack = 10.0 if has_jumped else 1.0
        worst_m = max(worst_m, float(np.linalg.norm(error[:3, 3])) / slack)
        worst_rad = max(worst_rad, rotation_angle_rad(error[:3, :3]) / slack)
        number += 1
    error_text = f"{1000 * worst_m:.2f} mm, {np.degrees(worst_rad):.3f} deg"
    print(f"  {layout}: {number} of {len(true)} frames, poses within {error_text}")
    return number >= len(true) - 1 and worst_m <= 1e-3 and worst_rad <= np.radians(0.05)
