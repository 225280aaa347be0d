"""What a long benchmark has measured so far, a file for each part: a call that was stopped goes on where it was."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from hickory_stream.base.json_text import dumps
from tools.benchmarks.foreign_parts import map_code_hash

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def state_folder(state: Path, name: str, *code: str) -> Path:
    """Return the folder of what is kept by the code of maps, and by more of it: other code measures anew."""
    return state / f"{name}-{map_code_hash(*code)[:12]}"


def kept(file: Path, measured: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Return what a file has of a part, measured only if it is not there yet; a file is whole or absent."""
    if file.is_file():
        found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        return found
    found = measured()
    file.parent.mkdir(parents=True, exist_ok=True)
    unfinished = file.with_suffix(".unfinished")
    unfinished.write_text(dumps(found) + "\n", encoding="utf-8")
    unfinished.replace(file)
    return found
