"""The paper's comparisons on one's own logs and maps: `tools/paper views|alignment|navigation ...`."""

import argparse
import dataclasses
import sys
import tempfile
from pathlib import Path
from typing import Literal

from hickory_stream.alignment.methods import align_by
from hickory_stream.base.config_text import read_config
from hickory_stream.base.json_text import dumps
from hickory_stream.cli.maps.align import METHODS, objects_of
from hickory_stream.cli.option_values import open_map_at, positive
from hickory_stream.config import MapperConfig
from hickory_stream.engine.shape_jobs.generators.choose import check_generator, generating
from hickory_stream.engine.shape_jobs.generators.spec import find_spec, generators_folder, read_spec
from hickory_stream.errors import ConfigError, InputError
from hickory_stream.evaluation.truth import load_truth
from hickory_stream.navigation.robot import load_robot
from hickory_stream.ports import Reconstructor
from hickory_stream.progress import ProgressPrinter, Style
from hickory_stream.settings import Settings
from hickory_stream.shapes.build import make_reconstructor
from hickory_stream.sinks.disk_sink import DiskSink
from players import open_source
from tools.evaluation import alignment_table, navigation_table
from tools.evaluation.alignment_truth import true_a_from_b
from tools.evaluation.views.comparison import compare, format_comparison
from tools.evaluation.views.trials import ViewTrial, try_views

EMBEDDED: Literal["single_view"] = "single_view"


def main(arguments: list[str]) -> int:
    """Compare on the named logs or maps, and print the table."""
    # Raises HickoryError: a log, map or truth cannot be read, or does not fit the others.
    parser = argparse.ArgumentParser(prog="tools/paper", description=__doc__)
    commands = parser.add_subparsers(required=True)
    views = commands.add_parser("views", help="compare the strategies of choosing views on logs")
    views.set_defaults(run=_views)
    views.add_argument("source", nargs="+", metavar="LOG", help="one or more logs; each is played once")
    views.add_argument("--truth", type=Path, action="append", metavar="DIR", help="a folder for each LOG (.truth)")
    views.add_argument("--reconstructor", action="append", metavar="NAME", help="single_view, or a generator's name")
    views.add_argument("--out", type=Path, metavar="DIR", help="keep the maps there")
    views.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="set a configuration key")
    alignment = commands.add_parser("alignment", help="align pairs of maps by several methods")
    alignment.set_defaults(run=_alignment)
    alignment.add_argument("maps", type=Path, metavar="A B", nargs="+", help="two maps for each scene")
    alignment.add_argument("--truth", type=Path, nargs="+", default=[], metavar="TRUTH", help="a trajectory per map")
    alignment.add_argument("--method", nargs="+", choices=METHODS, default=["sq"], metavar="METHOD")
    navigation = commands.add_parser("navigation", help="plan on a map's boxes, meshes and layer 4")
    navigation.set_defaults(run=_navigation)
    navigation.add_argument("map", type=Path, metavar="MAP")
    navigation.add_argument("--truth", type=Path, required=True, metavar="DIR", help="the truth folder of the log")
    navigation.add_argument("--trials", type=int, default=100, metavar="N", help="starts and goals for each seed")
    navigation.add_argument("--seeds", type=int, default=5, metavar="N", help="seeds 0 to N-1")
    navigation.add_argument("--robot", default="point", metavar="NAME|FILE", help="a round robot; its first posture")
    navigation.add_argument("--cell", type=float, default=0.033, metavar="M", help="side of a cell, default 0.033 m")
    navigation.add_argument("--unknown", choices=("blocked", "free"), default="blocked")
    for command in (views, alignment, navigation):
        command.add_argument("--json", action="store_true")
    options = parser.parse_args(arguments)
    options.run(options)
    return 0


def _views(options: argparse.Namespace) -> None:
    config = read_config(Settings, None, tuple(options.set)).mapper
    if options.truth is not None and len(options.truth) != len(options.source):
        raise InputError(f"found {len(options.source)} logs, {len(options.truth)} --truth; expected one for each log")
    truths = [load_truth(t) for t in options.truth or [Path(log).with_suffix(".truth") for log in options.source]]
    reconstructors = reconstructors_of(options.reconstructor, config)
    style: Style = "json" if options.json else "bar" if sys.stderr.isatty() else "lines"
    trials: dict[str, list[tuple[ViewTrial, ...]]] = {name: [] for name in reconstructors}
    with tempfile.TemporaryDirectory() as temporary:
        for i, (log, truth) in enumerate(zip(options.source, truths, strict=True)):
            source, printer = open_source(log), ProgressPrinter(style, part=f"{i + 1} of {len(truths)}")
            try:
                out = (options.out or Path(temporary)) / str(i)
                for name, found in try_views(source, truth, config, reconstructors, out, DiskSink, printer).items():
                    trials[name].append(found)
            finally:
                printer.close()
                source.close()
    scores = {name: compare(found) for name, found in trials.items()}
    if options.json:
        rows = [{"reconstructor": name, **dataclasses.asdict(s)} for name, found in scores.items() for s in found]
        print(dumps({"strategies": rows}))
    else:
        print("\n\n".join(f"{name}\n{format_comparison(found)}" for name, found in scores.items()))


def reconstructors_of(names: list[str] | None, config: MapperConfig) -> dict[str, Reconstructor]:
    """Return the reconstructors by name; without `names`, the embedded one and every generator that starts."""
    # Raises ConfigError: a named one cannot be used.
    found: dict[str, Reconstructor] = {}
    for name in names or [EMBEDDED, *sorted(str(path) for path in generators_folder().glob("*.toml"))]:
        if name == EMBEDDED:
            found[name] = make_reconstructor(EMBEDDED, config.shapes)
            continue
        try:
            path = find_spec(name)
            check_generator(path, config)
            found[read_spec(path).name] = generating(path, config.shapes)
        except ConfigError as error:
            if names is not None:
                raise
            sys.stderr.write(f"left out: {error}\n")
    return found


def _alignment(options: argparse.Namespace) -> None:
    paths, truths = options.maps, options.truth
    if len(paths) % 2:
        raise InputError(f"found {len(paths)} maps, expected two for each scene: A B [A B ...]")
    if truths and len(truths) != len(paths):
        raise InputError(f"found {len(truths)} truths for {len(paths)} maps, expected one for each map")
    rows = []
    for i in range(0, len(paths), 2):
        a, b = open_map_at(paths[i]), open_map_at(paths[i + 1])
        true = true_a_from_b(a, b, truths[i : i + 2]) if truths else None
        scene, map_a, map_b = f"{paths[i].name} {paths[i + 1].name}", objects_of(a), objects_of(b)
        rows += [
            alignment_table.row_of(scene, method, align_by(method, map_a, map_b), true) for method in options.method
        ]
    rows.sort(key=lambda row: options.method.index(row.method))
    print(dumps({"rows": alignment_table.table_json(rows)}) if options.json else alignment_table.format_table(rows))


def _navigation(options: argparse.Namespace) -> None:
    robot = load_robot(options.robot)
    if robot.num_headings != 1:
        raise InputError(f"the robot {robot.name} is not round; the comparison is for round robots, e.g. point")
    rows = navigation_table.score_saved_map(
        open_map_at(options.map), load_truth(options.truth), robot, cell_m=options.cell, unknown=options.unknown,
        trials=positive(options.trials, "--trials"), seeds=range(positive(options.seeds, "--seeds")),
    )  # fmt: skip
    print(dumps({"rows": navigation_table.table_json(rows)}) if options.json else navigation_table.format_table(rows))
