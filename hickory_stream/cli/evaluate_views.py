"""`hickory-stream evaluate-views`: compare the ways to choose views."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from hickory_stream.cli.option_values import read_settings
from hickory_stream.errors import InputError
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse

    from hickory_stream.cli.commands import Commands
    from hickory_stream.config import MapperConfig
    from hickory_stream.evaluation.views.trials import ViewTrial
    from hickory_stream.ports import Reconstructor
    from hickory_stream.progress import Style

EMBEDDED: Literal["single_view"] = "single_view"


def add(commands: Commands, common: argparse.ArgumentParser, configured: argparse.ArgumentParser) -> None:
    """Add the command to the command line."""
    views = commands.add_parser("evaluate-views", parents=[common, configured], help="compare the ways to choose views")
    views.set_defaults(run=run)
    views.add_argument("source", nargs="+", metavar="LOG", help="one or more logs; each is played once")
    views.add_argument(
        "--truth", type=Path, action="append", metavar="DIR", help="for each LOG (default: LOG's .truth)"
    )
    views.add_argument(
        "--reconstructor",
        action="append",
        metavar="NAME",
        help="single_view, or a generator by its name or TOML; may be repeated "
        "(default: single_view and every generator of `generators list` that can be started)",
    )
    views.add_argument("--out", type=Path, metavar="DIR", help="keep the maps there")


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    import dataclasses
    import tempfile

    from hickory_stream.evaluation.truth import load_truth
    from hickory_stream.evaluation.views.comparison import compare, format_comparison
    from hickory_stream.evaluation.views.trials import try_views
    from hickory_stream.progress import ProgressPrinter
    from hickory_stream.sinks.disk_sink import DiskSink
    from players import open_source

    settings = read_settings(options)
    if options.truth is not None and len(options.truth) != len(options.source):
        raise InputError(
            f"found {len(options.source)} logs and {len(options.truth)} --truth; expected one for each log"
        )
    folders = options.truth or [Path(source).with_suffix(".truth") for source in options.source]
    truths = [load_truth(folder) for folder in folders]
    reconstructors = reconstructors_of(options.reconstructor, settings.mapper, told=not options.json)
    style: Style = "json" if options.json else "bar" if sys.stderr.isatty() else "lines"

    trials: dict[str, list[tuple[ViewTrial, ...]]] = {name: [] for name in reconstructors}
    with tempfile.TemporaryDirectory() as temporary:
        for i, (log, truth) in enumerate(zip(options.source, truths, strict=True)):
            if not options.json:
                sys.stderr.write(f"{i + 1} of {len(truths)}: {log}\n")
            source = open_source(log)
            printer = ProgressPrinter(style, part=f"{i + 1} of {len(truths)}")
            try:
                out = (options.out or Path(temporary)) / str(i)
                for name, found in try_views(
                    source, truth, settings.mapper, reconstructors, out, DiskSink, printer
                ).items():
                    trials[name].append(found)
            finally:
                printer.close()
                source.close()
    scores = {name: compare(found) for name, found in trials.items()}
    if options.json:
        rows = [{"reconstructor": name, **dataclasses.asdict(s)} for name, found in scores.items() for s in found]
        print(output("evaluate-views", {"event": "finished", "strategies": rows}))
    else:
        print("\n\n".join(f"{name}\n{format_comparison(found)}" for name, found in scores.items()))
    return 0


def reconstructors_of(names: list[str] | None, config: MapperConfig, *, told: bool) -> dict[str, Reconstructor]:
    """Return what is to be compared, by name; without `names` also what generators there are that can be started.

    Raises:
        ConfigError: one that is named cannot be used.
    """
    from hickory_stream.engine.shape_jobs.generators.choose import check_generator, generating
    from hickory_stream.engine.shape_jobs.generators.spec import find_spec, generators_folder, read_spec
    from hickory_stream.errors import ConfigError
    from hickory_stream.shapes.build import make_reconstructor

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
            if told:
                sys.stderr.write(f"left out: {error}\n")
    return found
