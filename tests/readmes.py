"""What a README consists of: its code, and its prose."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path


def blocks_of(language: str, readme: Path) -> str:
    """Return the code blocks of a language in a README, one after the other."""
    text = readme.read_text(encoding="utf-8")
    return "".join(re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL))


def prose_of(readme: Path) -> list[tuple[int, str]]:
    """Return the lines, with their numbers from 1, that are neither in a code block nor in a table."""
    prose, is_code = [], False
    for number, line in enumerate(readme.read_text(encoding="utf-8").splitlines(), start=1):
        if line.startswith("```"):
            is_code = not is_code
        elif not is_code and not line.startswith("|"):
            prose.append((number, line))
    return prose
