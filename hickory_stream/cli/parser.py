"""The parser of the whole command line."""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import Any, NoReturn

from hickory_stream import __version__
from hickory_stream.cli.commands import Commands
from hickory_stream.cli.logs import doctor, odometry, segment
from hickory_stream.cli.maps import (
    align,
    diff,
    evaluate,
    explain,
    export,
    inspect,
    merge,
    plan,
    query,
    reconstruct,
    relocalise,
    render,
    verify,
)
from hickory_stream.cli.runs import batch, demo, fleet, live, play, replay, resume
from hickory_stream.cli.setup import cache, completion, config, generators, models, schema

_COMMANDS = (
    *(demo, play, live, fleet, batch, resume, replay, doctor, odometry),
    *(inspect, verify, render, export, diff, query, plan, align, merge, relocalise, reconstruct),
    *(explain, evaluate, segment, models, generators, cache, config, schema, completion),
)


# Commands and options of earlier releases.
_MOVED = {
    "evaluate-views": "`paper views` in the folder tools of the source tree",
    "evaluate-alignment": "`paper alignment` in the folder tools of the source tree",
    "evaluate-navigation": "`paper navigation` in the folder tools of the source tree",
    "--unproven": "--allow-unverified",
    "--own-workers": "--use-current-workers",
}


class _Parser(argparse.ArgumentParser):
    # Takes `-1,2` for a value, as argparse takes `-1`: no option begins with a digit.
    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._negative_number_matcher = re.compile(r"-(\.?\d|inf|nan)")

    def error(self, message: str) -> NoReturn:
        # A name of an earlier release is answered by its present name.
        words = message.partition("(choose")[0].replace("'", " ").split()
        moved = next((word for word in words if word in _MOVED), None)
        super().error(message if moved is None else f"found {moved}, which is now {_MOVED[moved]}")


def make_parser() -> argparse.ArgumentParser:
    """Return the parser; its namespace holds `run`, the function of the chosen command, and the `parser`."""
    parser = _Parser(
        prog="hickory-stream",
        description="Streaming object mapper: posed RGB-D in, a map of objects with four layers out.",
    )
    parser.set_defaults(parser=parser)
    parser.add_argument("--version", action="version", version=f"hickory-stream {__version__}")
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument("--json", action="store_true", help="print JSON")
    common.add_argument(
        "--debug",
        action="store_true",
        help="log more, check the map after every event, and show the trace of an internal failure",
    )
    configured = argparse.ArgumentParser(add_help=False)
    configured.add_argument("--config", type=Path, metavar="TOML", help="configuration file; see `config dump`")
    configured.add_argument(
        "--set", action="append", metavar="SECTION.KEY=VALUE", help="override one value; repeatable"
    )
    commands = Commands(parser, common, configured)
    for command in _COMMANDS:
        command.add(commands)
    return parser
