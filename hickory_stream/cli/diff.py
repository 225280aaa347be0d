"""`hickory-stream diff`: what happened to the objects between two moments of a run."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse

    from hickory_stream.cli.commands import Commands


def add(commands: Commands, common: argparse.ArgumentParser, _configured: argparse.ArgumentParser) -> None:
    """Add the command to the command line."""
    diff = commands.add_parser("diff", parents=[common], help="what happened between two moments of a run")
    diff.set_defaults(run=run)
    diff.add_argument("map", type=Path, metavar="MAP")
    diff.add_argument("first", metavar="T1", help="seconds from the first keyframe, or a stamp like 17...ns")
    diff.add_argument("second", metavar="T2")


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    from hickory_stream.cli.values import open_map_at
    from hickory_stream.engine.history.time_travel import stamp_of

    saved = open_map_at(options.map)
    changes = saved.diff(stamp_of(options.map, options.first), stamp_of(options.map, options.second))
    if options.json:
        print(output("diff", {"changes": [dataclasses.asdict(change) for change in changes]}, indent=1))
    else:
        width = max((len(change.kind) for change in changes), default=0)
        for change in changes:
            print(f"#{change.object_id:<5} {change.kind:<{width}}  {change.text}")
        if not changes:
            print("nothing has changed")
    return 0
