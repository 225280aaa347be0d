"""`hickory-stream evaluate-navigation`: boxes, meshes and layer 4 as obstacles, against truth: the paper's table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.cli.option_values import positive
from hickory_stream.errors import InputError
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse

    from hickory_stream.cli.commands import Commands


def add(commands: Commands, common: argparse.ArgumentParser, _configured: argparse.ArgumentParser) -> None:
    """Add the command to the command line."""
    evaluate = commands.add_parser(
        "evaluate-navigation",
        parents=[common],
        help="plan on a map's boxes, meshes and layer 4, and compare with truth",
    )
    evaluate.set_defaults(run=run)
    evaluate.add_argument("map", type=Path, metavar="MAP")
    evaluate.add_argument("--truth", type=Path, required=True, metavar="DIR", help="the truth folder of the log")
    evaluate.add_argument("--trials", type=int, default=100, metavar="N", help="starts and goals for each seed")
    evaluate.add_argument("--seeds", type=int, default=5, metavar="N", help="seeds 0 to N-1")
    evaluate.add_argument("--robot", default="point", metavar="NAME|FILE", help="a round robot; its first posture")
    evaluate.add_argument("--cell", type=float, default=0.033, metavar="M", help="the side of a cell, default 0.033 m")
    evaluate.add_argument("--unknown", choices=("blocked", "free"), default="blocked")


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    from hickory_stream.cli.option_values import open_map_at
    from hickory_stream.evaluation.navigation_scene import score_saved_map
    from hickory_stream.evaluation.navigation_table import format_table, table_json
    from hickory_stream.evaluation.truth import load_truth
    from hickory_stream.navigation.robot import load_robot

    trials, seeds = positive(options.trials, "--trials"), positive(options.seeds, "--seeds")
    robot = load_robot(options.robot)
    if robot.num_headings != 1:
        raise InputError(f"the robot {robot.name} is not round; the comparison is for round robots, e.g. point")
    rows = score_saved_map(
        open_map_at(options.map),
        load_truth(options.truth),
        robot,
        cell_m=options.cell,
        unknown=options.unknown,
        trials=trials,
        seeds=range(seeds),
    )
    print(output("evaluate-navigation", {"rows": table_json(rows)}, indent=1) if options.json else format_table(rows))
    return 0
