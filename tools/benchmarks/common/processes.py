"""Child processes: the command line with its time and memory, coarse runs of it, and programs that print JSON."""

import ctypes
import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import IO, Any

import psutil

ROOT = Path(__file__).resolve().parents[3]
DEMO = ROOT / "recordings" / "demo.mcap"
NO_SHAPES = "mapping.requests.max_failures=0"
"""The override that asks for no shape of any object."""
COARSE = (
    "shapes.fused.volume.cells=16",
    "shapes.fit.cells=16",
    "shapes.fit.num_seeds=1",
    "shapes.fit.num_candidates=1",
    "shapes.fit.max_primitives=1",
    "shapes.fit.coarse_samples=100",
    "shapes.fit.coarse_iterations=3",
    "shapes.fit.fine_samples=300",
    "shapes.fit.fine_iterations=4",
    "shapes.fit.gain_samples=1000",
    # Requested early, so that a short run has jobs under way most of the time.
    "mapping.requests.first_sightings=4",
    "mapping.requests.latency_s=1.0",
    "run.shape_cache=false",
)
"""Overrides of a mapper's configuration with which shapes take hardly any time."""
_PLAY = (sys.executable, "-m", "hickory_stream", "play")
_QUIET = ("--overwrite", "--viewer", "none", "--json")
_SAMPLE_S = 0.05


@dataclass(frozen=True, kw_only=True, slots=True)
class Played:
    """A finished `play`: its last event, seconds, peak memory with workers, and (frames, MB) of the process itself."""

    finished: dict[str, Any]
    seconds: float
    peak_mb: float
    memory_by_frames: list[tuple[int, float]]


def play(log: Path, out: Path, *arguments: str) -> Played:
    """Run `hickory-stream play` and watch it."""
    command = [*_PLAY, str(log), "--out", str(out), *_QUIET, *overridden("run.shape_cache=false"), *arguments]
    started = time.perf_counter()
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen(command, cwd=ROOT, **pipes)
    frames = [0]

    def follow() -> None:
        for line in process.stderr or ():
            if line.startswith("{"):
                frames[0] = json.loads(line).get("frames", frames[0])

    watcher = threading.Thread(target=follow, daemon=True)
    watcher.start()
    peak_mb, samples = 0.0, []
    while process.poll() is None:
        own_mb, tree_mb = _memory_mb(process.pid)
        peak_mb = max(peak_mb, tree_mb)
        samples.append((frames[0], own_mb))
        time.sleep(_SAMPLE_S)
    seconds = time.perf_counter() - started
    watcher.join()
    assert process.stdout is not None
    lines = process.stdout.read().splitlines()
    if process.returncode != 0:
        raise RuntimeError(f"{' '.join(command)} ended with {process.returncode}: {lines[-1:]}")
    return Played(finished=json.loads(lines[-1]), seconds=seconds, peak_mb=peak_mb, memory_by_frames=samples)


def play_coarsely(
    out: Path, frames: int | None, *arguments: str, stderr: int | IO[str] = subprocess.PIPE, **options: Any
) -> subprocess.Popen[str]:
    """Start `play` on the first frames of the embedded recording, in a process group of its own, with coarse shapes."""
    # Without a number of frames, all of them are played, with shapes as they are.
    first = () if frames is None else ("--frames", str(frames), *overridden(*COARSE))
    return subprocess.Popen(
        [*_PLAY, str(DEMO), "--out", str(out), *_QUIET, *first, *arguments], cwd=ROOT, text=True,
        stdout=subprocess.PIPE, stderr=stderr, start_new_session=True, preexec_fn=die_with_parent, **options,
    )  # fmt: skip


def overridden(*overrides: str) -> list[str]:
    """Return the arguments of the command line for overrides of a mapper's configuration."""
    return [word for override in overrides for word in ("--set", f"mapper.{override}")]


def die_with_parent() -> None:
    """Have the kernel kill this child when the benchmark is killed."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


def finished(process: subprocess.Popen[str]) -> dict[str, Any]:
    """Wait for `play` to end, and return its last event; raise RuntimeError if it failed."""
    stdout, stderr = process.communicate()
    if process.returncode != 0:
        raise RuntimeError(f"play ended with {process.returncode}: {stderr.splitlines()[-1:]}")
    last: dict[str, Any] = json.loads(stdout.splitlines()[-1])
    return last


def output_of(*arguments: object) -> str:
    command = [sys.executable, *map(str, arguments)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, preexec_fn=die_with_parent)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}: {done.stderr.splitlines()[-1:]}")
    return done.stdout


def json_of(*arguments: object) -> Any:
    """Return the JSON in the last line of the output of our interpreter, as `output_of`."""
    return json.loads(output_of(*arguments).splitlines()[-1])


def in_child(work: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
    """Return the result of a function of a module in a spawned process of its own, or raise its error."""
    with ProcessPoolExecutor(1, get_context("spawn"), initializer=die_with_parent) as pool:
        return pool.submit(work, *arguments, **named).result()


def best_s(work: Callable[[], object], repeats: int = 4, clock: Callable[[], float] = time.process_time) -> float:
    """Return the least processor seconds of some repeats: the machine is shared."""
    seconds = []
    for _ in range(repeats):
        started = clock()
        work()
        seconds.append(clock() - started)
    return min(seconds)


def resident_mb(name: str = "VmRSS") -> float:
    """Return the resident memory of this process, now (VmRSS) or at most since its start (VmHWM); Linux alone."""
    status = Path("/proc/self/status").read_text()
    return int(status.split(f"{name}:")[1].split()[0]) * 1024 / 1e6


def watched_peak_mb() -> list[float]:
    """Return a list of one number, which a thread keeps at the peak of this process's memory from now on."""
    peak_mb, process = [0.0], psutil.Process()

    def watch() -> None:
        while True:
            peak_mb[0] = max(peak_mb[0], process.memory_info().rss / 1e6)
            time.sleep(_SAMPLE_S)

    threading.Thread(target=watch, daemon=True).start()
    return peak_mb


def folder_mb(folder: Path) -> float:
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) / 1e6


def _memory_mb(pid: int) -> tuple[float, float]:
    try:
        process = psutil.Process(pid)
        own = process.memory_info().rss
        children = sum(child.memory_info().rss for child in process.children(recursive=True))
    except psutil.Error:  # it has just ended
        return 0.0, 0.0
    return own / 1e6, (own + children) / 1e6
