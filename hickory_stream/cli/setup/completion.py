"""`hickory-stream completion`: print a shell completion script."""

import argparse

from hickory_stream.cli.commands import Commands, commands_of

SHELLS = ("bash", "zsh", "fish")


def add(commands: Commands) -> None:
    completion = commands.add_plain("completion", run=run, debug=False)
    completion.add_argument("shell", choices=SHELLS)


def run(options: argparse.Namespace) -> int:
    import shtab

    for _, command in commands_of(options.parser):
        for action in command._actions:
            if action.nargs != 0 and action.choices is None:
                action.complete = shtab.FILE  # type: ignore[attr-defined] # shtab reads it
    print(shtab.complete(options.parser, options.shell))
    return 0
