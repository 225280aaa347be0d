"""The commands of a parser, a walk over them, and their exit statuses."""

import argparse
import re
from collections.abc import Callable, Iterator
from textwrap import fill
from typing import Any

from hickory_stream.cli.examples import TEXTS

# Exit statuses.
STOPPED = 130
NO_ALIGNMENT = 3
NO_PATH = 3
NO_ANSWER = 3
NOT_SOUND = 1
INCOMPLETE = 3


class Commands:
    """Adds commands to a parser, with their texts; `common` and `configured` have options of several commands."""

    def __init__(
        self,
        parser: argparse.ArgumentParser,
        common: argparse.ArgumentParser,
        configured: argparse.ArgumentParser,
        group: str = "",
    ) -> None:
        title, name = ("actions", "ACTION") if group else ("commands", "COMMAND")
        self._parsers = parser.add_subparsers(title=title, required=not parser.get_default("run"), metavar=name)
        self._common, self._configured, self._group = common, configured, group

    def add(
        self, name: str, run: Callable[[argparse.Namespace], int], *, configured: bool = False
    ) -> argparse.ArgumentParser:
        """Return the parser of a command that `run` executes; `configured` adds the options of the configuration."""
        return self._add(name, [self._common, self._configured] if configured else [self._common], run=run)

    def add_plain(self, name: str, **defaults: Any) -> argparse.ArgumentParser:
        """Return the parser of a command without the common options."""
        return self._add(name, [], **defaults)

    def group(self, name: str, run: Callable[[argparse.Namespace], int] | None = None) -> "Commands":
        """Return the actions of a command, which alone does `run`, if given."""
        alone = {} if run is None else {"run": run, "json": False, "debug": False}
        return Commands(self.add_plain(name, **alone), self._common, self._configured, f"{name} ")

    def _add(self, name: str, parents: list[argparse.ArgumentParser], **defaults: Any) -> argparse.ArgumentParser:
        text, example = TEXTS[self._group + name]
        command = self._parsers.add_parser(
            name,
            parents=parents,
            help=text[0].lower() + re.split(r"[.:;](?: |$)", text[1:])[0],
            description=fill(text),
            epilog=f"example:\n  hickory-stream {example}",
            # An example is one line, to be copied.
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        command.set_defaults(**defaults)
        return command


def commands_of(
    parser: argparse.ArgumentParser, path: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], argparse.ArgumentParser]]:
    """Yield every command and its subcommands, with their words."""
    yield path, parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, below in action.choices.items():
                yield from commands_of(below, (*path, name))
