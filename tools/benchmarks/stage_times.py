"""Processor time of a playback by stage, in a process of its own: what each thread does for each of its calls.

All work of a run is handed to executors; each call is timed by the processor time of its thread, so that neither other
load nor waiting counts. What the event loop and start-up take is the rest of the process; shapes are built by child
processes. Linux alone.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import subprocess
import sys
import threading
import time
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hickory_stream.base.config_text import read_config
from hickory_stream.base.json_text import dumps
from hickory_stream.config import MapperConfig
from hickory_stream.engine.mapper import Mapper
from hickory_stream.engine.play import play
from hickory_stream.sinks.disk_sink import DiskSink
from players import SourceOptions, make_source_note, open_from_note
from tools.benchmarks.processes import ROOT

STAGE_BUDGETS_MS = {
    "reading": 6.0,
    "perception": 45.0,
    "registration": 13.0,
    "deciding": 20.0,
    "shapes": 62.0,
    "writing": 12.0,
    "other": 9.0,
}
"""Processor time that a keyframe may take where two cores are to play keyframes of 4 Hz at three times real time.

In all 2 / (3 * 4 Hz) = 167 ms; shared out about as the stages were to each other at commit 5029994.
"""
BUDGET_MS = sum(STAGE_BUDGETS_MS.values())
# By what a call's name contains; the first that fits. What fits none is writing: files of views, journal, shapes.
_STAGES = (
    ("reading", ("decode", "_renumbered", "_placed", "next", "open_")),
    ("perception", ("prepare", "_perceived", "free_space")),
    ("registration", ("RegistrationFilter", "keyframe_surface", "_found")),
    ("deciding", ("handle", "decide", "_answered", "features", "extract", "pooled")),
)
STAGES = tuple(STAGE_BUDGETS_MS)


@dataclass(frozen=True, kw_only=True, slots=True)
class StageTimes:
    """Seconds of processor time by stage, over so many keyframes of a log of so many seconds; `wall_s` of the run.

    `folder_mb` is the map with its journal and images.
    """

    keyframes: int
    objects: int
    log_s: float
    wall_s: float
    folder_mb: float
    seconds: dict[str, float]
    calls: dict[str, float]

    def per_keyframe_ms(self) -> dict[str, float]:
        """Return milliseconds a keyframe by stage."""
        return {stage: 1e3 * seconds / max(self.keyframes, 1) for stage, seconds in self.seconds.items()}


def table_of_stages(times: StageTimes) -> str:
    """Return the processor time a keyframe by stage beside the budget, a line each."""
    spent = times.per_keyframe_ms()
    lines = [f"  {'stage':<14}{'ms':>8}{'budget':>8}"]
    lines += [f"  {stage:<14}{spent[stage]:>8.1f}{STAGE_BUDGETS_MS[stage]:>8.0f}" for stage in STAGES]
    lines.append(f"  {'all':<14}{sum(spent.values()):>8.1f}{BUDGET_MS:>8.0f}")
    return "\n".join(lines)


def stage_times(log: Path, out: Path, *overrides: str, frames: int | None = None) -> StageTimes:
    """Return the times of a playback, from a process of its own.

    Raises:
        RuntimeError: the child failed.
    """
    command = [sys.executable, "-m", "tools.benchmarks.stage_times", str(log), str(out), *overrides]
    command += [] if frames is None else ["--frames", str(frames)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}: {done.stderr.splitlines()[-1:]}")
    return StageTimes(**json.loads(done.stdout.splitlines()[-1]))


def _stage_of(call: str) -> str:
    return next((stage for stage, names in _STAGES if any(name in call for name in names)), "writing")


class _Clock:
    """Adds up the processor time of calls by their names, whatever thread they are made on."""

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self._lock = threading.Lock()

    def timed(self, function: Any) -> Any:
        """Return a function that does the same, and whose time is added."""
        name = _name_of(function)

        def run(*arguments: Any, **named: Any) -> Any:
            began = time.thread_time()
            try:
                return function(*arguments, **named)
            finally:
                with self._lock:
                    self.seconds[name] += time.thread_time() - began

        return run


def _name_of(function: Any) -> str:
    """Return the name of what a call is: asyncio hands functions over within a context, bound to their arguments."""
    if isinstance(function, functools.partial):
        is_context = getattr(function.func, "__qualname__", "") == "Context.run" and function.args
        return _name_of(function.args[0] if is_context else function.func)
    return str(getattr(function, "__qualname__", type(function).__name__))


def _measured(log: Path, out: Path, overrides: tuple[str, ...], frames: int | None) -> StageTimes:
    clock = _Clock()
    submit = ThreadPoolExecutor.submit

    def timed_submit(self: ThreadPoolExecutor, function: Any, /, *arguments: Any, **named: Any) -> Any:
        return submit(self, clock.timed(function), *arguments, **named)

    ThreadPoolExecutor.submit = timed_submit  # type: ignore[method-assign, assignment]
    DiskSink.show = clock.timed(DiskSink.show)  # type: ignore[method-assign]
    config = read_config(MapperConfig, None, ("run.shape_cache=false", *overrides))
    source = open_from_note(make_source_note([log], SourceOptions(), first_frames=frames))
    began, began_all = time.monotonic(), os.times()
    try:
        played = play(
            Mapper(config, out=out, overwrite=True),
            source,
            sinks=lambda folder: [(DiskSink(folder), True)],
            progress=lambda _: None,
        )
    finally:
        source.close()
    ended = os.times()
    seconds = dict.fromkeys(STAGES, 0.0)
    for call, spent in clock.seconds.items():
        seconds[_stage_of(call)] += spent
    seconds["shapes"] = ended.children_user + ended.children_system
    own = ended.user + ended.system - began_all.user - began_all.system
    seconds["other"] = max(0.0, own - sum(seconds[stage] for stage in STAGES if stage not in ("shapes", "other")))
    ledger = json.loads((out / "ledger.json").read_text())["frames"]
    snapshot = played.snapshot
    return StageTimes(
        keyframes=int(ledger["keyframes"]),
        objects=0 if snapshot is None else len(snapshot.objects),
        log_s=0.0 if snapshot is None else (snapshot.stamp_ns - (source.info.start_ns or snapshot.stamp_ns)) / 1e9,
        wall_s=time.monotonic() - began,
        folder_mb=sum(file.stat().st_size for file in out.rglob("*") if file.is_file()) / 1e6,
        seconds=seconds,
        calls=dict(sorted(clock.seconds.items(), key=lambda one: -one[1])[:25]),
    )


def main() -> None:
    """Measure, and print one line of JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("log", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("overrides", nargs="*")
    parser.add_argument("--frames", type=int)
    options = parser.parse_args()
    print(dumps(asdict(_measured(options.log, options.out, tuple(options.overrides), options.frames))))


if __name__ == "__main__":
    main()
