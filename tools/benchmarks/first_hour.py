"""The first hour of a new user, in throw-away folders: clone and demo, wheel and demo, clone and tests."""
# Homes and caches are empty, pip's among them. Settings of pip stay: they name the package index. The clone has what is
# committed. A part of tools/demo is timed by its repetition: what the first run takes longer, it compiles.

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from hickory_stream.errors import InputError
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.processes import ROOT, die_with_parent, folder_mb

PARTS = ("demo", "wheel", "tests")
_NO_CACHE = "mapper.run.shape_cache=false"


def measure(options: Options) -> list[Figure]:
    """Return seconds by the clock and of processor time of each part; a quick run leaves out the tests."""
    parts = options.only or (PARTS[:2] if options.quick else PARTS)
    if unknown := set(parts) - set(PARTS):
        raise InputError(f"--only {' '.join(sorted(unknown))} is no part; there are {', '.join(PARTS)}")
    figures = [figure("processors", os.cpu_count() or 1, "", "same")]
    for part in parts:
        with _fresh_folder() as (folder, environment):
            figures += {"demo": _demo, "wheel": _wheel, "tests": _tests}[part](folder, environment)
    return figures


def _demo(folder: Path, environment: dict[str, str]) -> list[Figure]:
    run = _Timed("demo", folder / "clone", environment)
    run.step("clone", "git", "clone", "--quiet", ROOT, folder / "clone", cwd=folder)
    run.step("install", "bash", "-c", "source tools/setup.sh run")
    run.step("first_run", "tools/demo", "--set", _NO_CACHE)
    run.step("warm_run", "tools/demo", "--set", _NO_CACHE)
    size = figure("demo_venv_mb", folder_mb(folder / "clone" / ".venv"), "MB", "lower")
    return [
        *run.figures("to_picture", "clone", "install", "first_run"),
        *run.difference("compile", "first_run", "warm_run"),
        size,
    ]


def _wheel(folder: Path, environment: dict[str, str]) -> list[Figure]:
    run = _Timed("wheel", folder, environment)
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check")
    subprocess.run(["git", "clone", "--quiet", ROOT, folder / "clone"], check=True)
    run.step("build", *pip, "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, folder / "clone")
    [wheel] = folder.glob("*.whl")
    run.step("install", sys.executable, "-m", "venv", folder / "venv")
    run.step("install", folder / "venv/bin/python", *pip[1:], "install", "--quiet", wheel)
    size = figure("wheel_venv_mb", folder_mb(folder / "venv"), "MB", "lower")
    run.step("demo", folder / "venv/bin/hickory-stream", "demo")
    return [*run.figures("to_picture", "install", "demo"), size]


def _tests(folder: Path, environment: dict[str, str]) -> list[Figure]:
    run = _Timed("tests", folder / "clone", environment)
    subprocess.run(["git", "clone", "--quiet", ROOT, folder / "clone"], check=True)
    run.step("install", "bash", "-c", "source tools/setup.sh tests")
    run.step("compile", ".venv/bin/python", "-m", "hickory_stream.engine.first_run")
    run.step("tests", "tools/test")
    size = figure("tests_venv_mb", folder_mb(folder / "clone" / ".venv"), "MB", "lower")
    return [*run.figures("set_up", "install", "compile"), size]


class _Timed:
    """Steps of a part, each with its seconds by the clock and of processor time."""

    def __init__(self, part: str, folder: Path, environment: dict[str, str]) -> None:
        self._part, self._folder, self._environment = part, folder, environment
        self._seconds: dict[str, tuple[float, float]] = {}

    def step(self, name: str, *command: object, cwd: Path | None = None) -> None:
        """Run a command; steps of one name add up. Raises `InputError` with its last words if it fails."""
        print(f"{self._part}: {name}", file=sys.stderr, flush=True)
        wall, processor = time.perf_counter(), _children_s()
        with tempfile.TemporaryFile("w+") as told:
            ended = subprocess.run(
                [str(word) for word in command], cwd=cwd or self._folder, env=self._environment, stdout=told,
                stderr=told, check=False, preexec_fn=die_with_parent,
            )  # fmt: skip
            told.seek(0)
            last = told.read().splitlines()[-1:]
        if ended.returncode != 0:
            raise InputError(f"{self._part}: {name} ended with status {ended.returncode}: {' '.join(last)}")
        before = self._seconds.get(name, (0.0, 0.0))
        self._seconds[name] = (before[0] + time.perf_counter() - wall, before[1] + _children_s() - processor)

    def figures(self, total: str, *of: str) -> list[Figure]:
        """Return the figures of each step, and of the sum of some."""
        rows = {**self._seconds, total: _sum(self._seconds[name] for name in of)}
        return [one for name, seconds in rows.items() for one in self._pair(name, seconds)]

    def difference(self, name: str, more: str, less: str) -> list[Figure]:
        """Return the figures of what one step took longer than another one."""
        return self._pair(name, _sum([self._seconds[more], (-self._seconds[less][0], -self._seconds[less][1])]))

    def _pair(self, name: str, seconds: tuple[float, float]) -> list[Figure]:
        names = (f"{self._part}_{name}_s", f"{self._part}_{name}_processor_s")
        return [figure(one, value, "s", "lower") for one, value in zip(names, seconds, strict=True)]


def _sum(seconds: Iterable[tuple[float, float]]) -> tuple[float, float]:
    wall, processor = zip(*seconds, strict=True)
    return sum(wall), sum(processor)


def _children_s() -> float:
    return os.times().children_user + os.times().children_system


@contextmanager
def _fresh_folder() -> Iterator[tuple[Path, dict[str, str]]]:
    """Yield an empty folder, and an environment whose home and caches are empty folders in it."""
    folder = Path(tempfile.mkdtemp(prefix="hickory-first-hour-"))
    try:
        home = folder / "home"
        home.mkdir()
        left_out = ("PYTHONPATH", "VIRTUAL_ENV", "HICKORY_CACHE", "XDG_CACHE_HOME", "UV_CACHE_DIR", "PIP_CACHE_DIR")
        environment = {name: value for name, value in os.environ.items() if name not in left_out} | {"HOME": str(home)}
        for settings in (Path.home() / ".config/pip/pip.conf", Path.home() / ".pip/pip.conf"):
            if settings.is_file():
                environment.setdefault("PIP_CONFIG_FILE", str(settings))
        yield folder, environment
    finally:
        shutil.rmtree(folder, ignore_errors=True)
