"""Loops through rooms that look alike: how many of them are found, and how many wrong ones are accepted."""

import time

import numpy as np
from numpy.typing import NDArray

from hickory_stream.engine.loop_closing import MIN_SUBMAPS_APART
from hickory_stream.geometry.rigid import invert, rotation_angle_rad
from hickory_stream.graph.config import GraphConfig
from hickory_stream.graph.factors import odometry_covariance
from hickory_stream.graph.solution import NoSolution, Solution
from hickory_stream.graph.solve import solve
from hickory_stream.loops.config import LoopConfig
from hickory_stream.loops.pose_graph import pose_graph
from hickory_stream.loops.predictions import predictions
from hickory_stream.loops.search import LoopQuery, search_loops
from hickory_stream.loops.surfaces import Surfaces
from hickory_stream.records import Loop, SurveyedSubmap
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.evaluation.simulated_maps.loop_rooms import SeenRoom, walk

_WRONG_M, _WRONG_RAD = 0.3, 0.1
_TURN_RAD = 3.0


def loop_figures(options: Options) -> list[Figure]:
    """Return the figures of 200 seeded walks: half come back to a room, half go into a further one that is alike."""
    num_walks = 8 if options.quick else 200
    covariance = odometry_covariance(5.0, _TURN_RAD, GraphConfig())
    sigma_m, sigma_rad = float(np.sqrt(covariance[3, 3])), float(np.sqrt(covariance[2, 2]))
    offered = found = wrong = accepted = 0
    seconds: list[float] = []
    for seed in range(num_walks):
        rng = np.random.default_rng((options.seed, seed))
        returns, differs = seed % 2 == 0, seed % 4 < 2
        rooms = walk(rng, sigma_m=sigma_m, sigma_rad=sigma_rad, returns=returns, differs=differs)
        started = time.process_time()
        loops = _accepted(rooms)
        seconds.append(time.process_time() - started)
        right = [_is_right(loop, rooms) for loop in loops]
        accepted += len(right)
        wrong += right.count(False)
        offered += returns
        found += returns and any(right)
    of_wrong = f"{wrong} of {accepted} believed, in {num_walks} walks through rooms that look alike"
    of_found = f"{found} of {offered} walks that come back"
    return [
        figure("wrong_loops", wrong, "", "lower", of_wrong),
        figure("loops_found_fraction", found / offered, "", "higher", of_found),
        figure("loop_search_s", np.mean(seconds), "s", "lower", "processor time of a search, mean"),
    ]


def _accepted(rooms: list[SeenRoom]) -> list[Loop]:
    config, later = GraphConfig(), len(rooms) - 1
    submaps = [_surveyed(i, room) for i, room in enumerate(rooms)]
    predicted = predictions(submaps, (), config, least_apart=MIN_SUBMAPS_APART)
    assert not isinstance(predicted, NoSolution)
    loops = search_loops(LoopQuery(later_id=later, surfaces=Surfaces(submaps), predicted=predicted), LoopConfig())
    solution = solve(pose_graph(submaps, loops, list(range(len(rooms))), config), config)
    return [loops[i] for i in solution.accepted] if isinstance(solution, Solution) else []


def _is_right(loop: Loop, rooms: list[SeenRoom]) -> bool:
    earlier, later = rooms[loop.earlier], rooms[loop.later]
    true = earlier.odometry_from_world @ invert(later.odometry_from_world)
    step = invert(true @ later.anchor) @ (loop.earlier_from_later @ later.anchor)
    return earlier.room == later.room and is_near(step)


def is_near(step: NDArray[np.float64]) -> bool:
    return float(np.linalg.norm(step[:3, 3])) < _WRONG_M and rotation_angle_rad(step[:3, :3]) < _WRONG_RAD


def _surveyed(submap_id: int, room: SeenRoom) -> SurveyedSubmap:
    return SurveyedSubmap(
        id=submap_id, world_from_submap=np.eye(4), anchor=room.anchor, way_m=room.way_m, turn_rad=_TURN_RAD,
        after_jump=False, points=room.points.astype(np.float32), normals=room.normals.astype(np.float32),
        free=np.empty(0, np.int64), voxel_m=0.05,
    )  # fmt: skip
