import json
import logging
import os
import subprocess
import sys
from pathlib import Path
import pytest
from hickory_stream.base import caches
from hickory_stream.base.compiled import source_hash
from hickory_stream.cli import main
from hickory_stream.errors import ConfigError

ROOT = Path(__file__).resolve().parent.parent.parent

KERNELS = {
    "players/__init__.py": "",
    "players/sizes.py": "SIZE = 3\n",
    "players/inner.py": ("from hickory_stream.base.compiled import kernel\n\n@kernel\ndef two():\n    return 2\n"),
    "players/outer.py": (
        "from hickory_stream.base.compiled import kernel\nfrom players.inner import two\n"
        "from players.sizes import SIZE\n"
        "from players.words import word\n\n@kernel\ndef five():\n    return two() + SIZE\n"
    ),
    "players/words.py": "def word():\n    return 'word'\n",
}
RUN = "from players.outer import five; print(five())"


@pytest.fixture
def no_folder(tmp_path):
    """A place that cannot be made: below a file. Root may write in folders that are read-only for others."""
    (tmp_path / "file").write_text("")
    return tmp_path / "file" / "cache"


def small_package(folder):
    for name, text in KERNELS.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


def run_python(program, *, folder, **environment):
    paths = {"PYTHONPATH": f"{folder}{os.pathsep}{ROOT}", "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run(
        [sys.executable, "-c", program], cwd=folder, env={**os.environ, **paths, **environment}, capture_output=True,
        text=True, check=True,
    )  # fmt: skip


def test_a_kernel_recompiles_when_its_callee_has_changed(tmp_path):
    package, kept = small_package(tmp_path / "code"), str(tmp_path / "cache")
    assert run_python(RUN, folder=package, HICKORY_CACHE=kept).stdout == "5\n"
    inner = package / "players/inner.py"
    inner.write_text(inner.read_text().replace("return 2", "return 20"))
    assert run_python(RUN, folder=package, HICKORY_CACHE=kept).stdout == "23\n"
    (package / "players/sizes.py").write_text("SIZE = 4\n")
    assert run_python(RUN, folder=package, HICKORY_CACHE=kept).stdout == "24\n"
    folders = list((tmp_path / "cache" / "kernels").glob("*/*"))
    assert sorted(folder.name.partition("-")[0] for folder in folders) == ["players.inner"] * 2 + ["players.outer"] * 3
    assert not list(package.rglob("*.nb?")), "nothing is written beside the modules"


def test_a_kernel_that_a_full_disk_cannot_keep_runs(tmp_path):
    full = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100)); "
    package, kept = small_package(tmp_path / "code"), str(tmp_path / "cache")
    assert run_python(full + RUN, folder=package, HICKORY_CACHE=kept).stdout == "5\n"
    assert not list((tmp_path / "cache").rglob("*.nbc"))
    assert run_python(RUN, folder=package, HICKORY_CACHE=kept).stdout == "5\n"


def test_what_is_no_part_of_a_kernel_does_not_change_its_hash(tmp_path):
    package = small_package(tmp_path)
    before = source_hash("players.outer", package / "players/outer.py")
    (package / "players/words.py").write_text("def word():\n    return 'another'\n")
    assert source_hash("players.outer", package / "players/outer.py") == before


def test_kernels_need_no_home_and_the_next_process_loads_them(tmp_path, no_folder):
    package = small_package(tmp_path / "code")
    (tmp_path / "tmp").mkdir()
    places = {"HICKORY_CACHE": "", "XDG_CACHE_HOME": "", "HOME": str(no_folder), "TMPDIR": str(tmp_path / "tmp")}
    told = run_python(RUN, folder=package, **places)
    assert told.stdout == "5\n"
    assert len(told.stderr.splitlines()) == 1
    assert f"caches cannot be kept in {no_folder}/.cache/hickory-stream (Not a directory)" in told.stderr
    assert len(list((tmp_path / "tmp").rglob("*.nbc"))) == 2
    hits = "; print(sum(five.stats.cache_hits.values()))"
    assert run_python(RUN + hits, folder=package, **places).stdout == "5\n1\n"


def test_an_unwritable_folder_is_replaced_and_reported_once(tmp_path, no_folder, monkeypatch, caplog):
    monkeypatch.setenv("HICKORY_CACHE", str(no_folder))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with caplog.at_level(logging.WARNING):
        folder = caches.cache_folder("shapes")
        assert caches.cache_folder("recordings").parent == folder.parent
    assert folder.is_dir()
    assert folder.is_relative_to(tmp_path)
    assert folder.parent.stat().st_mode & 0o077 == 0
    assert [record.message.count(str(no_folder)) for record in caplog.records] == [1]


def test_a_temporary_folder_that_others_can_write_is_not_taken(tmp_path, no_folder, monkeypatch):
    trap = tmp_path / f"hickory-stream-{os.getuid()}"
    trap.mkdir()
    trap.chmod(0o777)
    monkeypatch.setenv("HICKORY_CACHE", str(no_folder / "other"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert caches.cache_root() != trap


def write_entry(path, num_bytes, used_s):
    path.mkdir(parents=True)
    (path / "data").write_bytes(bytes(num_bytes))
    os.utime(path, (used_s, used_s))
    return path


@pytest.fixture
def kept(tmp_path, monkeypatch):
    monkeypatch.setenv("HICKORY_CACHE", str(tmp_path))
    write_entry(tmp_path / "shapes/aa/aa01", 400_000, 1000.0)
    write_entry(tmp_path / "shapes/bb/bb01", 400_000, 3000.0)
    write_entry(tmp_path / "kernels/py311/geometry-1", 300_000, 2000.0)
    write_entry(tmp_path / "recordings/room-1.truth", 100_000, 500.0)
    (tmp_path / "recordings/room-1.mcap").write_bytes(bytes(500_000))
    return tmp_path


def test_what_was_not_used_for_longest_goes_first(kept, monkeypatch):
    monkeypatch.setenv("HICKORY_CACHE_MB", "1.7")
    assert caches.prune() == 0
    monkeypatch.setenv("HICKORY_CACHE_MB", "1.5")
    assert caches.prune() == 700_000
    # The recording was made just now, and its truth stays with it.
    assert sorted(path.name for path in kept.rglob("*") if path.is_file() or path.suffix) == [
        "data",
        "data",
        "room-1.mcap",
        "room-1.truth",
    ]
    assert (kept / "shapes/bb/bb01").is_dir()


@pytest.mark.parametrize("value", ["-1", "nan", "inf", "much"])
def test_a_cap_that_is_no_number_of_megabytes_is_refused(value, monkeypatch):
    monkeypatch.setenv("HICKORY_CACHE_MB", value)
    with pytest.raises(ConfigError, match="HICKORY_CACHE_MB"):
        caches.cap_mb()


def test_the_command_shows_and_clears_by_kind(kept, capsys):
    assert main(["cache", "show", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["folder"] == str(kept)
    assert shown["kinds"]["shapes"] == {"entries": 2, "bytes": 800_000}
    assert shown["kinds"]["recordings"] == {"entries": 1, "bytes": 600_000}
    assert main(["cache", "show"]) == 0
    assert "shapes            2 entries       0.8 MB" in capsys.readouterr().out
    assert main(["cache", "clear", "shapes"]) == 0
    assert "0.8 MB" in capsys.readouterr().out
    assert not (kept / "shapes").exists()
    assert (kept / "kernels").exists()
    assert main(["cache", "clear"]) == 0
    assert list(kept.iterdir()) == []
    assert main(["cache", "clear", "boxes"]) == 2


_PROGRAM = """
import sys
from hickory_stream.base.compiled import kernel, numba
from hickory_stream.geometry.portable_kernels import exp

print(round(exp(1.0), 9), sum(exp.stats.cache_hits.values()), "numba.np.linalg" in sys.modules)

@numba.njit
def squared(x):
    return exp(x) * exp(x)

print(round(squared(1.0), 9))
"""


def test_a_loaded_kernel_needs_no_compiler_until_one_calls_it(tmp_path):
    def answer():
        environment = {**os.environ, "HICKORY_CACHE": str(tmp_path)}
        run = subprocess.run([sys.executable, "-c", _PROGRAM], env=environment, capture_output=True, check=True)
        return run.stdout.decode().split()

    assert answer() == ["2.718281828", "0", "True", "7.389056099"]
    assert answer() == ["2.718281828", "1", "False", "7.389056099"]
