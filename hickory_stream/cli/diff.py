"""`hickory-stream diff`: what happened to the objects between two moments of a run, or how two maps of it differ.

Two maps: a live one, and that of its recording, in the same world. Objects are the same whose boxes overlap by half.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.errors import InputError
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse

    from hickory_stream.cli.commands import Commands
    from hickory_stream.engine.saved_map import SavedMap


def add(commands: Commands, common: argparse.ArgumentParser, _configured: argparse.ArgumentParser) -> None:
    """Add the command to the command line."""
    diff = commands.add_parser("diff", parents=[common], help="what happened between two moments of a run")
    diff.set_defaults(run=run)
    diff.add_argument("map", type=Path, metavar="MAP")
    diff.add_argument("first", metavar="T1", nargs="?", help="seconds from the first keyframe, or a stamp like 17...ns")
    diff.add_argument("second", metavar="T2", nargs="?")
    diff.add_argument(
        "--other",
        type=Path,
        metavar="MAP",
        help="compare the ends of two maps instead, e.g. of a session and its replay",
    )


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    from hickory_stream.cli.values import open_map_at
    from hickory_stream.engine.history.time_travel import stamp_of

    if (options.other is None) != (options.second is not None) or (options.other is not None and options.first):
        raise InputError("found neither T1 and T2 nor --other MAP, or both; expected one of them")
    saved = open_map_at(options.map)
    if options.other is not None:
        return _compare(options, saved, open_map_at(options.other))
    changes = saved.diff(stamp_of(options.map, options.first), stamp_of(options.map, options.second))
    if options.json:
        print(output("diff", {"changes": [dataclasses.asdict(change) for change in changes]}, indent=1))
    else:
        width = max((len(change.kind) for change in changes), default=0)
        for change in changes:
            print(f"#{change.object_id:<5} {change.kind:<{width}}  {change.text}")
        if not changes:
            print("nothing has changed")
    return 0


def _compare(options: argparse.Namespace, first: SavedMap, second: SavedMap) -> int:
    """Say which objects of two maps are the same, and which are in one alone."""
    from hickory_stream.evaluation.match import STRICT_IOU, match_boxes

    ours, theirs = first.snapshot.objects, second.snapshot.objects
    matches = match_boxes([item.box for item in ours], [item.box for item in theirs], STRICT_IOU)
    both = [{"a": ours[m.truth_index].id, "b": theirs[m.map_index].id, "iou": m.iou} for m in matches]
    known_a, known_b = {pair["a"] for pair in both}, {pair["b"] for pair in both}
    only_a = [item.id for item in ours if item.id not in known_a]
    only_b = [item.id for item in theirs if item.id not in known_b]
    if options.json:
        print(output("diff-maps", {"both": both, "only_in_a": only_a, "only_in_b": only_b}, indent=1))
        return 0
    print(f"{len(both)} objects are in both (boxes overlap by {STRICT_IOU:g} and more)")
    for path, ids in ((options.map, only_a), (options.other, only_b)):
        print(f"{len(ids)} only in {path}" + (f": {', '.join(map(str, ids))}" if ids else ""))
    return 0
