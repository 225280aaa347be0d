"""`hickory-stream inspect`: show what a map holds."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import argparse

    from hickory_stream.cli.parser import Commands


def add(commands: Commands, common: argparse.ArgumentParser, _configured: argparse.ArgumentParser) -> None:
    """Add the command to the command line."""
    inspect = commands.add_parser("inspect", parents=[common], help="show what a map holds")
    inspect.set_defaults(run=run)
    inspect.add_argument("map", type=Path, metavar="MAP")


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    from hickory_stream.engine.session import open_map
    from hickory_stream.evaluation.inspect import as_json, format_table, summarize

    summary = summarize(open_map(options.map))
    print(json.dumps(as_json(summary), indent=1) if options.json else format_table(summary))
    return 0
