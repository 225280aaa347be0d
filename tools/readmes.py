"""The READMEs, the pages of results, and the blocks in them that are written from the code."""

import re
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FOLDERS = ("hickory_stream", "players", "tools", "recordings")
RESULTS = sorted((ROOT / "tools" / "benchmarks" / "results").glob("*.md"))
READMES = (
    ROOT / "README.md",
    *sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("README.md")),
    *RESULTS,
)


def filled(text: str, opening: str, closing: str, write: Callable[[re.Match[str]], str]) -> str:
    """Return a text with the lines between two marks replaced."""
    # `opening` is a pattern, whose named groups `write` gets, with the present lines as `body`.
    block = re.compile(rf"(?P<opening>{opening})\n(?P<body>.*?)\n?{re.escape(closing)}", re.DOTALL)
    return block.sub(lambda found: f"{found['opening']}\n{write(found)}\n{closing}", text)
