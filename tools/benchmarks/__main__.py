"""`tools/bench NAME`: run one benchmark, print its table, write its records."""

import argparse
import math
import sys
from dataclasses import fields
from pathlib import Path

from hickory_stream.errors import HickoryError
from tools.benchmarks.common.baseline import baseline_file, check, set_baseline
from tools.benchmarks.common.documents import keep, write_docs
from tools.benchmarks.common.figures import Options, print_table, write_json
from tools.benchmarks.common.processes import ROOT
from tools.benchmarks.table import BENCHMARKS, code_of


def main() -> int:
    parser = _parser()
    given = parser.parse_args()
    if given.name is None:
        if not given.write_docs:
            parser.error(f"name a benchmark: {', '.join(BENCHMARKS)}")
        return _write_docs()
    if given.quick:
        print("quick: a smaller sample")
    options = Options(
        **{
            field.name: tuple(value) if isinstance(value := getattr(given, field.name), list) else value
            for field in fields(Options)
        }
    )
    path = baseline_file(given.name)
    if given.check and not path.is_file():
        print(f"tools/bench {given.name} has no baseline: {path} is not there", file=sys.stderr)
        return 2
    try:
        figures = BENCHMARKS[given.name].measure(options)
    except HickoryError as error:
        print(f"tools/bench {given.name}: {error}", file=sys.stderr)
        return 2
    print_table(figures)
    if given.json is not None:
        write_json(figures, given.json)
    if given.set_baseline is not None:
        set_baseline(path, figures, given.set_baseline)
    if given.write_docs:
        sample = _sample(options)
        keep(given.name, figures, options=sample, code=code_of(given.name, sample))
        _write_docs()
    is_partial = given.quick or bool(given.only)
    return check(path, figures, is_partial=is_partial) if given.check else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="tools/bench",
        description="Measure, print a table, write JSON.",
        epilog="\n".join(["benchmarks:", *(f"  {name:<12}{one.about}" for name, one in BENCHMARKS.items())]),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("name", choices=list(BENCHMARKS), metavar="NAME", nargs="?", help="without it, --write-docs fills the tables")
    add("--json", type=Path, metavar="FILE", help="write a list of {name, value, unit, better}")
    add("--seed", type=int, default=0, help="vary the random part of the measurement")
    add("--quick", action="store_true", help="a smaller sample, in under 50 s")
    add("--scenes", type=Path, nargs="+", default=[], metavar="DIR", help="truth folders with their logs beside them")
    add("--meshes", type=Path, metavar="DIR", help="shapes: measure on the meshes of a folder instead")
    add("--worlds", type=Path, metavar="DIR", help="rooms by others; $HICKORY_WORLDS, else ../shared/worlds")
    add("--check", action="store_true", help="exit with 1 where a figure fell back behind the committed baseline")
    add("--set-baseline", metavar="ABOUT", help="write the figures into the committed baseline, with a description")
    add("--write-docs", action="store_true", help="keep the figures, and fill the tables of the READMEs")
    add("--maps", action="store_true", help="damage: alter maps instead of logs")
    add("--state", type=Path, default=Path("out/bench"), metavar="DIR", help="folder of intermediate results")
    add("--minutes", type=float, default=math.inf, help="begin nothing after this; a later call continues")
    add("--fresh", action="store_true", help="forget intermediate results")
    add(
        "--only",
        nargs="+",
        default=[],
        metavar="PART",
        help="engine: digests, kills, stops, live, soak, processors; foreign: WORLD[:WALK][:CAMERA][:RUNG], kitchen,"
        " clouds, own, outdoor, speed; first_hour: demo, wheel, tests; poses: campus, drift, fleet, graph, loops,"
        " real, walks; changes: days, run, person, questions; scale: keyframes, alignment, stages, batch,"
        " street; quality: apartments; doctor: sound, faults, logs",
    )
    return parser


def _sample(options: Options) -> str:
    words = [f"--{name}" for name in ("quick", "maps") if getattr(options, name)]
    words += ["--only", *options.only] if options.only else []
    words += ["--minutes", f"{options.minutes:g}"] if math.isfinite(options.minutes) else []
    return "".join(f" {word}" for word in words)


def _write_docs() -> int:
    for readme in write_docs(code_of):
        print(f"{readme.relative_to(ROOT)} has new figures")
    return 0


if __name__ == "__main__":
    sys.exit(main())
