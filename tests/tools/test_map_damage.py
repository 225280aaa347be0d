import json
import shutil
import subprocess
import sys
from pathlib import Path
import numpy as np
import pytest
from tools.benchmarks.logs.damaged_maps import write_small_map
from tools.damage.map_changes import TARGETS, change_map, change_text

ROOT = Path(__file__).resolve().parents[2]
# Two of each kind of file.
_NUM_CASES = 26


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    path = tmp_path_factory.mktemp("sound") / "map"
    write_small_map(path)
    return path


def in_a_process_of_its_own(code):
    """Run code that forks, where no thread of another test can be caught in the middle; return what it prints."""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=290, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def files_of(folder):
    return {
        str(file.relative_to(folder)): (file.is_symlink(), file.read_bytes() if file.is_file() else b"")
        for file in folder.rglob("*")
    }


@pytest.mark.parametrize("target", TARGETS)
def test_a_change_affects_the_copy_alone_and_follows_its_seed(sound, tmp_path, target):
    before = files_of(sound)
    told, found = [], []
    for name in ("first", "second"):
        path = tmp_path / name / "map"
        shutil.copytree(sound, path)
        (path.parent / "OUTSIDE").mkdir()
        told.append(change_map(path, target, np.random.default_rng(3)))
        found.append(files_of(path))
    assert told[0] == told[1]
    assert found[0].keys() == found[1].keys()
    assert found[0] != before
    assert files_of(sound) == before


def test_a_changed_text_differs_and_follows_its_seed():
    text = 'name = "b2"\nlow_m = 0.1\n'
    changed = {change_text(text, np.random.default_rng(seed)) for seed in range(20)}
    assert text not in changed
    assert len(changed) > 5
    assert change_text(text, np.random.default_rng(1)) == change_text(text, np.random.default_rng(1))


def test_altered_maps_crash_nothing_and_take_bounded_memory(sound):
    tally = in_a_process_of_its_own(
        "import json, dataclasses\n"
        "from pathlib import Path\n"
        "from tools.benchmarks.logs.damaged_maps import run_map_cases\n"
        f"tally = run_map_cases({_NUM_CASES}, 7, sound=Path({str(sound)!r}))\n"
        "print(json.dumps(dataclasses.asdict(tally)))"
    )
    assert tally["cases"] == _NUM_CASES
    assert tally["crashes"] == []
    assert tally["outside"] == []
    assert tally["refused"] >= _NUM_CASES / 3
    assert tally["peak_mb"] < 1000


def test_foreign_writes_and_uncaught_errors_are_reported(sound, tmp_path):
    shutil.copytree(sound, tmp_path / "a/b/c/map")
    commands = [["export", str(tmp_path / "a/b/c/map"), "--format", "ply", "-o", str(tmp_path / "elsewhere.ply")]]
    told = in_a_process_of_its_own(
        "import json, dataclasses, os\n" "from pathlib import Path\n"
        "import tools.benchmarks.logs.damaged_maps as bench\n" f"folder = Path({str(tmp_path / 'a/b/c')!r})\n"
        f"outside = bench._tried('case', {commands!r}, folder)\n" "bench._main = lambda command: open(command[0])\n"
        "crash = bench._tried('case', [['no such file']], folder)\n" "bench._main = lambda command: os.abort()\n"
        "abort = bench._tried('case', [['x']], folder)\n"
        "print(json.dumps([dataclasses.asdict(tally) for tally in (outside, crash, abort)]))"
    )  # fmt: skip
    outside, crash, abort = told
    assert any("elsewhere" in text for text in outside["outside"])
    assert outside["crashes"] == []
    assert "FileNotFoundError" in crash["crashes"][0]
    assert "SIGABRT" in abort["crashes"][0]
