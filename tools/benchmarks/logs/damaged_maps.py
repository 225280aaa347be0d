"""Altered maps: every command says in a sentence what is wrong, writes nothing elsewhere, and takes bounded memory.

A case is a small sound map, one change to it and a seed; a child process, forked where everything is loaded, runs the
commands on it. An audit hook of the child tells what it opened, ran and connected to: what the code did, not what it
left behind.
"""

from __future__ import annotations

import contextlib
import io
import json
import logging
import os
import resource
import shutil
import signal
import sys
import tempfile
import traceback
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from hickory_stream.compiled import kernels_folder
from tools.benchmarks.common.figures import Figure, figure
from tools.benchmarks.common.repetitions import Repetitions
from tools.benchmarks.logs.map_changes import OUTSIDE, TARGETS, change_map, change_text
from tools.benchmarks.logs.small_maps import as_live_and_killed, write_small_map

_TOO_LONG_S = 60
_MOST_BYTES = 2 << 30
# What a command may exit with: done; does not hold (verify, replay, reconstruct); bad input; no path.
_STATUSES = {0, 1, 2, 3}
_MAY_BE_1 = {"verify", "replay", "reconstruct"}
_KINDS = (*TARGETS, "toml")
_TOMLS = ("robot", "profile", "config")
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_CHANGING = ("os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.link", "os.symlink", "os.truncate", "shutil.rmtree")
_RUNNING = ("subprocess.Popen", "os.exec", "os.system", "os.posix_spawn", "socket.connect", "ctypes.dlopen")


@dataclass(slots=True)
class MapTally:
    """What came of all cases; `peak_mb` is what a case took more than the process before it."""

    cases: int = 0
    refused: int = 0
    crashes: list[str] = field(default_factory=list)
    outside: list[str] = field(default_factory=list)
    peak_mb: float = 0.0


def figures_of(tally: MapTally) -> list[Figure]:
    """Return a tally as figures."""
    return [
        figure("map_damage_cases", tally.cases, "", "higher"),
        figure("map_damage_crashes", len(tally.crashes), "", "lower"),
        figure("map_damage_outside", len(tally.outside), "", "lower"),
        figure("map_damage_peak_mb", tally.peak_mb, "MB", "lower"),
        figure("map_damage_refused", tally.refused, "cases", "higher"),
    ]


def run_map_cases(
    num_cases: int, seed: int, repetitions: Repetitions | None = None, sound: Path | None = None
) -> MapTally:
    """Return what came of so many cases, spread over all kinds of files; those of `repetitions` are there.

    `sound` is the map that copies are altered of; one is made where there is none.
    """
    repetitions = repetitions or Repetitions()
    with tempfile.TemporaryDirectory() as temporary:
        if sound is None:
            sound = Path(temporary) / "sound"
            write_small_map(sound)
        _warm_up(sound, Path(temporary) / "warm")
        for i in repetitions.missing(num_cases):
            repetitions.add(**asdict(run_case(sound, Path(temporary) / "case", i, seed)))
    return _sum(MapTally(**record) for record in repetitions.records)


def run_case(sound: Path, folder: Path, index: int, seed: int) -> MapTally:
    """Return what came of one change to a copy of a sound map, made and tried in `folder`, which is then removed."""
    rng = np.random.default_rng([seed, index])
    kind = _KINDS[index % len(_KINDS)]
    deep = folder / "a" / "b" / "c"
    path = deep / "map"
    path.parent.mkdir(parents=True)
    for outside in {folder / OUTSIDE, deep / OUTSIDE}:
        outside.mkdir()
        (outside / "secret").write_text("years of work")
    try:
        shutil.copytree(sound, path)
        if kind == "toml":
            told, commands = _toml_case(path, deep, rng)
        else:
            if rng.random() < 0.2:
                as_live_and_killed(path)
            told = change_map(path, kind, rng)
            commands = _commands(path, deep / "out", kind, rng)
        return _tried(f"case {index}, {told}", commands, deep)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _toml_case(path: Path, folder: Path, rng: np.random.Generator) -> tuple[str, list[list[str]]]:
    kind = str(rng.choice(_TOMLS))
    file = folder / f"{kind}.toml"
    file.write_text(change_text(_toml_text(kind), rng), encoding="utf-8")
    places = ["--start", "0,-1.5", "--goal", "0,-1.4"]
    commands = {
        "robot": ["plan", str(path), *places, "--robot", str(file)],
        "profile": ["doctor", str(Path("recordings/demo.mcap").absolute()), "--profile", str(file)],
        "config": ["config", "check", str(file)],
    }
    return f"{kind}.toml", [commands[kind]]


def _toml_text(kind: str) -> str:
    if kind == "robot":
        return (resources.files("hickory_stream.navigation") / "robots" / "b2.toml").read_text(encoding="utf-8")
    if kind == "profile":
        return (resources.files("players") / "profiles" / "realsense.toml").read_text(encoding="utf-8")
    from hickory_stream.config_text import to_toml
    from hickory_stream.settings import Settings

    return to_toml(Settings())


def _commands(path: Path, out: Path, kind: str, rng: np.random.Generator) -> list[list[str]]:
    """Return the commands that meet a change: those that read such files."""
    name, proof = str(path), ["--unproven"]
    looks = [["inspect", name, "--json"]]
    exports = [["export", name, "--format", f, "-o", str(out / f / "scene"), *proof] for f in ("mjcf", "urdf")]
    exports += [["export", name, "--format", f, "-o", str(out / f"scene.{f}"), *proof] for f in ("json", "ply", "glb")]
    exports += [["export", name, "--format", "nav2", "-o", str(out / "grid.yaml"), "--robot", "point", *proof]]
    plans = [["plan", name, "--start", "0,-1.5", "--goal", "0,-1.4", "--robot", "point", *proof]]
    history = [["replay", name], ["inspect", name, "--at", "0.4"], ["diff", name, "0", "0.4"]]
    checks = [["verify", name, "--json"]]
    jobs = [["reconstruct", str(next((path / "failed").iterdir()))]] if (path / "failed").is_dir() else []
    resumes = [["resume", name]]
    out.mkdir(parents=True, exist_ok=True)
    match kind:
        case "job":
            return jobs
        case "journal":
            return [*history, *checks, *resumes]
        case "view" | "png":
            return [*checks, *jobs]
        case "mesh":
            return [*looks, *checks, exports[4]]
        case "link" | "pipe":
            return [*looks, *history, *checks, *jobs, exports[0], *resumes]
        case _:
            picked = [exports[int(i)] for i in rng.choice(len(exports), 2, replace=False)]
            return [*looks, *picked, *plans, history[1], *checks, *resumes]


def _warm_up(sound: Path, folder: Path) -> None:
    """Load and compile what the commands need, so that the children have it."""
    shutil.copytree(sound, folder / "map")
    for kind in ("objects", "journal", "job"):
        commands = _commands(folder / "map", folder / "out", kind, np.random.default_rng(0))
        for command in [*commands, *_toml_case(folder / "map", folder, np.random.default_rng(0))[1]]:
            with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
                _main(command)
    shutil.rmtree(folder)


def _main(command: list[str]) -> int:
    from hickory_stream.cli import main

    return main(command)


# ---- the child ------------------------------------------------------------------------------------------------------


def _tried(case: str, commands: list[list[str]], folder: Path) -> MapTally:
    """Run commands in a child that is forked, and return what came of them."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        try:
            told = _child(commands, folder)
        except BaseException as error:  # noqa: BLE001 # a child that ends otherwise would go on as its parent
            told = {"crashes": [f"{type(error).__name__}: {error}"]}
        os.write(writing, json.dumps(told).encode()[:60_000])
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        answer = pipe.read()
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if status != 0 or not answer:
        ended = signal.Signals(-status).name if status < 0 else str(status)
        return MapTally(cases=1, crashes=[f"{case}: ended with {ended}"])
    told = json.loads(answer)
    return MapTally(
        cases=1,
        refused=int(told.get("refused", 0)),
        crashes=[f"{case}: {text}" for text in told.get("crashes", [])],
        outside=[f"{case}: {text}" for text in told.get("outside", [])],
        peak_mb=told.get("peak_mb", 0.0),
    )


def _child(commands: list[list[str]], folder: Path) -> dict[str, Any]:
    process = psutil.Process()
    before = process.memory_info()
    resource.setrlimit(resource.RLIMIT_AS, (before.vms + _MOST_BYTES, resource.RLIM_INFINITY))
    signal.alarm(_TOO_LONG_S)
    sys.dont_write_bytecode = True
    outside: list[str] = []
    _watch(folder.resolve(), outside)
    crashes: list[str] = []
    is_refused = False
    for command in commands:
        errors = io.StringIO()
        logging.getLogger().handlers.clear()
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(errors):
            try:
                status = _main([*command, "--debug"])
            except (Exception, SystemExit) as error:  # noqa: BLE001 # what is counted here
                where = traceback.extract_tb(error.__traceback__)[-1]
                place = f"{Path(where.filename).name}:{where.lineno}"
                crashes.append(f"{command[0]}: {type(error).__name__}: {error} ({place})"[:400])
                continue
        told = [line for line in errors.getvalue().splitlines() if line.startswith("hickory-stream: ")]
        is_refused |= status == 2
        if not _is_an_answer(command[0], status, len(told)):
            crashes.append(f"{command[0]}: status {status}, {len(told)} lines: {errors.getvalue()[-200:]}")
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 - before.rss / 2**20
    return {"crashes": crashes, "outside": outside, "refused": is_refused, "peak_mb": max(peak_mb, 0.0)}


def _is_an_answer(command: str, status: int, num_lines: int) -> bool:
    """Return whether a command ended as it may: what it refuses it refuses in one line."""
    if status == 1:
        return command in _MAY_BE_1
    # A page of its own says what is wrong with a log.
    return status in _STATUSES and (status != 2 or num_lines == 1 or command == "doctor")


def _watch(folder: Path, outside: list[str]) -> None:
    """Note what this process opens, changes, runs or connects to outside of a folder, from now on."""
    # Kernels that a command compiles are kept where all are.
    kernels = kernels_folder().resolve()
    canaries = (str(folder / OUTSIDE), str(folder.parents[2] / OUTSIDE), "/etc/passwd")

    def is_inside(name: object) -> bool:
        if not isinstance(name, str | bytes | os.PathLike):
            return True  # a descriptor, which was opened by name before
        path = Path(os.fsdecode(name))
        place = path.parent.resolve() / path.name
        is_ours = place.is_relative_to(folder) or place.is_relative_to(kernels)
        return is_ours and not str(place).startswith(canaries)

    def note(event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open":
            name, mode, flags = arguments
            is_writing = bool((flags or 0) & _WRITES) or any(letter in (mode or "") for letter in "wax+")
            is_canary = isinstance(name, str) and str(Path(name).resolve()).startswith(canaries)
            if (is_writing and name != os.devnull and not is_inside(name)) or is_canary:
                outside.append(f"{'writes' if is_writing else 'reads'} {name}"[:200])
        elif event in _CHANGING and not is_inside(arguments[0]):
            outside.append(f"{event} {arguments[0]}"[:200])
        elif event in _RUNNING:
            outside.append(f"{event} {arguments[:2]}"[:200])

    sys.addaudithook(note)


def _sum(cases: Iterable[MapTally]) -> MapTally:
    """Return what came of all of them."""
    tally = MapTally()
    for case in cases:
        tally.cases += case.cases
        tally.refused += case.refused
        tally.crashes += case.crashes
        tally.outside += case.outside
        tally.peak_mb = max(tally.peak_mb, case.peak_mb)
    return tally
