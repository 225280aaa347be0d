import pytest
from tests.readmes import unmarked_tables
from tools.benchmarks.common.documents import MEASURED, filled_in, keep, without_age
from tools.benchmarks.common.figures import Figure
from tools.readmes import READMES

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


def about(commit):
    return {"commit": commit, "date": "2026-11-22", "code": commit, "load": 1.5}


@pytest.fixture
def measured(tmp_path):
    figures = [
        Figure(name="speed", value=1.0666, unit="x", better="higher"),
        Figure(name="found", value=21.0, unit="", better="higher"),
        Figure(name="things", value=22.0, unit="", better="higher"),
    ]
    keep("main", figures, options=" --quick", folder=tmp_path, **about("now"))
    return tmp_path


@pytest.mark.parametrize("readme", [path for path in READMES if "<!-- figures:" in path.read_text(encoding="utf-8")])
def test_the_tables_of_a_readme_come_from_kept_measurements(readme):
    text = readme.read_text(encoding="utf-8")
    assert without_age(filled_in(text, folder=MEASURED, code_of=lambda *_: "")) == without_age(text), (
        "run tools/bench --write-docs"
    )


def test_the_last_column_is_filled_with_the_named_figures(measured):
    rows = filled_in(TABLE, folder=measured, code_of=lambda *_: "now").splitlines()
    assert "| `speed`: seconds a second | >= 1 | 1.07 x |" in rows
    assert "| `found` of `things` | 1 | 21, 22 |" in rows
    assert "| `memory` | small | not measured |" in rows
    assert (rows[0], rows[-1]) == ("before", "after")


def test_the_line_below_has_a_date_and_marks_outdated_figures(measured):
    now = filled_in(TABLE, folder=measured, code_of=lambda *_: "now")
    later = filled_in(now, folder=measured, code_of=lambda *_: "another")
    assert "*`tools/bench main --quick`, 2026-11-22, commit now, under a load of 1.5.*" in now
    assert "The code has changed since" not in now
    assert "**The code has changed since.**" in later
    assert without_age(later) == now
    assert filled_in(later, folder=measured, code_of=lambda *_: "now") == now


@pytest.mark.parametrize("readme", READMES)
def test_every_table_of_figures_is_generated_or_marked_typed(readme):
    assert unmarked_tables(readme.read_text(encoding="utf-8")) == []


def test_a_table_of_figures_that_nobody_marked_is_found():
    rows = ["| what | before | now |", "|---|---|---|", "| `home` | 35 of 54 | 43 of 54 |", "| `shop` | 24 | 30 |"]
    marked = [*rows, "", "*Typed figures of commit d752b20, 2026-11-22: older than the code.*"]
    assert unmarked_tables("\n".join([*rows, "", "text"])) == [rows[2]]
    assert unmarked_tables("\n".join([*marked, ""])) == []
    assert unmarked_tables(TABLE) == []
    assert unmarked_tables("| rule | reason |\n|---|---|\n" + "| a | Stein et al. 2014 |\n" * 9) == []


def test_a_table_without_a_measurement_keeps_its_cells(tmp_path):
    filled = filled_in(TABLE, folder=tmp_path, code_of=lambda *_: "")
    assert "| `speed`: seconds a second | >= 1 | typed |" in filled
    assert "No measurement is kept yet" in filled
    assert filled_in(filled, folder=tmp_path, code_of=lambda *_: "") == filled


def test_a_part_measured_later_replaces_only_its_figures(measured):
    faster = [Figure(name="speed", value=2.0, unit="x", better="higher")]
    keep("main", faster, options=" --only speed", folder=measured, **about("later"))
    text = filled_in(TABLE, folder=measured, code_of=lambda *_: "later")
    assert "| `speed`: seconds a second | >= 1 | 2 x |" in text
    assert "| `found` of `things` | 1 | 21, 22 |" in text
    assert "*`tools/bench main --only speed`, 2026-11-22, commit later, under a load of 1.5: `speed`.*\n" in text
    assert "commit now, under a load of 1.5: `found`, `things`.*\n**The code has changed since.**\n" in text


def test_a_row_with_a_benchmark_says_its_own_age(measured):
    table = """\
<!-- figures: by row -->
| what | measured | by |
|---|---|---|
| the share found, and seconds a second <!-- {found} of {things}; {speed} --> | typed | `tools/bench main` |
| what nobody measured yet <!-- {paths} --> | typed | `tools/bench navigation` |
<!-- end of figures -->
"""
    rows = filled_in(table, folder=measured, code_of=lambda *_: "now").splitlines()
    told = "21 of 22; 1.07 x | `tools/bench main --quick`, 2026-11-22, now |"
    assert rows[3].endswith(f"{{speed}} --> | {told}")
    assert rows[4].endswith("| typed | `tools/bench navigation`, not measured |")
    later = filled_in("\n".join(rows), folder=measured, code_of=lambda *_: "later")
    assert "2026-11-22, now, **older than the code** |" in later
    assert without_age(later) == "\n".join(rows)
