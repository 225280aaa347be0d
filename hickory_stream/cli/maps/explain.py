"""`hickory-stream explain`: why a map lacks an object, or how an object came into it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.errors import InputError, MapFolderError
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from hickory_stream.cli.commands import Commands


def add(commands: Commands) -> None:
    explain = commands.add("explain", run)
    explain.add_argument("map", type=Path, metavar="MAP")
    what = explain.add_mutually_exclusive_group(required=True)
    what.add_argument("--at-pixel", metavar="FRAME,U,V", help="pixel: a frame of the timeline `frame`, column and row")
    what.add_argument("--point", metavar="X,Y,Z", help="position in the map, metres")
    what.add_argument("--truth", type=Path, metavar="DIR", help="all missed true objects, and all false objects")
    explain.add_argument("--object", type=int, metavar="ID", help="only this true object, by keyframe")
    explain.add_argument("--log", nargs="+", metavar="LOG", help="the log, for depth that the journal lacks")


def run(options: argparse.Namespace) -> int:
    if options.object is not None and options.truth is None:
        raise InputError(f"found --object {options.object} without --truth DIR, expected both")
    if options.log is not None and options.at_pixel is None:
        raise InputError("found --log without --at-pixel: a point and truth need the journal only")
    return _truth(options) if options.truth is not None else _place(options)


def _truth(options: argparse.Namespace) -> int:
    from dataclasses import asdict

    from hickory_stream.cli.option_values import open_map_at
    from hickory_stream.evaluation.data_sets import open_truth
    from hickory_stream.evaluation.why import investigate, story_of, why_of
    from hickory_stream.evaluation.why_text import object_text, why_text

    truth = open_truth(options.truth)
    if options.object is not None and options.object not in {item.id for item in truth.objects}:
        known = ", ".join(str(item.id) for item in truth.objects)
        raise InputError(f"found --object {options.object}, expected the id of a true object: {known}")
    found = investigate(open_map_at(options.map), truth)
    if options.object is not None:
        story = story_of(found, options.object)
        print(output("explain-object", asdict(story), indent=1) if options.json else object_text(story))
        return 0
    why = why_of(found)
    print(output("explain-truth", asdict(why), indent=1) if options.json else why_text(why))
    return 0


def _place(options: argparse.Namespace) -> int:
    from dataclasses import asdict

    import numpy as np

    from hickory_stream.cli.option_values import open_map_at
    from hickory_stream.evaluation.why_text import place_text
    from hickory_stream.inspection.pixel_history import story_of_pixel
    from hickory_stream.inspection.point_history import story_of_point

    if options.point is not None:
        point = np.array(_three_numbers(options.point, "--point", "X,Y,Z in metres, e.g. --point=1.5,-2,0.8"))
        open_map_at(options.map)
        story = story_of_point(options.map, point)
    else:
        expected = "FRAME,U,V, a frame's index, a column and a row, e.g. --at-pixel 120,320,240"
        frame, u, v = _three_numbers(options.at_pixel, "--at-pixel", expected)
        if frame != int(frame):
            raise InputError(f"found --at-pixel {options.at_pixel}, expected {expected}")
        open_map_at(options.map)
        depth_of = None if options.log is None else _depth_reader(options.map, options.log)
        story = story_of_pixel(options.map, int(frame), (u, v), depth_of)
    print(output("explain", asdict(story), indent=1) if options.json else place_text(story))
    return 0


def _three_numbers(text: str, option: str, expected: str) -> tuple[float, float, float]:
    try:
        a, b, c = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(f"found {option} {text}, expected {expected}") from error
    if not all(abs(value) < float("inf") for value in (a, b, c)):
        raise InputError(f"found {option} {text}, expected three finite numbers")
    return a, b, c


def _depth_reader(path: Path, logs: list[str]) -> Callable[[int], NDArray[np.float32]]:
    def depth_of(stamp_ns: int) -> NDArray[np.float32]:
        from hickory_stream.map_folder.manifest import read_manifest
        from players import open_from_note

        recorded = read_manifest(path).run.get("source")
        if not isinstance(recorded, dict):
            raise MapFolderError(f"{path} has no record of its log; leave out --log")
        source = open_from_note({**recorded, "uris": logs})
        try:
            for raw in source.frames():
                if raw.stamp_ns == stamp_ns:
                    return raw.decode().depth_m
        finally:
            source.close()
        raise InputError(f"{', '.join(logs)} has no frame of the stamp {stamp_ns}ns; name the log of {path}")

    return depth_of
