"""`tools/bench NAME`: run one benchmark, print its table, write its records."""

from __future__ import annotations

import argparse
import importlib
import math
import pkgutil
import sys
from pathlib import Path

import tools.benchmarks
from hickory_stream.errors import HickoryError
from tools.benchmarks.baseline import baseline_file, check, set_baseline
from tools.benchmarks.documents import keep, write_docs
from tools.benchmarks.figures import Options, print_table, write_json
from tools.benchmarks.processes import ROOT

_HELPERS = {
    "__main__",
    "adapter_fakes",
    "adapter_graphs",
    "align_unknown",
    "apartment_maps",
    "baseline",
    "change_counts",
    "changed_maps",
    "changed_runs",
    "coarse_runs",
    "documents",
    "drift_figures",
    "drift_logs",
    "figures",
    "first_difference",
    "first_layer",
    "fleet_figures",
    "foreign_figures",
    "foreign_logs",
    "foreign_parts",
    "foreign_runs",
    "foreign_shapes",
    "furnished_maps",
    "furniture_groups",
    "intervals",
    "kept",
    "keyframe_memory",
    "labelled_clouds",
    "layer2_objects",
    "layer2_outcomes",
    "live_log",
    "live_receiver",
    "live_safety",
    "live_scene",
    "looked_at",
    "loop_figures",
    "loop_rooms",
    "loop_walks",
    "map_changes",
    "map_damage",
    "mapped_squares",
    "mask_scores",
    "oracle",
    "passers_by",
    "perception_models",
    "played",
    "pose_graph_figures",
    "pose_graphs",
    "processes",
    "processors",
    "repetitions",
    "rule_constants",
    "rule_logs",
    "rule_switches",
    "scale_keyframe",
    "shape_meshes",
    "shape_rows",
    "scale_reading",
    "shape_truth",
    "small_logs",
    "small_maps",
    "stage_times",
    "swept_truth",
    "true_questions",
    "view_trials",
    "true_shapes",
}


def benchmark_names() -> list[str]:
    """Return the modules that can be run: each has `measure`."""
    return sorted({module.name for module in pkgutil.iter_modules(tools.benchmarks.__path__)} - _HELPERS)


def main() -> int:
    """Parse the arguments and run."""
    names = benchmark_names()
    parser = argparse.ArgumentParser(prog="tools/bench", description="Measure, print a table, write JSON.")
    parser.add_argument("name", choices=names, nargs="?", help="without it, --write-docs writes what was kept")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write a list of {name, value, unit, better}")
    parser.add_argument("--seed", type=int, default=0, help="vary what is random about the measurement")
    parser.add_argument("--quick", action="store_true", help="a smaller sample, in under 50 s")
    parser.add_argument(
        "--scenes", type=Path, nargs="+", default=[], metavar="DIR", help="truth folders with their logs beside them"
    )
    parser.add_argument("--meshes", type=Path, metavar="DIR", help="shapes: measure on the meshes of a folder instead")
    parser.add_argument("--clouds", type=Path, metavar="DIR", help="perception: labelled clouds, *.pcd, of a folder")
    parser.add_argument(
        "--worlds",
        type=Path,
        metavar="DIR",
        help="foreign, rules: rooms by others; $HICKORY_WORLDS, else ../shared/worlds",
    )
    parser.add_argument(
        "--check", action="store_true", help="exit with 1 where a figure fell back behind the committed baseline"
    )
    parser.add_argument(
        "--set-baseline", metavar="ABOUT", help="write what was measured into the committed baseline, and what it is"
    )
    parser.add_argument(
        "--write-docs", action="store_true", help="keep what was measured, and fill the tables of the READMEs with it"
    )
    parser.add_argument("--maps", action="store_true", help="damage: alter maps instead of logs")
    parser.add_argument("--render", type=Path, metavar="DIR", help="shapes: write a picture of each object")
    parser.add_argument(
        "--state",
        type=Path,
        default=Path("out/bench"),
        metavar="DIR",
        help="engine, damage, foreign, rules: where what was measured is kept",
    )
    parser.add_argument(
        "--only",
        nargs="+",
        default=[],
        metavar="PART",
        help="engine: digests, kills, stops, live, soak; foreign: WORLD[:WALK][:CAMERA][:RUNG], kitchen, clouds, own;"
        " rules: rules, mapping, perception; poses: drift, fleet, graph, loops, walks; changes: days, run, person,"
        " questions",
    )
    parser.add_argument("--minutes", type=float, default=math.inf, help="what goes on later: begin nothing after this")
    parser.add_argument("--fresh", action="store_true", help="what goes on later: forget what is kept")
    arguments = parser.parse_args()
    if arguments.name is None:
        if not arguments.write_docs:
            parser.error(f"name a benchmark: {', '.join(names)}")
        return _write_docs()
    module = importlib.import_module(f"tools.benchmarks.{arguments.name}")
    if arguments.quick:
        print("quick: a smaller sample")
    options = Options(
        seed=arguments.seed,
        quick=arguments.quick,
        scenes=tuple(arguments.scenes),
        meshes=arguments.meshes,
        clouds=arguments.clouds,
        render=arguments.render,
        state=arguments.state,
        only=tuple(arguments.only),
        minutes=arguments.minutes,
        fresh=arguments.fresh,
        worlds=arguments.worlds,
        maps=arguments.maps,
    )
    path = baseline_file(arguments.name)
    if arguments.check and not path.is_file():
        print(f"tools/bench {arguments.name} has no baseline: {path} is not there", file=sys.stderr)
        return 2
    try:
        figures = module.measure(options)
    except HickoryError as error:
        print(f"tools/bench {arguments.name}: {error}", file=sys.stderr)
        return 2
    print_table(figures)
    if arguments.json is not None:
        write_json(figures, arguments.json)
    if arguments.set_baseline is not None:
        set_baseline(path, figures, arguments.set_baseline)
    if arguments.write_docs:
        keep(arguments.name, figures, options=_sample(arguments))
        _write_docs()
    is_partial = arguments.quick or bool(arguments.only)
    return check(path, figures, is_partial=is_partial) if arguments.check else 0


def _sample(arguments: argparse.Namespace) -> str:
    """Return the options that made a run a part or a smaller sample, as they are typed."""
    only = " ".join(["", "--only", *arguments.only]) if arguments.only else ""
    return (" --quick" if arguments.quick else "") + (" --maps" if arguments.maps else "") + only


def _write_docs() -> int:
    for readme in write_docs():
        print(f"{readme.relative_to(ROOT)} has new figures")
    return 0


if __name__ == "__main__":
    sys.exit(main())
