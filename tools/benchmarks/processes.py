"""The command line as a child process, with its wall time and its memory."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil

ROOT = Path(__file__).resolve().parents[2]
_SAMPLE_S = 0.05


@dataclass(frozen=True, kw_only=True, slots=True)
class Played:
    """A finished `play`: its last event, seconds, the peak memory with its workers, and (frames, MB) of itself."""

    finished: dict[str, Any]
    seconds: float
    peak_mb: float
    memory_by_frames: list[tuple[int, float]]


def play(log: Path, out: Path, *arguments: str) -> Played:
    """Run `hickory-stream play` and watch it; raise RuntimeError if it fails."""
    command = [sys.executable, "-m", "hickory_stream", "play", str(log), "--out", str(out), "--overwrite"]
    started = time.perf_counter()
    process = subprocess.Popen(
        [*command, "--viewer", "none", "--json", "--set", "mapper.run.shape_cache=false", *arguments],
        cwd=ROOT,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    frames = [0]
    watcher = threading.Thread(target=_watch_progress, args=(process, frames), daemon=True)
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


def _watch_progress(process: subprocess.Popen[str], frames: list[int]) -> None:
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("{"):
            frames[0] = json.loads(line).get("frames", frames[0])


def _memory_mb(pid: int) -> tuple[float, float]:
    """Return the resident memory of a process, and of it with its children."""
    try:
        process = psutil.Process(pid)
        own = process.memory_info().rss
        children = sum(child.memory_info().rss for child in process.children(recursive=True))
    except psutil.Error:  # it has just ended
        return 0.0, 0.0
    return own / 1e6, (own + children) / 1e6
