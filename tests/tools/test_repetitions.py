"""Measurements that are broken off and go on."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from tools.benchmarks.common.repetitions import Repetitions, code_hash, measurement_folder, syntax_of
from tools.benchmarks.logs.damaged_logs import run_cases

if TYPE_CHECKING:
    from pathlib import Path


def test_what_was_added_is_there_for_the_next_process(tmp_path: Path) -> None:
    kept = Repetitions(tmp_path / "part.jsonl")
    for i in kept.missing(3):
        kept.add(index=i)
    kept.close()
    again = Repetitions(tmp_path / "part.jsonl")
    again.close()
    assert list(again.missing(3)) == []
    assert again.records == [{"index": 0}, {"index": 1}, {"index": 2}]


def test_a_record_that_was_cut_off_is_made_again(tmp_path: Path) -> None:
    file = tmp_path / "part.jsonl"
    file.write_text('{"index": 0}\n{"ind')
    kept = Repetitions(file)
    for i in kept.missing(2):
        kept.add(index=i)
    kept.close()
    assert [json.loads(line) for line in file.read_text().splitlines()] == [{"index": 0}, {"index": 1}]


def test_two_processes_are_never_at_one_part(tmp_path: Path) -> None:
    first = Repetitions(tmp_path / "part.jsonl")
    with pytest.raises(RuntimeError, match="another process"):
        Repetitions(tmp_path / "part.jsonl")
    first.close()
    Repetitions(tmp_path / "part.jsonl").close()


def test_no_repetition_is_begun_when_the_time_is_up() -> None:
    assert list(Repetitions(until=0.0).missing(5)) == []


def test_other_code_has_another_folder_and_fresh_forgets(tmp_path: Path) -> None:
    folder = measurement_folder(tmp_path, "damage", seed=0, fresh=False)
    assert code_hash()[:12] in folder.name
    assert measurement_folder(tmp_path, "damage", seed=1, fresh=False) != folder
    (folder / "logs.jsonl").write_text('{"index": 0}\n')
    assert measurement_folder(tmp_path, "damage", seed=0, fresh=False) == folder
    assert (folder / "logs.jsonl").exists()
    measurement_folder(tmp_path, "damage", seed=0, fresh=True)
    assert not (folder / "logs.jsonl").exists()


def test_damage_broken_off_and_continued_gives_the_figures_of_one_go(tmp_path: Path) -> None:
    file = tmp_path / "logs.jsonl"
    first = Repetitions(file)
    run_cases(5, 3, first)
    first.close()
    second = Repetitions(file)
    continued = run_cases(12, 3, second)
    second.close()
    assert continued.cases == 12
    assert continued == run_cases(12, 3)


def test_a_rewritten_docstring_or_comment_is_the_same_code() -> None:
    before = 'def half(x: float) -> float:\n    """Return half."""\n    return x / 2\n'
    told = 'def half(x: float) -> float:\n    """Return x by two."""\n    return x / 2  # exactly\n'
    assert syntax_of(before) == syntax_of(told) != syntax_of(before.replace("2", "3"))
