"""`tools/bench NAME`: run one benchmark, print its table, write its records."""

from __future__ import annotations

import argparse
import importlib
import math
import pkgutil
import sys
from pathlib import Path

import tools.benchmarks
from tools.benchmarks.figures import Options, print_table, write_json

_HELPERS = {
    "__main__",
    "apartment_maps",
    "coarse_runs",
    "figures",
    "first_layer",
    "labelled_clouds",
    "live_scene",
    "mask_scores",
    "perception_models",
    "processes",
    "repetitions",
    "shape_meshes",
    "shape_truth",
    "small_logs",
    "swept_truth",
    "true_shapes",
}


def main() -> int:
    """Parse the arguments and run."""
    names = sorted({module.name for module in pkgutil.iter_modules(tools.benchmarks.__path__)} - _HELPERS)
    parser = argparse.ArgumentParser(prog="tools/bench", description="Measure, print a table, write JSON.")
    parser.add_argument("name", choices=names)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write a list of {name, value, unit, better}")
    parser.add_argument("--seed", type=int, default=0, help="vary what is random about the measurement")
    parser.add_argument("--quick", action="store_true", help="a smaller sample, in under 50 s")
    parser.add_argument(
        "--scenes", type=Path, nargs="+", default=[], metavar="DIR", help="truth folders with their logs beside them"
    )
    parser.add_argument("--meshes", type=Path, metavar="DIR", help="shapes: measure on the meshes of a folder instead")
    parser.add_argument("--clouds", type=Path, metavar="DIR", help="perception: labelled clouds, *.pcd, of a folder")
    parser.add_argument("--render", type=Path, metavar="DIR", help="shapes: write a picture of each object")
    parser.add_argument(
        "--state",
        type=Path,
        default=Path("out/bench"),
        metavar="DIR",
        help="engine, damage: where repetitions are kept",
    )
    parser.add_argument(
        "--only", nargs="+", default=[], metavar="PART", help="engine: digests, kills, stops, live, soak"
    )
    parser.add_argument("--minutes", type=float, default=math.inf, help="engine, damage: begin nothing after this time")
    parser.add_argument("--fresh", action="store_true", help="engine, damage: forget the repetitions that are kept")
    arguments = parser.parse_args()
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
    )
    figures = module.measure(options)
    print_table(figures)
    if arguments.json is not None:
        write_json(figures, arguments.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
