"""`hickory-stream play`: map a recorded log; keys of a terminal control the playback clock."""

from __future__ import annotations

import gc
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from hickory_stream.cli.option_values import (
    make_style,
    parse_rate,
    positive,
    read_settings,
    resume_command,
    robot_of_option,
)
from hickory_stream.cli.output_files import add_output
from hickory_stream.cli.runs.summary import finish
from hickory_stream.cli.source_options import add_anyway, add_source_options, source_options
from hickory_stream.errors import InputError
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from hickory_stream.cli.commands import Commands
    from hickory_stream.map_folder.writer import MapFolder
    from hickory_stream.ports import Sink
    from hickory_stream.settings import Settings
    from players.playback import PlaybackClock


HELP = "space: pause; . : one frame; k: to the next keyframe; right, left: 10 s on or back; up, down: faster or slower"
_SEEK_S = 10.0
_RATES = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, None)


class Keys:
    """While entered, keys control a clock; does nothing unless standard input is a terminal."""

    def __init__(self, clock: PlaybackClock) -> None:
        self._clock = clock
        self._saved: list[Any] | None = None
        self._ended = threading.Event()

    def __enter__(self) -> Self:
        if sys.platform != "win32" and sys.stdin.isatty():
            import termios
            import tty

            self._saved = termios.tcgetattr(sys.stdin.fileno())
            tty.setcbreak(sys.stdin.fileno())
            threading.Thread(target=self._read, name="keys", daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        if self._saved is not None:
            import termios

            termios.tcsetattr(sys.stdin.fileno(), termios.TCSADRAIN, self._saved)

    def _read(self) -> None:
        import os
        import select

        while not self._ended.is_set():
            ready, _, _ = select.select([sys.stdin], [], [], 0.2)
            if ready:
                press(self._clock, os.read(sys.stdin.fileno(), 16))


def press(clock: PlaybackClock, keys: bytes) -> None:
    """Apply keys to a clock, and ignore unknown ones."""
    match keys:
        case b" ":
            clock.pause()
        case b".":
            clock.step("frame")
        case b"k":
            clock.step("keyframe")
        case b"\x1b[C":
            clock.seek(_SEEK_S, relative=True)
        case b"\x1b[D":
            clock.seek(-_SEEK_S, relative=True)
        case b"\x1b[A" | b"\x1b[B":
            place = _RATES.index(clock.rate) if clock.rate in _RATES else _RATES.index(1.0)
            step = 1 if keys == b"\x1b[A" else -1
            clock.set_rate(_RATES[min(max(place + step, 0), len(_RATES) - 1)])


# Options of a single log with their defaults; a fleet refuses them.
_OF_ONE_LOG = {
    "rate": "max", "live": False, "loop": 1, "start": 0.0, "end": None, "frames": None, "rrd": None,
    "costmap": None, "metrics_port": None, "profile": None, "odometry": "auto", "poses": None, "pose_topic": None,
    "color_topic": None, "depth_topic": None,
}  # fmt: skip


def add(commands: Commands) -> None:
    play = commands.add("play", run, configured=True)
    play.add_argument(
        "source",
        nargs="*",
        help="MCAP file, ROS 1 or ROS 2 bag, .sens, .r3d, or folder of images; several are played as one log; "
        "without a log: --robot NAME=LOG for each robot of a fleet",
    )
    play.add_argument("--out", type=Path, metavar="MAP", help="map folder to write (default: NAME.map)")
    play.add_argument("--overwrite", action="store_true", help="replace an existing map and files")
    play.add_argument("--rate", default="max", help="max (default): full speed; or a factor of real time, e.g. 1.0")
    play.add_argument(
        "--live",
        action="store_true",
        help="play in real time like a live camera, and drop frames when mapping is slower",
    )
    play.add_argument("--loop", type=int, default=1, metavar="N", help="play the log N times in one run")
    play.add_argument("--start", type=float, default=0.0, metavar="S", help="start of the playback in the log")
    play.add_argument("--end", type=float, metavar="S", help="end of the playback in the log")
    play.add_argument("--frames", type=int, metavar="N", help="play only the first N frames")
    add_anyway(play)
    add_run_options(play)
    add_source_options(play)


def add_run_options(command: argparse.ArgumentParser) -> None:
    """Add the options of every run: its workers, and where it is shown."""
    command.add_argument("--workers", metavar="N", help="child processes that build shapes, or dask=tcp://HOST:PORT")
    command.add_argument("--viewer", default="auto", help="auto (default), none, spawn, web or connect=URL")
    add_output(command, "--rrd", type=Path, metavar="FILE", help="write a Rerun recording")
    add_output(
        command, "--costmap", type=Path, metavar="FILE", help="write the growing grid as ROS 2 messages (MCAP) for Nav2"
    )
    command.add_argument(
        "--costmap-robot", metavar="NAME|FILE", help="robot of --costmap, whose height range counts (required)"
    )
    command.add_argument(
        "--metrics-port", type=int, metavar="N", help="serve Prometheus metrics on 127.0.0.1:N/metrics"
    )


def run(options: argparse.Namespace) -> int:
    if not options.source and any("=" in robot for robot in options.robot or ()):
        return _play_fleet(options)
    if not options.source:
        raise InputError("found no log, expected play LOG [LOG ...], or --robot NAME=LOG for each robot of a fleet")
    # Imports leave no garbage: looking for it takes a tenth of their time.
    gc.disable()
    try:
        from hickory_stream.sinks.rerun.viewer import check_viewer, parse_viewer
        from players import make_source_note, open_from_note
        from players.doctor.motion_mends import check_motion
        from players.playback import PlaybackClock

        settings = read_settings(options)
    finally:
        gc.freeze()
        gc.enable()
    viewer = parse_viewer(options.viewer)
    check_viewer(viewer)
    rate = parse_rate(options.rate)
    if options.live and rate is None:
        rate = 1.0
    if not 0 <= options.start < (options.end if options.end is not None else float("inf")):
        raise InputError(f"found --start {options.start:g}, expected 0 or more and less than --end {options.end}")
    note = make_source_note(
        options.source,
        source_options(options),
        first_frames=None if options.frames is None else positive(options.frames, "--frames"),
        start_s=options.start,
        end_s=options.end,
    )
    clock = PlaybackClock(rate)
    source = open_from_note(note, clock, settings.mapper.keyframes)
    out = options.out or Path(f"{Path(options.source[0]).resolve().stem}.map")
    with ThreadPoolExecutor(1, "check") as checking:
        reasons = checking.submit(check_motion, source, note, anyway=options.anyway)
        from hickory_stream.engine.mapper import Mapper
        from hickory_stream.engine.play import play
        from hickory_stream.progress import ProgressPrinter

        mapper = Mapper(settings.mapper, out=out, overwrite=options.overwrite)
    # Before an existing map is replaced.
    sys.stderr.writelines(f"warning: {reason}\n" for reason in reasons.result())
    style = make_style(options)
    if not options.json:
        sys.stderr.write(f"{source.info.kind}: {source.info.uri}\n")
        sys.stderr.writelines(f"  {role}: {stream}\n" for role, stream in source.info.streams)

    # Refuse invalid options before an existing map is replaced.
    beside = sinks_beside(options, settings, is_live=options.live)
    printer = ProgressPrinter(style, clock.describe)
    keys = Keys(clock)
    if style == "bar" and sys.stdin.isatty():
        sys.stderr.write(f"{HELP}\n")
    options.resumed_by = resume_command(out)
    try:
        with keys:
            played = play(
                mapper,
                source,
                sinks=all_sinks(options, settings, viewer, beside),
                rate=None,  # the clock of the source keeps it
                mode="live" if options.live else "playback",
                source_note=note,
                loops=positive(options.loop, "--loop"),
                progress=printer,
            )
    finally:
        printer.close()
        source.close()
        for sink in beside:
            sink.close()
    return finish(options, out, played)


def _play_fleet(options: argparse.Namespace) -> int:
    from argparse import Namespace

    from hickory_stream.cli.runs import fleet

    alone = [
        f"--{name.replace('_', '-')}" for name, default in _OF_ONE_LOG.items() if getattr(options, name) != default
    ]
    if alone:
        raise InputError(f"found {alone[0]}, which needs a single log; leave it out, or use `fleet FLEET.toml`")
    if options.out is None:
        raise InputError("found no --out, expected --out OUT: the folder for the robots' maps and the merged one")
    return fleet.run(Namespace(**{**vars(options), **fleet.DEFAULTS}))


def sinks_beside(options: argparse.Namespace, settings: Settings, *, is_live: bool) -> list[Sink]:
    """Return the sinks of `--metrics-port` and `--costmap`; raises `InputError` for a port or file that cannot be used.

    A live costmap shows unconfirmed objects too.
    """
    made: list[Sink] = []
    if options.metrics_port is not None:
        from hickory_stream.sinks.metrics_sink import MetricsSink

        metrics = MetricsSink(options.metrics_port, settings.rerun.bind)
        url = f"http://{settings.rerun.bind}:{metrics.port}/metrics"
        report = output("metrics", {"event": "metrics", "url": url}) if options.json else f"metrics: {url}"
        sys.stderr.write(f"{report}\n")
        made.append(metrics)
    if options.costmap is not None:
        from hickory_stream.sinks.costmap_sink import CostmapSink

        robot = robot_of_option(options.costmap_robot, "--costmap-robot")
        made.append(CostmapSink(robot, path=options.costmap, early=is_live))
    return made


def all_sinks(
    options: argparse.Namespace,
    settings: Settings,
    viewer: Any,
    beside: list[Sink],
    *,
    status: Callable[[], str] | None = None,
) -> Callable[[MapFolder], list[tuple[Sink, bool]]]:
    """Return a function that makes all sinks of a run, and takes ownership of `beside`."""

    def sinks(folder: MapFolder) -> list[tuple[Sink, bool]]:
        made = make_sinks(folder, settings, viewer, options.rrd, status)
        handed_over = [(sink, False) for sink in beside]
        beside.clear()
        return [*made, *handed_over]

    return sinks


def make_sinks(
    folder: MapFolder, settings: Settings, viewer: Any, rrd: Path | None, status: Callable[[], str] | None = None
) -> list[tuple[Sink, bool]]:
    """Return the sinks of a playback, each with whether its failure stops the run."""
    from hickory_stream.sinks.disk_sink import DiskSink
    from hickory_stream.sinks.rerun.sink import RerunSink
    from hickory_stream.sinks.rerun.viewer import ViewerKind

    made: list[tuple[Sink, bool]] = [(DiskSink(folder, settings.disk), True)]
    if rrd is not None or viewer.kind is not ViewerKind.NONE:
        shown = RerunSink(settings.rerun, folder.path, rrd, viewer, status)
        if shown.web_url:
            sys.stderr.write(f"viewer: {shown.web_url}\n")
        made.append((shown, False))
    return made
