"""What readers of a large map take, each measured in a process of its own: opening, looking back, a path, a picture.

Processor time; the first path, which loads kernels, is not counted. Opening and the picture do count what they load.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from hickory_stream.engine.journal import Journal
from hickory_stream.engine.saved_map import SavedMap, open_map
from hickory_stream.evaluation.render import render_map
from hickory_stream.json_text import dumps
from hickory_stream.navigation.free_space import free_space_of
from hickory_stream.navigation.robot import load_robot
from hickory_stream.navigation.search import first_path
from tools.benchmarks.common.processes import ROOT

_PICTURE_PX = (1600, 800)
_TRIES = 20


@dataclass(frozen=True, kw_only=True, slots=True)
class Reading:
    """Seconds of processor time; `space_seconds` is the grid that the paths are planned in.

    `path_ms` is the median of `num_paths` that were found between places of the robot's way. Of the map as it was known
    at the middle of the run `known_records_seconds` and then `known_points_seconds` are until each object's record was
    read, and each object's points.
    """

    objects: int
    open_seconds: float
    known_at_seconds: float
    known_records_seconds: float
    known_points_seconds: float
    space_seconds: float
    path_ms: float | None
    num_paths: int
    render_seconds: float


def reading_of(folder: Path) -> Reading:
    """Return what reading a map takes, from a process of its own.

    Raises:
        RuntimeError: the child failed.
    """
    command = [sys.executable, "-m", "tools.benchmarks.scale.reading", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}: {done.stderr.splitlines()[-1:]}")
    return Reading(**json.loads(done.stdout))


def _measured(folder: Path) -> Reading:
    began = time.process_time()
    saved = open_map(folder)
    opened = time.process_time()
    with Journal(folder) as journal:
        steps = [journal.step(i) for i in range(len(journal))]
        places = [step.frames[-1].world_from_camera[:2, 3] for step in steps if step.frames]
        stamp_ns = journal.step(len(journal) // 2).stamp_ns
    looked = time.process_time()
    snapshot = saved.as_known_at(stamp_ns)
    known = time.process_time()
    for tracked in snapshot.objects:
        assert tracked.box is not None
    records_read = time.process_time()
    for tracked in snapshot.objects:
        assert len(tracked.points_world)
    points_read = time.process_time()
    space_seconds, found_ms = _paths(saved, places)
    rendered = time.process_time()
    render_map(saved, {1, 2}, _PICTURE_PX)
    return Reading(
        objects=len(saved.snapshot.objects),
        open_seconds=opened - began,
        known_at_seconds=known - looked,
        known_records_seconds=records_read - known,
        known_points_seconds=points_read - records_read,
        space_seconds=space_seconds,
        path_ms=float(np.median(found_ms)) if found_ms else None,
        num_paths=len(found_ms),
        render_seconds=time.process_time() - rendered,
    )


def _paths(saved: SavedMap, places: list[np.ndarray]) -> tuple[float, list[float]]:
    """Return the time of the grid, and of each path that was found between two places where the robot was."""
    began = time.process_time()
    # What a robot saw while it passed counts as free, so that it can be planned through.
    space = free_space_of(saved.snapshot, load_robot("point"), unknown="free")
    space_seconds = time.process_time() - began
    rng = np.random.default_rng(0)
    found_ms = []
    for i in range(_TRIES):
        a = int(rng.integers(len(places)))
        b = min(len(places) - 1, a + 40)
        started = time.process_time()
        # None where a person walked and the robot does not fit.
        path = first_path(space, places[a], places[b], np.random.default_rng(i))
        if path is not None and i:  # the first one loads kernels
            found_ms.append(1e3 * (time.process_time() - started))
    return space_seconds, found_ms


def main() -> None:
    """Measure, and print one line of JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("map", type=Path)
    print(dumps(asdict(_measured(parser.parse_args().map))))


if __name__ == "__main__":
    main()
