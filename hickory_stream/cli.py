"""The command line. Imports what a command needs only when it runs, so that `--help` answers at once.

Exit status: 0 done; 1 an internal failure; 2 something outside is not as it must be; 130 stopped by a signal (the map
is saved).
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hickory_stream import __version__
from hickory_stream.errors import ConfigError, HickoryError, InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hickory_stream.engine.session import MapFolder
    from hickory_stream.ports import Sink
    from hickory_stream.progress import Style
    from hickory_stream.settings import Settings

_STOPPED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status."""
    options = _parser().parse_args(arguments)
    logging.basicConfig(level=logging.DEBUG if options.debug else logging.WARNING, format="%(levelname)s: %(message)s")
    try:
        status: int = options.run(options)
    except HickoryError as error:
        _fail(str(error), options)
        return error.exit_status
    except KeyboardInterrupt:
        _fail("cancelled; what was saved before is kept", options)
        return _STOPPED
    except BrokenPipeError:
        return 0
    except Exception as error:
        if options.debug:
            raise
        _fail(f"internal failure, {type(error).__name__}: {error}; run with --debug to see where", options)
        return 1
    return status


def _fail(text: str, options: argparse.Namespace) -> None:
    message = " ".join(text.split())  # one line, whatever a library had to say
    sys.stderr.write(f"hickory-stream: {message}\n")
    if getattr(options, "json", False):
        print(json.dumps({"event": "error", "message": message}))


# ---- commands --------------------------------------------------------------------------------------------------------


def _play(options: argparse.Namespace) -> int:
    from hickory_stream.engine.play import play
    from hickory_stream.progress import ProgressPrinter
    from hickory_stream.sinks.rerun_viewer import parse_viewer
    from players import SourceOptions, open_source
    from players.first_frames import FirstFrames

    settings = _settings(options)
    viewer = parse_viewer(options.viewer)
    rate = _rate(options.rate)
    source = open_source(
        options.source,
        SourceOptions(
            color_topic=options.color_topic,
            depth_topic=options.depth_topic,
            color_info_topic=options.color_info_topic,
            depth_info_topic=options.depth_info_topic,
            pose_topic=options.pose_topic,
            pose_frame=options.pose_frame,
            sync_tolerance_ns=_nanoseconds(options.sync_tolerance),
            profile=options.profile,
        ),
    )
    if options.frames is not None:
        source = FirstFrames(source, _positive(options.frames, "--frames"))
    out = options.out or Path(f"{Path(options.source).resolve().stem}.map")
    style: Style = "json" if options.json else "bar" if sys.stderr.isatty() else "lines"
    if not options.json:
        sys.stderr.write(f"{source.info.kind}: {source.info.uri}\n")
        sys.stderr.writelines(f"  {role}: {stream}\n" for role, stream in source.info.streams)

    def sinks(folder: MapFolder) -> list[tuple[Sink, bool]]:
        return _sinks(folder, settings, viewer, options.rrd)

    printer = ProgressPrinter(style)
    try:
        played = play(
            source,
            settings.mapper,
            out=out,
            overwrite=options.overwrite,
            sinks=sinks,
            rate=rate,
            loops=_positive(options.loop, "--loop"),
            progress=printer,
        )
    finally:
        printer.close()
        source.close()
    objects = played.snapshot.objects if played.snapshot is not None else ()
    if options.json:
        print(
            json.dumps(
                {
                    "event": "finished",
                    "map": str(out),
                    "finished_cleanly": played.finished_cleanly,
                    "digest": played.digest,
                    "objects": len(objects),
                    "objects_with_shape": sum(o.shape is not None for o in objects),
                    "ledger": json.loads((out / "ledger.json").read_text()),
                }
            )
        )
    else:
        print(f"{out}: {len(objects)} objects, {sum(o.shape is not None for o in objects)} with all four layers")
    return 0 if played.finished_cleanly else _STOPPED


def _sinks(folder: MapFolder, settings: Settings, viewer: Any, rrd: Path | None) -> list[tuple[Sink, bool]]:
    """Return the sinks of a playback, each with whether the run must stop when it fails."""
    from hickory_stream.sinks.disk_sink import DiskSink
    from hickory_stream.sinks.rerun_sink import RerunSink
    from hickory_stream.sinks.rerun_viewer import ViewerKind

    made: list[tuple[Sink, bool]] = [(DiskSink(folder, settings.disk), True)]
    if rrd is not None or viewer.kind is not ViewerKind.NONE:
        shown = RerunSink(settings.rerun, folder.path, rrd, viewer)
        if shown.web_url:
            sys.stderr.write(f"viewer: {shown.web_url}\n")
        made.append((shown, False))
    return made


def _inspect(options: argparse.Namespace) -> int:
    from hickory_stream.engine.session import open_map
    from hickory_stream.evaluation.inspect import as_json, format_table, summarize

    summary = summarize(open_map(options.map))
    print(json.dumps(as_json(summary), indent=1) if options.json else format_table(summary))
    return 0


def _render(options: argparse.Namespace) -> int:
    import cv2

    from hickory_stream.engine.session import open_map
    from hickory_stream.evaluation.render import render_map

    layers = _layers(options.layers)
    width, height = _size(options.size)
    saved = open_map(options.map)
    picture = render_map(saved, layers, (width, height))
    encoded = cv2.imencode(".png", picture[..., ::-1])[1].tobytes()
    try:
        options.out.write_bytes(encoded)
    except OSError as error:
        raise InputError(f"cannot write the picture {options.out}: {error.strerror}") from error
    if options.json:
        print(json.dumps({"picture": str(options.out), "width": width, "height": height, "layers": sorted(layers)}))
    return 0


def _evaluate(options: argparse.Namespace) -> int:
    from hickory_stream.evaluation.explain import DEFINITIONS, as_json, format_evaluation

    if options.explain:
        print(json.dumps({"definitions": DEFINITIONS}) if options.json else DEFINITIONS)
        if options.map is None:
            return 0
    if options.map is None or options.truth is None:
        raise InputError("evaluate needs a MAP and --truth DIR, or --explain alone")
    from hickory_stream.engine.session import open_map
    from hickory_stream.evaluation.evaluate import evaluate
    from hickory_stream.evaluation.truth import load_truth

    saved, truth = open_map(options.map), load_truth(options.truth)
    evaluation = evaluate(saved, truth)
    if options.html is not None:
        from hickory_stream.evaluation.page import write_page

        try:
            write_page(options.html, saved, truth, evaluation)
        except OSError as error:
            raise InputError(f"cannot write the page {options.html}: {error.strerror}") from error
    print(json.dumps(as_json(evaluation), indent=1) if options.json else format_evaluation(evaluation))
    return 0


def _evaluate_views(options: argparse.Namespace) -> int:
    import dataclasses
    import tempfile

    from hickory_stream.evaluation.truth import load_truth
    from hickory_stream.evaluation.view_strategies import STRATEGIES, compare, evaluate_strategy, format_comparison
    from hickory_stream.progress import ProgressPrinter
    from players import open_source

    settings = _settings(options)
    if options.truth is not None and len(options.truth) != len(options.source):
        raise InputError(
            f"found {len(options.source)} logs and {len(options.truth)} --truth; expected one for each log"
        )
    folders = options.truth or [Path(source).with_suffix(".truth") for source in options.source]
    truths = [load_truth(folder) for folder in folders]
    style: Style = "json" if options.json else "bar" if sys.stderr.isatty() else "lines"

    def sinks(folder: MapFolder) -> list[tuple[Sink, bool]]:
        from hickory_stream.sinks.disk_sink import DiskSink

        return [(DiskSink(folder, settings.disk), True)]

    evaluations: dict[str, list[Any]] = {}
    with tempfile.TemporaryDirectory() as temporary:
        for strategy in STRATEGIES:
            for i, (log, truth) in enumerate(zip(options.source, truths, strict=True)):
                if not options.json:
                    sys.stderr.write(f"{strategy} on {log}\n")
                out = (options.out or Path(temporary)) / f"{i}-{strategy}"
                source = open_source(log)
                printer = ProgressPrinter(style)
                try:
                    found = evaluate_strategy(source, truth, settings.mapper, strategy, out, sinks, printer)
                finally:
                    printer.close()
                    source.close()
                evaluations.setdefault(strategy, []).append(found)
    scores = compare(evaluations)
    if options.json:
        print(json.dumps({"event": "finished", "strategies": [dataclasses.asdict(score) for score in scores]}))
    else:
        print(format_comparison(scores))
    return 0


def _config_dump(options: argparse.Namespace) -> int:
    from hickory_stream.config import to_toml

    settings = _settings(options)
    if options.json:
        import dataclasses

        print(json.dumps(dataclasses.asdict(settings), indent=1))
    else:
        print(to_toml(settings), end="")
    return 0


def _config_check(options: argparse.Namespace) -> int:
    _settings(options)
    print(json.dumps({"ok": True}) if options.json else f"{options.config}: ok")
    return 0


# ---- values ----------------------------------------------------------------------------------------------------------


def _settings(options: argparse.Namespace) -> Settings:
    from dataclasses import replace

    from hickory_stream.config import read_config
    from hickory_stream.settings import Settings

    settings = read_config(Settings, options.config, tuple(options.set or ()))
    if getattr(options, "workers", None) is not None:
        if options.workers < 1:
            raise ConfigError(f"found --workers {options.workers}, expected at least 1")
        mapper = settings.mapper
        settings = replace(settings, mapper=replace(mapper, run=replace(mapper.run, workers=options.workers)))
    return settings


def _rate(text: str) -> float | None:
    if text == "max":
        return None
    try:
        rate = float(text)
    except ValueError:
        rate = 0.0
    if not 0 < rate < float("inf"):
        raise InputError(f"found --rate {text}, expected max or a number above 0, e.g. 1.0 for real time")
    return rate


def _positive(number: int, option: str) -> int:
    if number < 1:
        raise InputError(f"found {option} {number}, expected at least 1")
    return number


def _nanoseconds(tolerance_ms: float | None) -> int | None:
    if tolerance_ms is None:
        return None
    if not 0 <= tolerance_ms < float("inf"):
        raise InputError(f"found --sync-tolerance {tolerance_ms:g}, expected milliseconds, 0 or more")
    return round(tolerance_ms * 1e6)


def _layers(text: str) -> set[int]:
    parts = {part.strip() for part in text.split(",")}
    if not parts <= {"1", "2", "3", "4"}:
        raise InputError(f"found --layers {text}, expected some of 1,2,3,4")
    return {int(part) for part in parts}


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdigit() and height.isdigit() and 64 <= int(width) <= 8192 and 64 <= int(height) <= 8192):
        raise InputError(f"found --size {text}, expected WIDTHxHEIGHT of 64 to 8192 pixels, e.g. 1600x800")
    return int(width), int(height)


# ---- the parser ------------------------------------------------------------------------------------------------------


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="hickory-stream",
        description="Streaming object mapper: posed RGB-D in, a map of objects with four layers out.",
    )
    parser.add_argument("--version", action="version", version=f"hickory-stream {__version__}")
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--json", action="store_true", help="print JSON for machines")
    common.add_argument("--debug", action="store_true", help="log more, and show the trace of an internal failure")
    configured = argparse.ArgumentParser(add_help=False)
    configured.add_argument("--config", type=Path, metavar="TOML", help="configuration file; see `config dump`")
    configured.add_argument(
        "--set", action="append", metavar="SECTION.KEY=VALUE", help="override one value; repeatable"
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_play(commands.add_parser("play", parents=[common, configured], help="map a recorded log"))
    _add_inspect(commands.add_parser("inspect", parents=[common], help="show what a map holds"))
    _add_render(commands.add_parser("render", parents=[common], help="draw a map; needs no screen"))
    _add_evaluate(commands.add_parser("evaluate", parents=[common], help="compare a map with truth"))
    _add_evaluate_views(
        commands.add_parser("evaluate-views", parents=[common, configured], help="compare the ways to choose views")
    )
    config = commands.add_parser("config", help="show or check a configuration").add_subparsers(
        required=True, metavar="ACTION"
    )
    dump = config.add_parser("dump", parents=[common, configured], help="print the whole configuration as TOML")
    dump.set_defaults(run=_config_dump)
    check = config.add_parser("check", parents=[common], help="check a configuration file")
    check.add_argument("config", type=Path, metavar="TOML")
    check.set_defaults(run=_config_check, set=None)
    return parser


def _add_play(play: argparse.ArgumentParser) -> None:
    play.set_defaults(run=_play)
    play.add_argument("source", help="an MCAP file, a ROS 1 or ROS 2 bag, or a folder of images")
    play.add_argument("--out", type=Path, metavar="MAP", help="the map folder to make (default: NAME.map)")
    play.add_argument("--overwrite", action="store_true", help="replace the map that is there")
    play.add_argument("--rate", default="max", help="max (default), or a factor of real time, e.g. 1.0")
    play.add_argument("--loop", type=int, default=1, metavar="N", help="play the log N times in one run")
    play.add_argument("--frames", type=int, metavar="N", help="play only the first N frames")
    play.add_argument(
        "--workers", type=int, metavar="N", help="child processes that build shapes; do not change the map"
    )
    play.add_argument("--viewer", default="auto", help="auto (default), none, spawn, web or connect=URL")
    play.add_argument("--rrd", type=Path, metavar="FILE", help="write a Rerun recording")
    topics = play.add_argument_group("streams of a log; all are discovered if not named")
    for role in ("color", "depth", "color-info", "depth-info", "pose"):
        topics.add_argument(f"--{role}-topic", metavar="TOPIC")
    topics.add_argument("--pose-frame", metavar="FRAME", help="the frame whose pose the pose topic gives")
    topics.add_argument("--sync-tolerance", type=float, metavar="MS", help="between colour and depth (half a period)")
    topics.add_argument("--profile", metavar="NAME", help="calibration of an image folder: a name or a TOML file")


def _add_inspect(inspect: argparse.ArgumentParser) -> None:
    inspect.set_defaults(run=_inspect)
    inspect.add_argument("map", type=Path, metavar="MAP")


def _add_render(render: argparse.ArgumentParser) -> None:
    render.set_defaults(run=_render)
    render.add_argument("map", type=Path, metavar="MAP")
    render.add_argument("-o", "--out", type=Path, default=Path("map.png"), metavar="PNG")
    render.add_argument("--layers", default="1,2", help="which layers to draw, e.g. 1,2 (default) or 3,4")
    render.add_argument("--size", default="1600x800", metavar="WxH")


def _add_evaluate(evaluate: argparse.ArgumentParser) -> None:
    evaluate.set_defaults(run=_evaluate)
    evaluate.add_argument("map", type=Path, metavar="MAP", nargs="?")
    evaluate.add_argument("--truth", type=Path, metavar="DIR", help="the truth folder of the log that was played")
    evaluate.add_argument("--explain", action="store_true", help="say what every figure means")
    evaluate.add_argument("--html", type=Path, metavar="PAGE", help="write a page with pictures, worst objects first")


def _add_evaluate_views(views: argparse.ArgumentParser) -> None:
    views.set_defaults(run=_evaluate_views)
    views.add_argument("source", nargs="+", metavar="LOG", help="one or more logs; each is played once per strategy")
    views.add_argument(
        "--truth", type=Path, action="append", metavar="DIR", help="for each LOG (default: LOG's .truth)"
    )
    views.add_argument("--out", type=Path, metavar="DIR", help="keep the maps there")
    views.add_argument("--workers", type=int, metavar="N", help="child processes that build shapes")


if __name__ == "__main__":
    sys.exit(main())
