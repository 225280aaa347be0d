"""`hickory-stream config`: show or check a configuration."""

import argparse
from pathlib import Path

from hickory_stream.cli.commands import Commands
from hickory_stream.cli.option_values import read_settings
from hickory_stream.outputs import output


def add(commands: Commands) -> None:
    config = commands.group("config")
    config.add("dump", _dump, configured=True)
    check = config.add("check", _check)
    check.add_argument("config", type=Path, metavar="TOML")
    check.set_defaults(set=None)


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
