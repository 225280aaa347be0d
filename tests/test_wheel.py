"""The wheel, as a person without the checkout installs it."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_wheel_plays_a_log_outside_the_checkout(tmp_path: Path, demo_log: Path) -> None:
    wheels, venv, work = tmp_path / "wheels", tmp_path / "venv", tmp_path / "work"
    work.mkdir()
    _run(
        sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", wheels, _clean_copy(tmp_path), cwd=work
    )
    [wheel] = wheels.glob("*.whl")
    _run(sys.executable, "-m", "venv", venv, cwd=work)
    _run(venv / "bin" / "pip", "install", "--quiet", "-c", ROOT / "requirements.lock", wheel, cwd=work)
    log = shutil.copy(demo_log, work / "log.mcap")

    played = _run(
        venv / "bin" / "hickory-stream",
        "play",
        log,
        "--frames",
        24,
        "--out",
        "map",
        "--viewer",
        "none",
        "--json",
        cwd=work,
    )
    finished = json.loads(played.splitlines()[-1])
    assert finished["finished_cleanly"]
    assert finished["objects_with_shape"] == finished["objects"] > 0
    summary = json.loads(_run(venv / "bin" / "hickory-stream", "inspect", "map", "--json", cwd=work))
    assert summary["digest"] == finished["digest"]
    where = _run(
        venv / "bin" / "python", "-c", "import hickory_stream, players; print(hickory_stream.__file__)", cwd=work
    )
    assert str(venv) in where, "the installed package was used, not the checkout"


def _clean_copy(folder: Path) -> Path:
    """Return a copy of what is needed to build: building in the checkout would leave files in it."""
    copy = folder / "source"
    copy.mkdir()
    for name in ("hickory_stream", "players"):
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, copy / name)
    return copy


def _run(*command: object, cwd: Path) -> str:
    done = subprocess.run([str(part) for part in command], cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command}: {done.stderr[-2000:]}"
    return done.stdout
