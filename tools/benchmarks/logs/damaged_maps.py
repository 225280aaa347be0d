"""Altered maps: every command explains the fault in a sentence, writes nothing elsewhere, and takes bounded memory."""
# A case is a small sound map, one change to it and a seed; a child process, forked where everything is loaded, runs the
# commands on it. An audit hook of the child notes the files that it opened, the programs it ran and its connections.

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
from dataclasses import asdict, dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from hickory_stream.base.compiled import kernels_folder
from hickory_stream.base.config_text import read_config, to_toml
from hickory_stream.box_scene import SceneSource
from hickory_stream.config import MapperConfig
from hickory_stream.engine.shape_jobs.job_folder import write_job
from hickory_stream.events import RequestShape
from hickory_stream.map_folder.manifest import MANIFEST, manifest_json
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.settings import Settings
from hickory_stream.testing import InstanceSegmenter, MeanColorExtractor
from tools.benchmarks.common.cached_runs import play_into
from tools.benchmarks.common.figures import Figure, figure
from tools.benchmarks.common.processes import COARSE, DEMO
from tools.benchmarks.common.repetitions import Repetitions
from tools.damage.map_changes import OUTSIDE, TARGETS, change_map, change_text

_TOO_LONG_S = 60
_MOST_BYTES = 2 << 30
# The exit status of a command: done; does not hold (verify, replay, reconstruct); bad input; no path.
_STATUSES = {0, 1, 2, 3}
_MAY_BE_1 = {"verify", "replay", "reconstruct"}
_KINDS = (*TARGETS, "toml")
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_CHANGING = ("os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.link", "os.symlink", "os.truncate", "shutil.rmtree")
_RUNNING = ("subprocess.Popen", "os.exec", "os.system", "os.posix_spawn", "socket.connect", "ctypes.dlopen")
_PLACES = ("--start", "0,-1.5", "--goal", "0,-1.4")
_UNVERIFIED = "--allow-unverified"


@dataclass(slots=True)
class MapTally:
    """The result of one case, or the sum over all; `peak_mb` is the memory of a case beyond the process before it."""

    cases: int = 0
    refused: int = 0
    crashes: list[str] = field(default_factory=list)
    outside: list[str] = field(default_factory=list)
    peak_mb: float = 0.0

    def add(self, case: "MapTally") -> None:
        self.cases += case.cases
        self.refused += case.refused
        self.crashes += case.crashes
        self.outside += case.outside
        self.peak_mb = max(self.peak_mb, case.peak_mb)


def figures_of(tally: MapTally) -> list[Figure]:
    for text in (*tally.crashes[:20], *tally.outside[:20]):
        print(f"  {text}")
    return [
        figure("map_damage_cases", tally.cases),
        figure("map_damage_crashes", len(tally.crashes), "", "lower"),
        figure("map_damage_outside", len(tally.outside), "", "lower"),
        figure("map_damage_peak_mb", tally.peak_mb, "MB", "lower"),
        figure("map_damage_refused", tally.refused, "cases"),
    ]


def run_map_cases(
    num_cases: int, seed: int, repetitions: Repetitions | None = None, sound: Path | None = None
) -> MapTally:
    """Return the result of so many cases, over all kinds of files; those of `repetitions` are not repeated."""
    # Copies of the map `sound` are altered; one is made where there is none.
    repetitions = repetitions or Repetitions()
    with tempfile.TemporaryDirectory() as temporary:
        if sound is None:
            sound = Path(temporary) / "sound"
            write_small_map(sound)
        _warm_up(sound, Path(temporary) / "warm")
        for i in repetitions.missing(num_cases):
            repetitions.add(**asdict(run_case(sound, Path(temporary) / "case", i, seed)))
    tally = MapTally()
    for record in repetitions.records:
        tally.add(MapTally(**record))
    return tally


def run_case(sound: Path, folder: Path, index: int, seed: int) -> MapTally:
    """Return the result of one change to a copy of a sound map, tried in `folder`, which is then removed."""
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
            change, commands = _toml_case(path, deep, rng)
        else:
            if rng.random() < 0.2:
                as_live_and_killed(path)
            change = change_map(path, kind, rng)
            commands = _commands(path, deep / "out", kind, rng)
        return _tried(f"case {index}, {change}", commands, deep)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _toml_case(path: Path, folder: Path, rng: np.random.Generator) -> tuple[str, list[list[str]]]:
    kind = str(rng.choice(("robot", "profile", "config")))
    file = folder / f"{kind}.toml"
    name, command = str(path), []
    if kind == "robot":
        text = (resources.files("hickory_stream.navigation") / "robots" / "b2.toml").read_text(encoding="utf-8")
        command = ["plan", name, *_PLACES, "--robot", str(file)]
    elif kind == "profile":
        text = (resources.files("players") / "profiles" / "realsense.toml").read_text(encoding="utf-8")
        command = ["doctor", str(DEMO), "--profile", str(file)]
    else:
        text, command = to_toml(Settings()), ["config", "check", str(file)]
    file.write_text(change_text(text, rng), encoding="utf-8")
    return file.name, [command]


def _commands(path: Path, out: Path, kind: str, rng: np.random.Generator) -> list[list[str]]:
    name = str(path)
    looks, checks, resumes = [["inspect", name, "--json"]], [["verify", name, "--json"]], [["resume", name]]
    outputs = {kind: out / f"scene.{kind}" for kind in ("json", "ply", "glb")}
    outputs = {"mjcf": out / "mjcf" / "scene", "urdf": out / "urdf" / "scene", **outputs}
    exports = [["export", name, "--format", f, "-o", str(file), _UNVERIFIED] for f, file in outputs.items()]
    exports += [["export", name, "--format", "nav2", "-o", str(out / "grid.yaml"), "--robot", "point", _UNVERIFIED]]
    plans = [["plan", name, *_PLACES, "--robot", "point", _UNVERIFIED]]
    history = [["replay", name], ["inspect", name, "--at", "0.4"], ["diff", name, "0", "0.4"]]
    jobs = [["reconstruct", str(next((path / "failed").iterdir()))]] if (path / "failed").is_dir() else []
    out.mkdir(parents=True, exist_ok=True)
    match kind:
        case "job":
            return jobs
        case "journal":
            return [*history, *checks, *resumes]
        case "view":
            return [*checks, *jobs]
        case "mesh":
            return [*looks, *checks, exports[4]]
        case "link" | "pipe":
            return [*looks, *history, *checks, *jobs, exports[0], *resumes]
        case _:
            picked = [exports[int(i)] for i in rng.choice(len(exports), 2, replace=False)]
            return [*looks, *picked, *plans, history[1], *checks, *resumes]


def _warm_up(sound: Path, folder: Path) -> None:
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


def _tried(case: str, commands: list[list[str]], folder: Path) -> MapTally:
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        try:
            answer = _child(commands, folder)
        except BaseException as error:  # noqa: BLE001 # a child that ends otherwise would go on as its parent
            answer = {"crashes": [f"{type(error).__name__}: {error}"]}
        os.write(writing, json.dumps(answer).encode()[:60_000])
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        text = pipe.read()
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if status != 0 or not text:
        ended = signal.Signals(-status).name if status < 0 else str(status)
        return MapTally(cases=1, crashes=[f"{case}: ended with {ended}"])
    tally = MapTally(**{"cases": 1, **json.loads(text)})
    tally.crashes = [f"{case}: {line}" for line in tally.crashes]
    tally.outside = [f"{case}: {line}" for line in tally.outside]
    return tally


def _child(commands: list[list[str]], folder: Path) -> dict[str, Any]:
    before = psutil.Process().memory_info()
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
            except (Exception, SystemExit) as error:  # noqa: BLE001 # counted here
                where = traceback.extract_tb(error.__traceback__)[-1]
                place = f"{Path(where.filename).name}:{where.lineno}"
                crashes.append(f"{command[0]}: {type(error).__name__}: {error} ({place})"[:400])
                continue
        num_lines = sum(line.startswith("hickory-stream: ") for line in errors.getvalue().splitlines())
        is_refused |= status == 2
        if not _is_an_answer(command[0], status, num_lines):
            crashes.append(f"{command[0]}: status {status}, {num_lines} lines: {errors.getvalue()[-200:]}")
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 - before.rss / 2**20
    return {"crashes": crashes, "outside": outside, "refused": int(is_refused), "peak_mb": max(peak_mb, 0.0)}


def _is_an_answer(command: str, status: int, num_lines: int) -> bool:
    if status == 1:
        return command in _MAY_BE_1
    # The doctor's own page names the faults of a log.
    return status in _STATUSES and (status != 2 or num_lines == 1 or command == "doctor")


def _watch(folder: Path, outside: list[str]) -> None:
    # Kernels that a command compiles are stored with all others.
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


# A small map of an in-memory scene, with every kind of file of a map folder: the map that is damaged.
_NUM_FRAMES = 6
_OVERRIDES = (
    *COARSE, "mapping.requests.first_sightings=2", "mapping.requests.latency_s=0.5", "journal.checkpoint_keyframes=3",
    "run.workers=1",
)  # fmt: skip


def write_small_map(path: Path) -> None:
    """Write a finished map of a few objects, with the input of a shape job in `failed/`."""
    config = read_config(MapperConfig, None, _OVERRIDES)
    segmenter = InstanceSegmenter(SceneSource(_NUM_FRAMES).instances)
    play_into(path, SceneSource(_NUM_FRAMES), config, segmenter=segmenter, extractor=MeanColorExtractor())
    saved = open_map(path)
    tracked = next(item for item in saved.snapshot.objects if item.shape is not None)
    request = RequestShape(
        ticket=1, object_id=tracked.id, views=tracked.views, points_world=tracked.points_world, colors=tracked.colors,
        box=tracked.box, support_z_m=0.0, due_ns=0,
    )  # fmt: skip
    write_job(path / "failed" / f"{tracked.id:06d}", request, saved.views, config.shapes)


def as_live_and_killed(path: Path) -> None:
    """Make a map look like a killed live run, which `resume` saves as of its last step."""
    manifest = open_map(path, warns=False).manifest
    run = {**manifest.run, "mode": "live"}
    killed = replace(manifest, finished_cleanly=False, digest=None, run=run)
    (path / MANIFEST).unlink()
    (path / MANIFEST).write_bytes(manifest_json(killed))
