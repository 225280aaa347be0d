"""`hickory-stream completion`: scripts that complete the command line, made of the parser itself.

One table says for every command what may follow: words of its own, and what an option's value is. The scripts of the
three shells look it up; a value that is none of a few words is completed as a file.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from hickory_stream.cli.commands import Commands

SHELLS = ("bash", "zsh", "fish")
_PROGRAM = "hickory-stream"


def add(commands: Commands, _common: argparse.ArgumentParser, _configured: argparse.ArgumentParser) -> None:
    """Add the command to the command line."""
    completion = commands.add_parser("completion", help="print a script that completes the command line in a shell")
    completion.set_defaults(run=run, debug=False)
    completion.add_argument("shell", choices=SHELLS)


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    script = {"bash": bash_script, "zsh": zsh_script, "fish": fish_script}[options.shell]
    print(script(options.parser), end="")
    return 0


def commands_of(
    parser: argparse.ArgumentParser, path: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], argparse.ArgumentParser]]:
    """Yield every command and the commands below it, with their words."""
    yield path, parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, below in action.choices.items():
                yield from commands_of(below, (*path, name))


def bash_script(parser: argparse.ArgumentParser) -> str:
    """Return the script for bash."""
    words, values = [], []
    for path, command in commands_of(parser):
        key = "/".join(path)
        files = " files=1" if _takes_files(command) else ""
        words.append(f"    '{key}') words='{' '.join(_words(command))}'{files} ;;")
        for action in command._actions:
            for option in action.option_strings:
                if _takes_value(action):
                    choices = " ".join(map(str, action.choices or ()))
                    values.append(f"    '{key} {option}') value='{choices or '@file'}' ;;")
    return _BASH.format(words="\n".join(words), values="\n".join(values), program=_PROGRAM)


def zsh_script(parser: argparse.ArgumentParser) -> str:
    """Return the script for zsh, which understands that of bash."""
    return f"#compdef {_PROGRAM}\nautoload -U +X bashcompinit && bashcompinit\n{bash_script(parser)}"


def fish_script(parser: argparse.ArgumentParser) -> str:
    """Return the script for fish."""
    lines = []
    for path, command in commands_of(parser):
        below = _commands_below(command)
        here = "; and ".join(f"__fish_seen_subcommand_from {name}" for name in path) or "__fish_use_subcommand"
        if path and below:
            here += f"; and not __fish_seen_subcommand_from {' '.join(below)}"
        plain = below or [str(choice) for a in command._actions if not a.option_strings for choice in a.choices or ()]
        lines += [f"complete -c {_PROGRAM} -f -n '{here}' -a '{word}'" for word in plain]
        for action in command._actions:
            if not action.option_strings:
                continue
            names = " ".join(f"-l {o[2:]}" if o.startswith("--") else f"-s {o[1:]}" for o in action.option_strings)
            value = ""
            if _takes_value(action):
                value = f" -x -a '{' '.join(map(str, action.choices))}'" if action.choices else " -r"
            lines.append(f"complete -c {_PROGRAM} -n '{here}' {names}{value}")
    return "\n".join(lines) + "\n"


def _takes_value(action: argparse.Action) -> bool:
    return action.nargs != 0


def _commands_below(command: argparse.ArgumentParser) -> list[str]:
    groups = (action for action in command._actions if isinstance(action, argparse._SubParsersAction))
    return [name for group in groups for name in group.choices]


def _takes_files(command: argparse.ArgumentParser) -> bool:
    """Return whether an argument of its own may be a file."""
    return any(not action.option_strings and action.choices is None for action in command._actions)


def _words(command: argparse.ArgumentParser) -> list[str]:
    """Return the words that may follow a command: commands below it, choices of its arguments, options."""
    plain = [str(c) for a in command._actions if not a.option_strings and a.choices for c in a.choices]
    return [*plain, *(option for action in command._actions for option in action.option_strings)]


_BASH = """\
_hickory_stream() {{
  local current="${{COMP_WORDS[COMP_CWORD]}}" before="${{COMP_WORDS[COMP_CWORD-1]}}" key='' words='' value='' files='' i
  for ((i = 1; i < COMP_CWORD; i++)); do
    words=''
    _hickory_stream_words "${{key:+$key/}}${{COMP_WORDS[i]}}"
    [[ -n $words ]] && key="${{key:+$key/}}${{COMP_WORDS[i]}}"
  done
  _hickory_stream_value "$key $before"
  if [[ $value == @file ]]; then
    COMPREPLY=($(compgen -f -- "$current"))
    compopt -o filenames 2>/dev/null
    return
  elif [[ -n $value ]]; then
    COMPREPLY=($(compgen -W "$value" -- "$current"))
    return
  fi
  words='' files=''
  _hickory_stream_words "$key"
  COMPREPLY=($(compgen -W "$words" -- "$current"))
  if [[ -n $files && $current != -* ]]; then
    COMPREPLY+=($(compgen -f -- "$current"))
    compopt -o filenames 2>/dev/null
  fi
}}
_hickory_stream_words() {{
  case "$1" in
{words}
  esac
}}
_hickory_stream_value() {{
  case "$1" in
{values}
  esac
}}
complete -F _hickory_stream {program}
"""
