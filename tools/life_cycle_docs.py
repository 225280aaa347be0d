"""The table of a track's life cycle in `hickory_stream/mapping/README.md`, written from the code that executes it."""

from __future__ import annotations

from hickory_stream.mapping.rules.lifecycle import life_cycle_table
from tools.readmes import ROOT, filled

README = ROOT / "hickory_stream" / "mapping" / "README.md"
_OPENING, _CLOSING = "<!-- life cycle -->", "<!-- end of life cycle -->"

if __name__ == "__main__":
    text = README.read_text(encoding="utf-8")
    written = filled(text, _OPENING, _CLOSING, lambda found: f"\n{life_cycle_table()}")
    README.write_text(written, encoding="utf-8")
    print("written" if written != text else "as it was", README)
