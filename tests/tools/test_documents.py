"""The tables of figures are what was measured: nobody types them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tools.benchmarks.documents import MEASURED, filled_in, keep, readmes, without_age
from tools.benchmarks.figures import Figure
from tools.benchmarks.repetitions import product_hash

if TYPE_CHECKING:
    from pathlib import Path

TABLE = """\
before
<!-- figures: main -->
| figure | goal | measured |
|---|---|---|
| `speed`: seconds a second | >= 1 | typed |
| `found` of `things` | 1 | typed |
| `memory` | small | typed |
<!-- end of figures -->
after
"""


@pytest.fixture
def measured(tmp_path: Path) -> Path:
    figures = [
        Figure(name="speed", value=1.0666, unit="x", better="higher"),
        Figure(name="found", value=21.0, unit="", better="higher"),
        Figure(name="things", value=22.0, unit="", better="higher"),
    ]
    keep("main", figures, is_quick=True, folder=tmp_path)
    return tmp_path


@pytest.mark.parametrize("readme", [path for path in readmes() if "<!-- figures:" in path.read_text(encoding="utf-8")])
def test_the_tables_of_a_readme_are_those_of_the_kept_measurements(readme: Path) -> None:
    text = readme.read_text(encoding="utf-8")
    assert without_age(filled_in(text, folder=MEASURED, code="")) == without_age(text), "run tools/bench --write-docs"


def test_the_last_column_is_filled_with_the_figures_that_the_first_names(measured: Path) -> None:
    rows = filled_in(TABLE, folder=measured, code=product_hash()).splitlines()
    assert "| `speed`: seconds a second | >= 1 | 1.07 x |" in rows
    assert "| `found` of `things` | 1 | 21, 22 |" in rows
    assert "| `memory` | small | not measured |" in rows
    assert (rows[0], rows[-1]) == ("before", "after")


def test_the_line_below_says_when_and_marks_what_is_older_than_the_code(measured: Path) -> None:
    now = filled_in(TABLE, folder=measured, code=product_hash())
    later = filled_in(now, folder=measured, code="another")
    assert "*`tools/bench main --quick`, 20" in now
    assert "The code has changed since" not in now
    assert "**The code has changed since.**" in later
    assert without_age(later) == now
    assert filled_in(later, folder=measured, code=product_hash()) == now


def test_a_table_without_a_measurement_keeps_its_cells_and_is_marked_as_older(tmp_path: Path) -> None:
    filled = filled_in(TABLE, folder=tmp_path, code="")
    assert "| `speed`: seconds a second | >= 1 | typed |" in filled
    assert "older than the code" in filled
    assert filled_in(filled, folder=tmp_path, code="") == filled
