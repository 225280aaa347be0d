"""`hickory-stream evaluate-alignment`: the paper's table over pairs of maps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.cli.maps.align import METHODS, objects_of
from hickory_stream.errors import InputError
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse

    import numpy as np
    from numpy.typing import NDArray

    from hickory_stream.cli.commands import Commands
    from hickory_stream.map_folder.saved_map import SavedMap


def add(commands: Commands, common: argparse.ArgumentParser, _configured: argparse.ArgumentParser) -> None:
    """Add the command to the command line."""
    evaluate = commands.add_parser(
        "evaluate-alignment", parents=[common], help="align pairs of maps and compare with truth: the paper's table"
    )
    evaluate.set_defaults(run=run)
    evaluate.add_argument("maps", type=Path, metavar="A B", nargs="+", help="two maps for each scene")
    evaluate.add_argument(
        "--truth",
        type=Path,
        nargs="+",
        default=[],
        metavar="TRUTH",
        help="one for each map: its truth folder, <robot>_gt_odom.csv or TUM file, in a frame that both share",
    )
    evaluate.add_argument(
        "--method", nargs="+", choices=METHODS, default=["sq"], metavar="METHOD", help=f"some of {', '.join(METHODS)}"
    )


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    from hickory_stream.alignment.methods import align_by
    from hickory_stream.cli.option_values import open_map_at
    from hickory_stream.evaluation.alignment_table import format_table, row_of, table_json

    paths, truths = options.maps, options.truth
    if len(paths) % 2:
        raise InputError(f"found {len(paths)} maps, expected two for each scene: A B [A B ...]")
    if truths and len(truths) != len(paths):
        raise InputError(f"found {len(truths)} truths for {len(paths)} maps, expected one for each map")
    rows = []
    for i in range(0, len(paths), 2):
        saved_a, saved_b = open_map_at(paths[i]), open_map_at(paths[i + 1])
        true_a_from_b = _truth(saved_a, saved_b, truths[i], truths[i + 1]) if truths else None
        scene = f"{paths[i].name} {paths[i + 1].name}"
        map_a, map_b = objects_of(saved_a), objects_of(saved_b)
        rows += [row_of(scene, method, align_by(method, map_a, map_b), true_a_from_b) for method in options.method]
    rows.sort(key=lambda row: options.method.index(row.method))
    print(output("evaluate-alignment", {"rows": table_json(rows)}, indent=1) if options.json else format_table(rows))
    return 0


def _truth(saved_a: SavedMap, saved_b: SavedMap, truth_a: Path, truth_b: Path) -> NDArray[np.float64]:
    """Return the true a_from_b; raises `RecordingError`."""
    from hickory_stream.evaluation.alignment_truth import read_true_trajectory, world_from_map
    from hickory_stream.geometry.rigid import invert

    world_from_a, world_from_b = (
        world_from_map(saved.snapshot, read_true_trajectory(truth), saved.folder.name)
        for saved, truth in ((saved_a, truth_a), (saved_b, truth_b))
    )
    return invert(world_from_a) @ world_from_b
