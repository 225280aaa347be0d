"""Times of readers of a large map, in a process of its own: opening, looking back, a path, a picture."""
# Processor time; the first path, which loads kernels, is not counted. Opening and the picture do count loading.

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hickory_stream.journal.reader import Journal
from hickory_stream.map_folder.saved_map import SavedMap, open_map
from hickory_stream.navigation.free_space import free_space_of
from hickory_stream.navigation.robot import load_robot
from hickory_stream.navigation.search import first_path
from hickory_stream.pictures.render import render_map
from tools.benchmarks.common.processes import in_child

_PICTURE_PX = (1600, 800)
_TRIES = 20


@dataclass(frozen=True, kw_only=True, slots=True)
class Reading:
    """Seconds of processor time; `space_seconds` is the grid that the paths are planned in."""

    # `path_ms`: median of `num_paths`. `known_...`: until records, then points, of the map at the middle of the run
    # were read.

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
    found: Reading = in_child(_measured, folder)
    return found


def _measured(folder: Path) -> Reading:
    marks = [time.process_time()]
    saved = open_map(folder)
    marks.append(time.process_time())
    with Journal(folder) as journal:
        steps = [journal.step(i) for i in range(len(journal))]
        places = [step.frames[-1].world_from_camera[:2, 3] for step in steps if step.frames]
        stamp_ns = steps[len(steps) // 2].stamp_ns
    marks.append(time.process_time())
    snapshot = saved.as_known_at(stamp_ns)
    marks.append(time.process_time())
    assert all(tracked.box is not None for tracked in snapshot.objects)
    marks.append(time.process_time())
    assert all(len(tracked.points_world) for tracked in snapshot.objects)
    marks.append(time.process_time())
    opened, _, known_at, records, points = np.diff(marks).tolist()
    space_seconds, found_ms = _paths(saved, places)
    began = time.process_time()
    render_map(saved, {1, 2}, _PICTURE_PX)
    return Reading(
        objects=len(saved.snapshot.objects), open_seconds=opened, known_at_seconds=known_at,
        known_records_seconds=records, known_points_seconds=points, space_seconds=space_seconds,
        path_ms=float(np.median(found_ms)) if found_ms else None, num_paths=len(found_ms),
        render_seconds=time.process_time() - began,
    )  # fmt: skip


def _paths(saved: SavedMap, places: list[np.ndarray]) -> tuple[float, list[float]]:
    began = time.process_time()
    # Space that a robot saw while it passed counts as free, so that it can be planned through.
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
