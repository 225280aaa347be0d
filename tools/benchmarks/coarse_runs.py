"""Runs of `play` where only the engine is measured: the first frames of the embedded recording, with coarse shapes."""

from __future__ import annotations

import ctypes
import json
import signal
import subprocess
import sys
from typing import IO, TYPE_CHECKING, Any

from tools.benchmarks.processes import ROOT

if TYPE_CHECKING:
    from pathlib import Path

_LOG = ROOT / "recordings" / "demo.mcap"
COARSE = (
    "mapper.shapes.fused.volume.cells=16",
    "mapper.shapes.fit.cells=16",
    "mapper.shapes.fit.num_seeds=1",
    "mapper.shapes.fit.num_candidates=1",
    "mapper.shapes.fit.max_primitives=1",
    "mapper.shapes.fit.coarse_samples=100",
    "mapper.shapes.fit.coarse_iterations=3",
    "mapper.shapes.fit.fine_samples=300",
    "mapper.shapes.fit.fine_iterations=4",
    "mapper.shapes.fit.gain_samples=1000",
    # Asked for early, so that a short run has jobs under way most of the time.
    "mapper.mapping.requests.first_sightings=4",
    "mapper.mapping.requests.latency_s=1.0",
    "mapper.run.shape_cache=false",
)


def play_coarsely(
    out: Path, frames: int, *arguments: str, stderr: int | IO[str] = subprocess.PIPE
) -> subprocess.Popen[str]:
    """Start `play` on the first frames of the embedded recording, in a process group of its own."""
    command = [sys.executable, "-m", "hickory_stream", "play", str(_LOG), "--out", str(out), "--overwrite"]
    command += ["--viewer", "none", "--json", "--frames", str(frames)]
    for override in COARSE:
        command += ["--set", override]
    return subprocess.Popen(
        [*command, *arguments],
        cwd=ROOT,
        text=True,
        stdout=subprocess.PIPE,
        stderr=stderr,
        start_new_session=True,
        preexec_fn=die_with_parent,
    )


def die_with_parent() -> None:
    """Have the kernel kill this child when the benchmark is killed: nothing goes on playing behind its back."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


def finished(process: subprocess.Popen[str]) -> dict[str, Any]:
    """Wait for `play` to end, and return its last event; raise RuntimeError if it failed."""
    stdout, stderr = process.communicate()
    if process.returncode != 0:
        raise RuntimeError(f"play ended with {process.returncode}: {stderr.splitlines()[-1:]}")
    last: dict[str, Any] = json.loads(stdout.splitlines()[-1])
    return last
