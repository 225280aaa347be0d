"""`hickory-stream live`: map a robot while it moves."""

from __future__ import annotations

import re
import sys
import threading
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hickory_stream.base.terminal import clear_line
from hickory_stream.cli.option_values import make_style, read_settings, resume_command, robot_of_option, seconds
from hickory_stream.cli.output_files import add_output
from hickory_stream.cli.runs.play import add_run_options, all_sinks, sinks_beside
from hickory_stream.cli.runs.summary import finish
from hickory_stream.cli.source_options import add_source_options, source_options
from hickory_stream.errors import InputError
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse

    from hickory_stream.cli.commands import Commands
    from hickory_stream.navigation.robot import Robot
    from hickory_stream.sinks.publish_sink import PublishSink
    from players.live import LiveMapSource
    from players.live.recorder import Recorder
    from players.live.status import LiveStatus

_PATIENCE_S = 60.0
_STATUS_S = 10.0
_RECORD_GB = 50.0


def add(commands: Commands) -> None:
    live = commands.add("live", run, configured=True)
    live.add_argument(
        "uri",
        metavar="URI",
        help="zenoh://HOST[/NAMESPACE], foxglove://HOST, mcap:PIPE, or - for MCAP on standard input",
    )
    live.add_argument("--out", type=Path, metavar="MAP", help="map folder to write (default: NAME.map)")
    live.add_argument("--overwrite", action="store_true", help="replace an existing map and files")
    live.add_argument("--for", type=float, dest="most_s", metavar="S", help="map for this many seconds, then save")
    live.add_argument(
        "--wait",
        type=float,
        default=_PATIENCE_S,
        metavar="S",
        help="give up after this time without a usable frame (60)",
    )
    live.add_argument(
        "--status", type=float, default=_STATUS_S, metavar="S", help="interval of the table of topics (10); 0: never"
    )
    add_output(live, "--record", type=Path, metavar="FILE", help="write every received message (MCAP)")
    live.add_argument(
        "--record-limit", type=float, default=_RECORD_GB, metavar="GB", help="maximum size of the recording (50)"
    )
    live.add_argument(
        "--publish",
        action="store_true",
        help="send costmap, objects, markers and map -> odom to the robot, and answer its goals with paths",
    )
    live.add_argument("--publish-only", metavar="PARTS", help="publish only these parts, e.g. costmap,plan")
    live.add_argument(
        "--publish-robot", metavar="NAME|FILE", help="robot of --publish: jackal, spot, turtlebot4, ..., or a TOML file"
    )
    add_run_options(live)
    add_source_options(live)


def run(options: argparse.Namespace) -> int:
    from hickory_stream.engine.mapper import Mapper
    from hickory_stream.engine.play import play
    from hickory_stream.progress import ProgressPrinter
    from hickory_stream.sinks.metrics_sink import MetricsSink
    from hickory_stream.sinks.rerun.viewer import check_viewer, parse_viewer
    from players.live import open_live
    from players.live.routes import is_recording, route_of
    from players.live.transport import ReturnLink

    settings = read_settings(options)
    viewer = parse_viewer(options.viewer)
    check_viewer(viewer)
    for value, name, least in ((options.wait, "--wait", 0.0), (options.status, "--status", 0.0)):
        seconds(value, name, least=least)
    if options.most_s is not None:
        seconds(options.most_s, "--for", least=0.1)
    if not 0 < options.record_limit < float("inf"):
        raise InputError(f"found --record-limit {options.record_limit:g}, expected gigabytes, more than 0")
    publishes = _publishes(options)
    route = route_of(options.uri)
    if publishes is not None and not isinstance(route, ReturnLink):
        raise InputError(f"{options.uri} cannot publish; --publish needs zenoh://, foxglove:// or dds://")
    out = options.out or Path(f"{default_name(options.uri)}.map")
    # Refuse invalid options before an existing map is replaced.
    beside = sinks_beside(options, settings, is_live=True)
    printer = ProgressPrinter(make_style(options))
    recorder: Recorder | None = None
    source: LiveMapSource | None = None
    try:
        mapper = Mapper(settings.mapper, out=out, overwrite=options.overwrite)
        # Meanwhile the robot may connect.
        threading.Thread(target=mapper.rehearse, name="rehearse").start()
        recorder = _recorder(options)
        source = open_live(
            options.uri,
            source_options(options),
            patience_s=options.wait,
            most_s=options.most_s,
            recorder=recorder,
            route=route,
            report=lambda text: _say(text, as_json=options.json),
        )
        if not options.json:
            sys.stderr.write(f"{source.info.kind}: {source.info.uri}\n")
            sys.stderr.writelines(f"  {role}: {stream}\n" for role, stream in source.info.streams)
        for sink in beside:
            if isinstance(sink, MetricsSink):
                sink.watch(partial(_topics, source))
        published = _publisher(source, *publishes) if publishes is not None else None
        beside += [published] if published is not None else []
        options.resumed_by = resume_command(out)
        with _StatusPrinter(source, options.status, as_json=options.json):
            played = play(
                mapper,
                source,
                sinks=all_sinks(options, settings, viewer, beside, status=partial(_status_text, source)),
                mode="playback" if is_recording(options.uri) else "live",
                source_note={"live": options.uri},
                progress=printer,
            )
    finally:
        printer.close()
        if source is not None:
            source.close()
        for sink in beside:
            sink.close()
    if published is not None:
        _tell_published(published, as_json=options.json)
    if recorder is not None and recorder.lost:
        played = replace(played, lost_outputs=(*played.lost_outputs, recorder.lost))
    return finish(options, out, played)


def _publishes(options: argparse.Namespace) -> tuple[Robot, tuple[str, ...]] | None:
    from hickory_stream.sinks.publish_sink import PARTS

    if not options.publish and options.publish_only is None:
        return None
    parts = tuple(options.publish_only.split(",")) if options.publish_only is not None else PARTS
    for part in parts:
        if part not in PARTS:
            raise InputError(f"found --publish-only {options.publish_only}, expected some of {','.join(PARTS)}")
    return robot_of_option(options.publish_robot, "--publish-robot"), parts


def _publisher(source: LiveMapSource, robot: Robot, parts: tuple[str, ...]) -> PublishSink:
    from hickory_stream.sinks.publish_sink import PublishSink

    assert source.return_link is not None
    return PublishSink(robot, source.return_link, odom_frame=source.odom_frame, parts=parts)


def _tell_published(sink: PublishSink, *, as_json: bool) -> None:
    counts = sink.counts()
    if as_json:
        sys.stderr.write(f"{output('live-published', {'event': 'published', **counts})}\n")
        return
    for name, fates in counts["topics"].items():
        sys.stderr.write(f"published {name}: {', '.join(f'{n} {fate}' for fate, n in fates.items())}\n")
    if any(counts["goals"].values()):
        sys.stderr.write(f"goals: {', '.join(f'{n} {fate}' for fate, n in counts['goals'].items() if n)}\n")


def _status_text(source: LiveMapSource) -> str:
    from players.live.status import status_table

    return status_table(source.status())


def _topics(source: LiveMapSource) -> list[dict[str, Any]]:
    topics: list[dict[str, Any]] = source.status().as_dict()["topics"]
    return topics


def _recorder(options: argparse.Namespace) -> Recorder | None:
    if options.record is None:
        return None
    from players.live.recorder import Recorder

    return Recorder(options.record, options.uri, limit_bytes=round(options.record_limit * 1e9))


def default_name(uri: str) -> str:
    """Return the name of a map for an address: its letters and digits, else `live`."""
    return re.sub(r"[^A-Za-z0-9.]+", "-", uri.rpartition("/")[2] or uri).strip("-.") or "live"


def _say(text: str, *, as_json: bool) -> None:
    report = output("live-waiting", {"event": "waiting", "text": text}) if as_json else text
    sys.stderr.write(f"{report}\n")


class _StatusPrinter:
    # While entered, writes the table of topics to standard error at intervals and at the end.
    def __init__(self, source: LiveMapSource, every_s: float, *, as_json: bool) -> None:
        self._source = source
        self._every_s = every_s
        self._as_json = as_json
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="live-status", daemon=True)

    def __enter__(self) -> None:
        if self._every_s > 0:
            self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        if self._every_s > 0:
            self._thread.join()
            self._print(self._source.status())

    def _run(self) -> None:
        # After the last frame the topics do not matter.
        while not self._is_over.wait(self._every_s) and not self._source.has_ended:
            self._print(self._source.status())

    def _print(self, status: LiveStatus) -> None:
        from players.live.status import status_table

        if self._as_json:
            sys.stderr.write(f"{output('live-status', status.as_dict())}\n")
            return
        if sys.stderr.isatty():
            clear_line()
        sys.stderr.write(f"{status_table(status)}\n")
