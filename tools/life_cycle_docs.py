"""The table of a track's life cycle in `hickory_stream/mapping/README.md`, written from the code that executes it."""

from __future__ import annotations

import re
from pathlib import Path

from hickory_stream.mapping.lifecycle import life_cycle_table

README = Path(__file__).resolve().parent.parent / "hickory_stream" / "mapping" / "README.md"
_PLACE = re.compile(r"(<!-- life cycle -->\n).*?(<!-- end of life cycle -->\n)", re.DOTALL)

if __name__ == "__main__":
    text = README.read_text(encoding="utf-8")
    written = _PLACE.sub(lambda found: f"{found[1]}\n{life_cycle_table()}\n{found[2]}", text)
    README.write_text(written, encoding="utf-8")
    print("written" if written != text else "as it was", README)
