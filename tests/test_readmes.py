import os
import re
import subprocess
import sys
from operator import attrgetter
from pathlib import Path
import pytest
from hickory_stream.settings import Settings
from tests.conftest import copy_log
from tests.readmes import blocks_of, prose_of, unmarked_tables
from tools.benchmarks.common.documents import MEASURED, filled_in, keep, without_age
from tools.benchmarks.common.figures import Figure
from tools.readmes import READMES, RESULTS, ROOT

PACKAGES = sorted(
    path.parent
    for pattern in ("hickory_stream/*/__init__.py", "players/__init__.py", "players/live/__init__.py")
    for path in ROOT.glob(pattern)
)
# A README names files relative to its own folder, to the checkout, or to one of these packages.
PLACES = (ROOT, *(ROOT / folder for folder in ("hickory_stream", "tests", "tests/conformance", "tests/examples")))
NAMES = [str(readme.relative_to(ROOT)) for readme in READMES]


def test_the_main_readme_has_180_lines_at_most():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 180


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: str(package.relative_to(ROOT)))
def test_every_package_has_a_linked_readme(package):
    assert "How to extend it" in (package / "README.md").read_text(encoding="utf-8")
    assert f"]({package.relative_to(ROOT)}/README.md)" in (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("readme", READMES, ids=NAMES)
def test_lines_of_prose_have_120_characters_at_most(readme):
    assert [number for number, line in prose_of(readme) if len(line) > 120] == []


@pytest.mark.parametrize("readme", READMES, ids=NAMES)
def test_links_lead_to_files(readme):
    text = readme.read_text(encoding="utf-8")
    targets = [target for target in re.findall(r"\]\(([^)#]+)\)", text) if "://" not in target]
    assert [target for target in targets if not (readme.parent / target).exists()] == []


@pytest.mark.parametrize("readme", sorted({*READMES} - {*RESULTS}), ids=lambda readme: str(readme.relative_to(ROOT)))
def test_named_files_exist(readme):
    """Pages of results may name files that have been removed since."""
    text = re.sub(r"^```.*?^```", "", readme.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    named = set(re.findall(r"`([\w./-]+\.(?:py|toml))`", text)) | set(re.findall(r"`(tools/\w+)[` ]", text))
    places = (readme.parent, *readme.parent.parents, *PLACES)
    assert sorted(name for name in named if not any((place / name).exists() for place in places)) == []


def test_the_table_of_keys_has_the_defaults():
    """A name without a section shares the section before it."""
    text = (ROOT / "hickory_stream" / "cli" / "README.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`(?:mapper|disk|rerun)\..*?) \| (.*?) ?\|", text, flags=re.MULTILINE)
    assert len(rows) >= 25
    for names, defaults in rows:
        keys = re.findall(r"`([\w.]+)`", names)
        sections = [key.rpartition(".")[0] or keys[0].rpartition(".")[0] for key in keys]
        values = [
            attrgetter(f"{section}.{key.rpartition('.')[2]}")(Settings())
            for section, key in zip(sections, keys, strict=True)
        ]
        if defaults and defaults != "profile":
            shown = [text.strip("`").split()[0] for text in defaults.split(", ")]
            assert shown == [f"{value:g}" if isinstance(value, float) else str(value) for value in values], names


@pytest.mark.parametrize("readme", READMES, ids=NAMES)
def test_python_blocks_compile(readme):
    compile(blocks_of("python", readme), str(readme), "exec")


ROOT = Path(__file__).resolve().parent.parent


def examples():
    readme = ROOT / "README.md"
    if not readme.exists():
        pytest.skip("there is no README.md yet")
    blocks = re.findall(r"^```python\n(.*?)^```", readme.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    return [block for block in blocks if "async with Mapper" in block]


def test_the_example_of_the_readme_runs(tmp_path, demo_log):
    """The log is the beginning of the demo under the demo's name, so that the example need not name a test's file."""
    (example,) = examples()
    (tmp_path / "recordings").mkdir()
    copy_log(demo_log, tmp_path / "recordings/demo.mcap", seconds=1.5)
    (tmp_path / "example.py").write_text(example)
    done = subprocess.run(
        [sys.executable, "-W", "error", "example.py"], cwd=tmp_path, capture_output=True, text=True, timeout=160,
        check=False, env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()


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
