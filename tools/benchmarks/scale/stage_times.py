"""Processor time of a playback by stage, in a process of its own: the time of each thread for each of its calls."""
# Each call to an executor is timed by the processor time of its thread; the event loop is the rest. Linux alone.

import argparse
import functools
import json
import os
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
from tools.benchmarks.common.processes import folder_mb, in_child

STAGE_BUDGETS_MS = {
    "reading": 6.0, "perception": 45.0, "registration": 13.0, "deciding": 20.0, "shapes": 62.0, "writing": 12.0,
    "other": 9.0,
}  # fmt: skip
"""Processor time that a keyframe may take where two cores are to play keyframes of 4 Hz at three times real time.

In all 2 / (3 * 4 Hz) = 167 ms; shared out about as the stages were to each other at commit 5029994.
"""
BUDGET_MS = sum(STAGE_BUDGETS_MS.values())
# By a part of a call's name; the first that fits. Other calls are writing: files of views, journal, shapes.
_STAGES = (
    ("reading", ("decode", "_renumbered", "_placed", "next", "open_")),
    ("perception", ("prepare", "_perceived", "free_space")),
    ("registration", ("RegistrationFilter", "keyframe_surface", "keypoints_of", "_found")),
    ("deciding", ("handle", "decide", "_answered", "features", "extract", "pooled")),
)


@dataclass(frozen=True, kw_only=True, slots=True)
class StageTimes:
    """Seconds of processor time by stage, over so many keyframes of a log of so many seconds; `wall_s` of the run."""

    # `map_mb` is the map folder with its journal and images; `calls` are the 25 longest calls.

    keyframes: int
    objects: int
    log_s: float
    wall_s: float
    map_mb: float
    seconds: dict[str, float]
    calls: dict[str, float]

    def table(self) -> str:
        """Return the processor time a keyframe by stage beside the budget, a line each."""
        spent = {stage: 1e3 * seconds / max(self.keyframes, 1) for stage, seconds in self.seconds.items()}
        rows = [(stage, spent[stage], budget) for stage, budget in STAGE_BUDGETS_MS.items()]
        rows.append(("all", sum(spent.values()), BUDGET_MS))
        return "\n".join(
            [f"  {'stage':<14}{'ms':>8}{'budget':>8}", *(f"  {a:<14}{b:>8.1f}{c:>8.0f}" for a, b, c in rows)]
        )


def stage_times(log: Path, out: Path) -> StageTimes:
    found: StageTimes = in_child(_measured, log, out, [], None)
    return found


class _Clock:
    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)
        self._lock = threading.Lock()

    def timed(self, function: Any) -> Any:
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
    if isinstance(function, functools.partial):
        is_context = getattr(function.func, "__qualname__", "") == "Context.run" and function.args
        return _name_of(function.args[0] if is_context else function.func)
    return str(getattr(function, "__qualname__", type(function).__name__))


def _measured(log: Path, out: Path, overrides: list[str], frames: int | None) -> StageTimes:
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
    ended, snapshot = os.times(), played.snapshot
    assert snapshot is not None
    seconds = dict.fromkeys(STAGE_BUDGETS_MS, 0.0)
    for call, spent in clock.seconds.items():
        seconds[next((stage for stage, names in _STAGES if any(name in call for name in names)), "writing")] += spent
    own_s = ended.user + ended.system - began_all.user - began_all.system
    seconds["other"] = max(0.0, own_s - sum(seconds.values()))
    seconds["shapes"] = ended.children_user + ended.children_system
    return StageTimes(
        keyframes=int(json.loads((out / "ledger.json").read_text())["frames"]["keyframes"]),
        objects=len(snapshot.objects), log_s=(snapshot.stamp_ns - (source.info.start_ns or snapshot.stamp_ns)) / 1e9,
        wall_s=time.monotonic() - began, map_mb=folder_mb(out), seconds=seconds,
        calls=dict(sorted(clock.seconds.items(), key=lambda one: -one[1])[:25]),
    )  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("log", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("overrides", nargs="*")
    parser.add_argument("--frames", type=int)
    print(dumps(asdict(_measured(**vars(parser.parse_args())))))
