"""`hickory-stream inspect`: show what a map holds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.cli.values import open_map_at
from hickory_stream.json_text import dumps

if TYPE_CHECKING:
    import argparse

    from hickory_stream.cli.parser import Commands


def add(commands: Commands, common: argparse.ArgumentParser, _configured: argparse.ArgumentParser) -> None:
    """Add the command to the command line."""
    inspect = commands.add_parser("inspect", parents=[common], help="show what a map holds")
    inspect.set_defaults(run=run)
    inspect.add_argument("map", type=Path, metavar="MAP")
    inspect.add_argument(
        "--at", metavar="T", help="as it was known then: seconds from the first keyframe, or a stamp like 17...ns"
    )


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    from hickory_stream.evaluation.inspect import as_json, format_table, summarize

    summary = summarize(open_map_at(options.map, options.at))
    print(dumps(as_json(summary), indent=1) if options.json else format_table(summary))
    return 0
