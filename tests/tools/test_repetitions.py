import json
import pytest
from tools.benchmarks.common.code_hashes import code_hash, definitions_of
from tools.benchmarks.common.repetitions import CODE, Repetitions, measurement_folder
from tools.benchmarks.logs.damaged_logs import run_cases


def test_what_was_added_is_there_for_the_next_process_alone(tmp_path):
    kept = Repetitions(tmp_path / "part.jsonl")
    for i in kept.missing(3):
        kept.add(index=i)
    kept.close()
    again = Repetitions(tmp_path / "part.jsonl")
    again.close()
    assert list(again.missing(3)) == []
    assert again.records == [{"index": 0}, {"index": 1}, {"index": 2}]
    first = Repetitions(tmp_path / "part.jsonl")
    with pytest.raises(RuntimeError, match="another process"):
        Repetitions(tmp_path / "part.jsonl")
    first.close()
    assert list(Repetitions(until=0.0).missing(5)) == []


def test_a_record_that_was_cut_off_is_made_again(tmp_path):
    file = tmp_path / "part.jsonl"
    file.write_text('{"index": 0}\n{"ind')
    kept = Repetitions(file)
    for i in kept.missing(2):
        kept.add(index=i)
    kept.close()
    assert [json.loads(line) for line in file.read_text().splitlines()] == [{"index": 0}, {"index": 1}]


def test_other_code_has_another_folder_and_fresh_forgets(tmp_path):
    folder = measurement_folder(tmp_path, "damage", seed=0, fresh=False)
    assert code_hash(*CODE)[:12] in folder.name
    assert measurement_folder(tmp_path, "damage", seed=1, fresh=False) != folder
    (folder / "logs.jsonl").write_text('{"index": 0}\n')
    assert measurement_folder(tmp_path, "damage", seed=0, fresh=False) == folder
    assert (folder / "logs.jsonl").exists()
    measurement_folder(tmp_path, "damage", seed=0, fresh=True)
    assert not (folder / "logs.jsonl").exists()


def test_interrupted_damage_gives_the_figures_of_one_run(tmp_path):
    file = tmp_path / "logs.jsonl"
    first = Repetitions(file)
    run_cases(5, 3, first)
    first.close()
    second = Repetitions(file)
    continued = run_cases(12, 3, second)
    second.close()
    assert continued.cases == 12
    assert continued == run_cases(12, 3)


_HALF = 'import math\n\n\ndef half(x: float) -> float:\n    """Return half."""\n    return x / 2\n'
_PART = 'PART = "hickory_stream.engine.shape_jobs.worker"\n"""How a worker is started."""\n'


def test_docstrings_comments_imports_and_places_do_not_count():
    rewritten = _HALF.replace("Return half", "Half").replace("x / 2", "x / 2  # exactly").replace("math", "cmath")
    assert definitions_of(_HALF) == definitions_of(rewritten)
    assert definitions_of(_HALF) != definitions_of(_HALF.replace("2", "3"))
    moved = _PART.replace("engine", "engine.shape_jobs").replace("How", "The way in which")
    assert definitions_of(_PART) == definitions_of(moved) != definitions_of(_PART.replace("worker", "pool"))


def test_a_definition_may_move_to_another_file(tmp_path, monkeypatch):
    monkeypatch.setattr("tools.benchmarks.common.code_hashes.ROOT", tmp_path)
    hashes = []
    for name, files in (("a", {"one.py": _HALF + _PART}), ("b", {"x/one.py": _HALF, "two.py": _PART + "import os\n"})):
        for file, text in files.items():
            (tmp_path / name / file).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name / file).write_text(text)
        hashes.append(code_hash(name))
    (tmp_path / "b" / "weights.npz").write_bytes(b"1")
    code_hash.cache_clear()
    assert hashes[0] == hashes[1] != code_hash("b")
    with pytest.raises(FileNotFoundError, match="code that figures depend on has moved"):
        code_hash("c")
