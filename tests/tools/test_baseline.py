import json
import pytest
from tools.benchmarks.__main__ import main
from tools.benchmarks.common.baseline import FOLDER, baseline_file, check, compare, read_baseline, set_baseline
from tools.benchmarks.common.figures import Figure, print_table, write_json
from tools.benchmarks.table import BENCHMARKS


def figure(name, value, better="higher"):
    return Figure(name=name, value=value, unit="", better=better)


def entry(value, better="higher", goal=None):
    return {"value": value, "goal": goal, "tolerance": 0.05, "better": better, "unit": ""}


def baseline(folder, figures):
    (folder / "some.json").write_text(json.dumps({"about": "", "figures": figures}))
    return folder / "some.json"


@pytest.mark.parametrize(("before", "better", "value", "is_regression"), [
    (0.6, "higher", 0.56, False), (0.6, "higher", 0.54, True), (0.6, "higher", 0.9, False),
    (80.0, "lower", 80.04, False), (80.0, "lower", 80.1, True), ("geometric", "same", "other", False),
    (None, "higher", 0.0, False), ("digest 5e1f", "same", "digest 5e1f", False),
    ("digest 5e1f", "same", "digest b0c4", True),
])  # fmt: skip
def test_a_figure_may_fall_back_by_its_tolerance(before, better, value, *, is_regression):
    kept = entry(before, better)
    if str(before).startswith("digest"):
        kept["tolerance"] = 0
    found = compare([figure("a", value, better)], {"figures": {"a": kept}})
    assert bool(found.regressions) is is_regression


def test_goals_are_told_apart_from_what_was_before():
    baseline = {"figures": {"a": entry(0.6, goal=0.7), "b": entry(9.0, "lower", goal=8.0)}}
    found = compare([figure("a", 0.69), figure("b", 8.0, "lower")], baseline)
    assert (found.regressions, found.goals_open) == ([], ["a is 0.69, goal 0.7"])
    assert found.goals_met == ["b is 8, goal 8"]


def test_a_whole_run_needs_every_figure_and_a_part_does_not(tmp_path, capsys):
    file = baseline(tmp_path, {"a": entry(0.6), "b": entry(0.6), "c": entry(None)})
    assert check(file, [figure("a", 0.6)], is_partial=True) == 0
    assert check(file, [figure("a", 0.6)], is_partial=False) == 1
    assert "not measured:\n  b\n" in capsys.readouterr().out
    assert check(file, [figure("a", 0.6), figure("b", 0.5)], is_partial=True) == 1
    file = baseline(tmp_path, {"a": entry(0.6), "quick_a": entry(0.5)})
    assert check(file, [figure("a", 0.6)], is_partial=False) == 0
    assert check(file, [figure("quick_a", 0.4)], is_partial=True) == 1


def test_a_baseline_is_set_without_goals_and_missing_figures(tmp_path):
    file = baseline(tmp_path, {"a": entry(0.6, goal=0.7), "b": entry(0.5)})
    set_baseline(file, [figure("a", 0.65)], "after a change")
    found = read_baseline(file)
    assert found["about"] == "after a change"
    assert (found["figures"]["a"]["value"], found["figures"]["a"]["goal"]) == (0.65, 0.7)
    assert found["figures"]["b"]["value"] == 0.5


def test_a_name_without_a_baseline_cannot_be_checked(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["bench", "main", "--check"])
    assert main() == 2
    assert "has no baseline" in capsys.readouterr().err


def test_every_committed_baseline_is_readable_with_a_benchmark():
    files = sorted(FOLDER.glob("*.json"))
    assert baseline_file("foreign") in files
    for file in files:
        assert file.stem in BENCHMARKS
        read_baseline(file)


def test_the_note_of_a_figure_is_in_the_table_and_in_the_json(tmp_path, capsys):
    told = Figure(
        name="a", value=0.5, unit="", better="higher", of="1 of 2 things", left_out="3 that were hidden",
        interval=(0.1, 0.9), interval_by="Wilson", role="reported",
    )  # fmt: skip
    print_table([told, figure("segmenter", "geometric", "same")])
    line, second = capsys.readouterr().out.splitlines()
    assert "[0.100, 0.900] Wilson; 1 of 2 things; reported; left out: 3 that were hidden" in line
    assert "geometric" in second
    write_json([told, figure("b", 1.0)], tmp_path / "f.json")
    first, plain = json.loads((tmp_path / "f.json").read_text())
    assert (first["interval"], first["role"]) == ([0.1, 0.9], "reported")
    assert plain == {"name": "b", "value": 1.0, "unit": "", "better": "higher"}


def test_a_quick_run_is_compared_with_quick_figures_alone():
    figures = read_baseline(baseline_file("quality"))["figures"]
    assert figures["apartments_recall_25"]["tolerance"] < 0.05, "a whole run is compared"
    quick = [figure(name, entry["value"]) for name, entry in figures.items() if name.startswith("quick_")]
    assert quick
    assert check(baseline_file("quality"), quick, is_partial=True) == 0
    worse = figure("quick_apartments_f1_5pct", figures["quick_apartments_f1_5pct"]["value"] - 0.1)
    assert check(baseline_file("quality"), [worse], is_partial=True) == 1
