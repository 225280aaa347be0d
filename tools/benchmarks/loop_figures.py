"""Loops through rooms that look alike: how many there are that are found, and how many wrong ones are believed."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.engine.loop_closing import MIN_SUBMAPS_APART
from hickory_stream.graph.config import GraphConfig
from hickory_stream.graph.factors import odometry_covariance
from hickory_stream.graph.solution import NoSolution, Solution
from hickory_stream.graph.solve import solve
from hickory_stream.loops.config import LoopConfig
from hickory_stream.loops.pose_graph import pose_graph
from hickory_stream.loops.predictions import predictions
from hickory_stream.loops.search import LoopQuery, search_loops
from hickory_stream.loops.surfaces import Surfaces
from hickory_stream.records import SurveyedSubmap
from tools.benchmarks.figures import Figure
from tools.benchmarks.loop_rooms import walk

if TYPE_CHECKING:
    from hickory_stream.records import Loop
    from tools.benchmarks.figures import Options
    from tools.benchmarks.loop_rooms import SeenRoom

_WRONG_M, _WRONG_RAD = 0.3, 0.1
_TURN_RAD = 3.0


def loop_figures(options: Options) -> list[Figure]:
    """Return the figures of 200 seeded walks: half come back to a room, half go into a further one that is alike."""
    num_walks = 8 if options.quick else 200
    offered = found = wrong = believed = 0
    seconds: list[float] = []
    for seed in range(num_walks):
        rng = np.random.default_rng((options.seed, seed))
        returns, differs = seed % 2 == 0, seed % 4 < 2
        covariance = odometry_covariance(5.0, _TURN_RAD, GraphConfig())
        sigma_m, sigma_rad = float(np.sqrt(covariance[3, 3])), float(np.sqrt(covariance[2, 2]))
        rooms = walk(rng, sigma_m=sigma_m, sigma_rad=sigma_rad, returns=returns, differs=differs)
        started = time.process_time()
        loops, accepted = _closed(rooms)
        seconds.append(time.process_time() - started)
        right = [_is_right(loops[i], rooms) for i in accepted]
        believed += len(right)
        wrong += right.count(False)
        offered += returns
        found += returns and any(right)
    return [
        Figure(name="wrong_loops", value=wrong, unit="", better="lower",
               of=f"{wrong} of {believed} believed, in {num_walks} walks through rooms that look alike"),
        Figure(name="loops_found_fraction", value=found / offered, unit="", better="higher",
               of=f"{found} of {offered} walks that come back"),
        Figure(name="loop_search_s", value=float(np.mean(seconds)), unit="s", better="lower",
               of="processor time of a search, mean"),
    ]  # fmt: skip


def _closed(rooms: list[SeenRoom]) -> tuple[tuple[Loop, ...], tuple[int, ...]]:
    """Search the last submap in the others and solve the graph; return the loops, and the numbers of those believed."""
    config, later = GraphConfig(), len(rooms) - 1
    submaps = [_surveyed(i, room) for i, room in enumerate(rooms)]
    stamps = list(range(len(rooms)))
    predicted = predictions(submaps, (), config, least_apart=MIN_SUBMAPS_APART)
    assert not isinstance(predicted, NoSolution)
    query = LoopQuery(later_id=later, surfaces=Surfaces(submaps), predicted=predicted)
    loops = search_loops(query, LoopConfig())
    solution = solve(pose_graph(submaps, loops, stamps, config), config)
    return loops, solution.accepted if isinstance(solution, Solution) else ()


def _is_right(loop: Loop, rooms: list[SeenRoom]) -> bool:
    earlier, later = rooms[loop.earlier], rooms[loop.later]
    true = earlier.odometry_from_world @ np.linalg.inv(later.odometry_from_world)
    step = np.linalg.inv(true @ later.anchor) @ (loop.earlier_from_later @ later.anchor)
    turn_rad = float(np.arccos(np.clip((np.trace(step[:3, :3]) - 1) / 2, -1, 1)))
    return earlier.room == later.room and float(np.linalg.norm(step[:3, 3])) < _WRONG_M and turn_rad < _WRONG_RAD


def _surveyed(submap_id: int, room: SeenRoom) -> SurveyedSubmap:
    return SurveyedSubmap(
        id=submap_id,
        world_from_submap=np.eye(4),
        anchor=room.anchor,
        way_m=room.way_m,
        turn_rad=_TURN_RAD,
        after_jump=False,
        points=room.points.astype(np.float32),
        normals=room.normals.astype(np.float32),
        free=np.empty(0, np.int64),
        voxel_m=0.05,
    )
