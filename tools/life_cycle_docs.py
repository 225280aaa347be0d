"""Writes `hickory_stream/mapping/LIFE_CYCLE.md`, the table of a track's life cycle, from the code that executes it."""

from hickory_stream.mapping.rules.lifecycle import life_cycle_table
from tools.readmes import ROOT, filled

PAGE = ROOT / "hickory_stream" / "mapping" / "LIFE_CYCLE.md"
_OPENING, _CLOSING = "<!-- life cycle -->", "<!-- end of life cycle -->"

if __name__ == "__main__":
    text = PAGE.read_text(encoding="utf-8")
    written = filled(text, _OPENING, _CLOSING, lambda found: f"\n{life_cycle_table()}")
    PAGE.write_text(written, encoding="utf-8")
    print("written" if written != text else "as it was", PAGE)
