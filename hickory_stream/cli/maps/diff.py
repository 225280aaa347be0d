"""`hickory-stream diff`: changes of objects between two moments of a run, or between two maps of one place.

`align` relates the two maps first, except with `--other`: both maps then share one world, and boxes match at IoU 0.5.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.cli.commands import NO_ALIGNMENT, Commands
from hickory_stream.cli.output_files import add_output, check_ending, disk_refusals
from hickory_stream.errors import InputError
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse
    from collections.abc import Mapping

    from hickory_stream.changes.stationarity import StayCount
    from hickory_stream.map_folder.saved_map import SavedMap


def add(commands: Commands) -> None:
    diff = commands.add("diff", run)
    diff.add_argument("map", type=Path, metavar="MAP")
    diff.add_argument(
        "first",
        metavar="T1|MAP2",
        nargs="?",
        help="seconds from the first keyframe, or a stamp like 17...ns; or a later map of the same place",
    )
    diff.add_argument("second", metavar="T2", nargs="?")
    diff.add_argument(
        "--other",
        type=Path,
        metavar="MAP",
        help="compare the ends of two maps instead, e.g. of a live run and its replay",
    )
    add_output(diff, "-o", "--out", type=Path, metavar="HTML", help="write a page with plan and pictures")
    # Not `add_output`: an existing file is updated.
    diff.add_argument(
        "--stationarity",
        type=Path,
        metavar="FILE",
        help="two maps: update the probability that each object stays, from the file of the first map",
    )


def run(options: argparse.Namespace) -> int:
    from hickory_stream.base.atomic_files import write_output
    from hickory_stream.changes.run_page import run_page
    from hickory_stream.changes.within_run import changes_within_run
    from hickory_stream.cli.option_values import open_map_at
    from hickory_stream.map_folder.history.time_travel import stamp_of

    check_ending(options.out, ".html")
    if options.first is not None and options.second is None and Path(options.first).is_dir():
        return _between_days(options, Path(options.first))
    if options.stationarity is not None:
        raise InputError("found --stationarity without a second map, expected MAP MAP2 --stationarity FILE")
    if options.out is not None and options.other is not None:
        raise InputError("found -o with --other, expected MAP MAP2 -o page.html, or MAP T1 T2 -o page.html")
    if (options.other is None) != (options.second is not None) or (options.other is not None and options.first):
        raise InputError("expected either T1 and T2, or --other MAP")
    saved = open_map_at(options.map)
    if options.other is not None:
        return _compare(options, saved, open_map_at(options.other))
    before, after = (saved.as_known_at(stamp_of(options.map, text)) for text in (options.first, options.second))
    changes = changes_within_run(before, after)
    if options.out is not None:
        title = f"{options.map}, from {options.first} to {options.second}"
        with disk_refusals(options.out, "page"):
            write_output(options.out, run_page(title, before, after, changes, options.map).encode())
    if options.json:
        print(output("diff", {"changes": [dataclasses.asdict(change) for change in changes]}, indent=1))
    else:
        width = max((len(change.kind) for change in changes), default=0)
        for change in changes:
            sure = "" if change.probability is None else f"; probability {change.probability:.2f}"
            print(f"#{change.object_id:<5} {change.kind:<{width}}  {change.text}{sure}")
        if not changes:
            print("nothing has changed")
    return 0


def _between_days(options: argparse.Namespace, later: Path) -> int:
    from hickory_stream.alignment.align import align
    from hickory_stream.alignment.answer import Alignment
    from hickory_stream.base.atomic_files import write_output
    from hickory_stream.changes.compare import compare_maps
    from hickory_stream.changes.page import changes_page
    from hickory_stream.changes.records import changes_text
    from hickory_stream.changes.stationarity import (
        Stationarity,
        after_comparison,
        read_stationarity,
        write_stationarity,
    )
    from hickory_stream.cli.maps.align import answer_text, objects_of
    from hickory_stream.cli.option_values import open_map_at

    first, second = open_map_at(options.map), open_map_at(later)
    for saved in (first, second):
        if not any(len(submap.observed_space.free) for submap in saved.snapshot.submaps):
            raise InputError(
                f"{saved.folder} has no observed space, which proves that objects are gone; map its log again"
            )
    before: Mapping[int, StayCount] = {}
    if options.stationarity is not None and options.stationarity.exists():
        before = read_stationarity(options.stationarity, first.manifest.digest).counts
    answer = align(objects_of(first), objects_of(second))
    if not isinstance(answer, Alignment):
        if options.json:
            print(output("diff-refused", {"aligned": False, "refusal": answer.refusal.value, "reason": answer.reason}))
        else:
            print(answer_text(answer))
        return NO_ALIGNMENT
    found = compare_maps(
        first.snapshot,
        second.snapshot,
        answer.a_from_b,
        answer.translation_sigma_m,
        with_feature=first.manifest.extractor == second.manifest.extractor,
    )
    if options.out is not None:
        with disk_refusals(options.out, "page"):
            write_output(options.out, changes_page(first, second, found).encode())
    known = None
    if options.stationarity is not None:
        digest = second.manifest.digest
        if digest is None:
            raise InputError(f"{second.folder} is not finished; wait for the end of its run")
        known = Stationarity(digest=digest, counts=after_comparison(before, found))
        with disk_refusals(options.stationarity, "file"):
            write_output(options.stationarity, write_stationarity(known))
    if options.json:
        report = {"a_from_b": found.a_from_b.tolist(), "sigma_m": found.sigma_m}
        print(output("diff-days", report | {"objects": [dataclasses.asdict(one) for one in found.changes]}, indent=1))
    else:
        print(changes_text(found))
        if known is not None:
            movable = ", ".join(f"#{i}" for i in known.movable())
            print(f"{options.stationarity}: {f'{movable} tend to move' if movable else 'no object tends to move yet'}")
    return 0


def _compare(options: argparse.Namespace, first: SavedMap, second: SavedMap) -> int:
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
    print(f"{len(both)} objects are in both (box overlap {STRICT_IOU:g} and more)")
    for path, ids in ((options.map, only_a), (options.other, only_b)):
        print(f"{len(ids)} only in {path}" + (f": {', '.join(map(str, ids))}" if ids else ""))
    return 0
