"""`hickory-stream evaluate`: compare a map with truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.cli.output_files import add_output, disk_refusals
from hickory_stream.errors import InputError
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse

    from hickory_stream.cli.commands import Commands


def add(commands: Commands) -> None:
    evaluate = commands.add("evaluate", run)
    evaluate.add_argument("map", type=Path, metavar="MAP", nargs="?")
    evaluate.add_argument("--truth", type=Path, metavar="DIR", help="truth folder of the log")
    evaluate.add_argument("--explain", action="store_true", help="define every figure")
    add_output(evaluate, "--html", type=Path, metavar="PAGE", help="write a page with pictures, worst objects first")


def run(options: argparse.Namespace) -> int:
    from hickory_stream.evaluation.explain import DEFINITIONS, as_json, format_evaluation

    if options.explain:
        print(output("evaluate-explain", {"definitions": DEFINITIONS}) if options.json else DEFINITIONS)
        if options.map is None:
            return 0
    if options.map is None or options.truth is None:
        raise InputError("evaluate needs a MAP and --truth DIR, or --explain alone")
    from hickory_stream.cli.option_values import open_map_at
    from hickory_stream.evaluation.evaluate import evaluate
    from hickory_stream.evaluation.truth import load_truth

    saved, truth = open_map_at(options.map), load_truth(options.truth)
    evaluation = evaluate(saved, truth)
    if options.html is not None:
        from hickory_stream.evaluation.page import write_page

        with disk_refusals(options.html, "page"):
            write_page(options.html, saved, truth, evaluation)
    print(output("evaluate", as_json(evaluation), indent=1) if options.json else format_evaluation(evaluation))
    return 0
