"""The parser of the whole command line."""

import argparse
import re
from collections.abc import Sequence
from difflib import get_close_matches
from itertools import chain
from pathlib import Path
from textwrap import fill
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

_GROUPS = {
    "make a map": (demo, play, live, fleet, batch, resume, replay),
    "look at a map": (inspect, render, export, explain),
    "use a map": (query, plan, relocalise),
    "compare and join maps": (diff, align, merge),
    "measure": (doctor, odometry, segment, evaluate, verify),
    "maintain": (reconstruct, models, generators, cache, config, schema, completion),
}

# Commands and options of earlier releases.
_MOVED = {
    "evaluate-views": "`paper --table views` in the folder tools of the source tree",
    "evaluate-alignment": "`paper --table alignment` in the folder tools of the source tree",
    "evaluate-navigation": "`paper --table navigation` in the folder tools of the source tree",
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
        moved = next((word for word in re.findall(r"[-\w]+", message) if word in _MOVED), None)
        super().error(message if moved is None else f"found {moved}, which is now {_MOVED[moved]}")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            names = [str(name) for name in action.choices]
            one_of = "expected " + "one of " * (len(names) > 1) + ", ".join(names)
            raise argparse.ArgumentError(None, f"found {value}, {_meant(value, names) or one_of}")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        found, unknown = super().parse_known_args(args, namespace)
        for word in unknown:
            # Here, and not in the parser of all commands, its options are known.
            meant = _meant(word.partition("=")[0], list(self._option_string_actions)) if word.startswith("-") else ""
            self.error(f"found {word}, {meant or f'which is not expected; see {self.prog} --help'}")
        return found, unknown


def _meant(word: str, names: Sequence[str]) -> str:
    near = get_close_matches(word, names, n=2)
    return f"did you mean {' or '.join(near)}?" if near else ""


class _Overview(argparse.HelpFormatter):
    # Lists the commands by group.
    def _format_action(self, action: argparse.Action) -> str:
        if not isinstance(action, argparse._SubParsersAction):
            return super()._format_action(action)
        helps = {entry.dest: entry.help or "" for entry in action._choices_actions}
        lines = []
        for group, modules in _GROUPS.items():
            lines.append(f"  {group}:")
            for name in (module.__name__.rpartition(".")[2] for module in modules):
                lines += [fill(f"    {name:<13}{helps[name]}", 79, subsequent_indent=" " * 17)]
        return "\n".join(lines) + "\n"


def make_parser() -> argparse.ArgumentParser:
    """Return the parser; its namespace holds `run`, the function of the chosen command, and the `parser`."""
    parser = _Parser(
        prog="hickory-stream",
        description="Streaming object mapper: posed RGB-D in, a map of objects with four layers out.",
        epilog="`hickory-stream COMMAND --help` shows an example and all options; begin with `hickory-stream demo`.",
        formatter_class=_Overview,
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
    for command in chain(*_GROUPS.values()):
        command.add(commands)
    return parser
