"""The READMEs: that of the project, those beside the code of a package, and what is written into them from the code."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("hickory_stream", "players", "tools", "recordings")
READMES = (ROOT / "README.md", *sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("README.md")))


def filled(text: str, opening: str, closing: str, write: Callable[[re.Match[str]], str]) -> str:
    """Return a text with what stands between two lines of it written anew.

    Args:
        text: of a README.
        opening: a pattern of the line before; its named groups are for `write`, beside `body`: what stands there now.
        closing: the line after.
        write: returns what is to stand there, without the line breaks at its ends.
    """
    block = re.compile(rf"(?P<opening>{opening})\n(?P<body>.*?)\n?{re.escape(closing)}", re.DOTALL)
    return block.sub(lambda found: f"{found['opening']}\n{write(found)}\n{closing}", text)
