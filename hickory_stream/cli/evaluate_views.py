"""`hickory-stream evaluate-views`: compare the ways to choose views."""

from __future__ import annotations

import sys
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hickory_stream.cli.values import read_settings
from hickory_stream.errors import InputError
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator, Sequence

    from hickory_stream.cli.commands import Commands
    from hickory_stream.engine.map_folder import MapFolder
    from hickory_stream.mapping.views import Strategy
    from hickory_stream.ports import Sink
    from hickory_stream.progress import Style


def add(commands: Commands, common: argparse.ArgumentParser, configured: argparse.ArgumentParser) -> None:
    """Add the command to the command line."""
    views = commands.add_parser("evaluate-views", parents=[common, configured], help="compare the ways to choose views")
    views.set_defaults(run=run)
    views.add_argument("source", nargs="+", metavar="LOG", help="one or more logs; each is played once per strategy")
    views.add_argument(
        "--truth", type=Path, action="append", metavar="DIR", help="for each LOG (default: LOG's .truth)"
    )
    views.add_argument("--out", type=Path, metavar="DIR", help="keep the maps there")
    views.add_argument("--workers", metavar="N", help="child processes that build shapes")


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    import dataclasses
    import tempfile

    from hickory_stream.evaluation.truth import load_truth
    from hickory_stream.evaluation.view_strategies import STRATEGIES, compare, evaluate_strategy, format_comparison
    from hickory_stream.progress import ProgressPrinter
    from players import open_source

    settings = read_settings(options)
    if options.truth is not None and len(options.truth) != len(options.source):
        raise InputError(
            f"found {len(options.source)} logs and {len(options.truth)} --truth; expected one for each log"
        )
    folders = options.truth or [Path(source).with_suffix(".truth") for source in options.source]
    truths = [load_truth(folder) for folder in folders]
    style: Style = "json" if options.json else "bar" if sys.stderr.isatty() else "lines"

    def sinks(folder: MapFolder) -> list[tuple[Sink, bool]]:
        from hickory_stream.sinks.disk_sink import DiskSink

        return [(DiskSink(folder, settings.disk), True)]

    evaluations: dict[str, list[Any]] = {}
    with tempfile.TemporaryDirectory() as temporary:
        for part, strategy, i, log in planned_runs(STRATEGIES, options.source):
            if not options.json:
                sys.stderr.write(f"{part}: {strategy} on {log}\n")
            out = (options.out or Path(temporary)) / f"{i}-{strategy}"
            source = open_source(log)
            printer = ProgressPrinter(style, part=part)
            try:
                found = evaluate_strategy(source, truths[i], settings.mapper, strategy, out, sinks, printer)
            finally:
                printer.close()
                source.close()
            evaluations.setdefault(strategy, []).append(found)
    scores = compare(evaluations)
    if options.json:
        print(output("evaluate-views", {"event": "finished", "strategies": [dataclasses.asdict(s) for s in scores]}))
    else:
        print(format_comparison(scores))
    return 0


def planned_runs(strategies: Sequence[Strategy], logs: Sequence[str]) -> Iterator[tuple[str, Strategy, int, str]]:
    """Yield every run of the comparison: which of how many it is, the strategy, and the log with its index."""
    total = len(strategies) * len(logs)
    for n, (strategy, (i, log)) in enumerate(product(strategies, enumerate(logs))):
        yield f"{n + 1} of {total}", strategy, i, log
