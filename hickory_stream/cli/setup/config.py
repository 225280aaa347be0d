"""`hickory-stream config`: show or check a configuration."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.cli.option_values import read_settings
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse

    from hickory_stream.cli.commands import Commands


def add(commands: Commands, common: argparse.ArgumentParser, configured: argparse.ArgumentParser) -> None:
    """Add the command to the command line."""
    config = commands.add_parser("config", help="show or check a configuration").add_subparsers(
        required=True, metavar="ACTION"
    )
    dump = config.add_parser("dump", parents=[common, configured], help="print the whole configuration as TOML")
    dump.set_defaults(run=_dump)
    check = config.add_parser("check", parents=[common], help="check a configuration file")
    check.add_argument("config", type=Path, metavar="TOML")
    check.set_defaults(run=_check, set=None)


def _dump(options: argparse.Namespace) -> int:
    from hickory_stream.base.config_text import to_toml
    from hickory_stream.settings import SET_OFTEN

    settings = read_settings(options)
    if options.json:
        import dataclasses

        print(output("config-dump", dataclasses.asdict(settings), indent=1))
    else:
        print(to_toml(settings, SET_OFTEN), end="")
    return 0


def _check(options: argparse.Namespace) -> int:
    read_settings(options)
    print(output("config-check", {"ok": True}) if options.json else f"{options.config}: ok")
    return 0
