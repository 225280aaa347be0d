"""`hickory-stream evaluate`: compare a map with truth."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.cli.output_files import add_output, disk_refusals
from hickory_stream.errors import InputError
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse

    from hickory_stream.cli.commands import Commands
    from hickory_stream.evaluation.match import TrueBox


def add(commands: Commands) -> None:
    evaluate = commands.add("evaluate", run)
    evaluate.add_argument("map", type=Path, metavar="MAP", nargs="?")
    evaluate.add_argument(
        "--truth",
        type=Path,
        metavar="DIR|FILE",
        help="truth of the log: a folder, a data set, or boxes labelled by hand",
    )
    evaluate.add_argument("--explain", action="store_true", help="define every figure")
    add_output(evaluate, "--html", type=Path, metavar="PAGE", help="write a page with pictures, worst objects first")


def run(options: argparse.Namespace) -> int:
    from hickory_stream.evaluation.explain import DEFINITIONS, format_evaluation

    if options.explain:
        print(output("evaluate-explain", {"definitions": DEFINITIONS}) if options.json else DEFINITIONS)
        if options.map is None:
            return 0
    if options.map is None or options.truth is None:
        raise InputError("evaluate needs a MAP and --truth DIR, or --explain alone")
    from hickory_stream.cli.option_values import open_map_at
    from hickory_stream.evaluation.data_sets import open_boxes, open_truth
    from hickory_stream.evaluation.evaluate import evaluate
    from hickory_stream.evaluation.truth import TRUTH_FILE

    folder: Path = options.truth.parent if options.truth.name == TRUTH_FILE else options.truth
    boxes = open_boxes(folder)
    if boxes is not None:
        return _labels(options, boxes)
    saved, truth = open_map_at(options.map), open_truth(folder)
    evaluation = evaluate(saved, truth)
    if options.html is not None:
        from hickory_stream.evaluation.page import write_page

        with disk_refusals(options.html, "page"):
            write_page(options.html, saved, truth, evaluation)
    print(output("evaluate", asdict(evaluation), indent=1) if options.json else format_evaluation(evaluation))
    return 0


def _labels(options: argparse.Namespace, labels: tuple[TrueBox, ...]) -> int:
    from hickory_stream.cli.option_values import open_map_at
    from hickory_stream.evaluation.explain import format_labels
    from hickory_stream.evaluation.labels import score_labels
    from hickory_stream.evaluation.match import meshes_of
    from hickory_stream.evaluation.reach import depth_on_labels

    if options.html is not None:
        raise InputError("found --html with labelled boxes, expected a truth folder: boxes have no surfaces to show")
    saved = open_map_at(options.map)
    score = score_labels(saved.snapshot, meshes_of(saved), labels, depth_on_labels(saved, labels))
    if score.num_objects and len(score.stray_ids) == score.num_objects:
        sys.stderr.write("note: no object lies on a label; labels must be in the world of the poses that were played\n")
    print(output("evaluate-labels", asdict(score), indent=1) if options.json else format_labels(score))
    return 0
