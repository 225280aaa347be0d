"""Path planning: a path from start to goal through free space, or the reason why there is none.

`rrt` is the paper's, `rrt-connect` (default) grows from both ends, `rrt-star` goes on from there to shorter paths. A
path is shortened over free cells, then every leg and turn is checked against the obstacles themselves.
"""

from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from typing import Literal, assert_never, get_args

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.ranges import Ranged, check_ranges, number
from hickory_stream.errors import InputError
from hickory_stream.geometry.arrays import freeze
from hickory_stream.navigation import tree_kernels
from hickory_stream.navigation.cell_route import route_over_cells
from hickory_stream.navigation.free_space import FreeSpace
from hickory_stream.navigation.occupancy import Cell
from hickory_stream.navigation.outline import outlines_of_hulls, outlines_of_rows
from hickory_stream.navigation.robot import Part
from hickory_stream.navigation.stand_ins import SEEN_SURFACE
from hickory_stream.navigation.verify import is_verified


@dataclass(frozen=True, kw_only=True, slots=True)
class Blocker:
    """An object, or the observed structure (`object_id` None), that a robot at a place would collide with."""

    object_id: int | None
    #: horizontally from the place to the obstacle at the robot's heights; 0 inside
    distance_m: float
    #: a provisional obstacle of a live run; `SEEN_SURFACE` belongs to no object yet
    is_observed_only: bool = False

    @property
    def text(self) -> str:
        """The obstacle and its distance, as text for people."""
        name = "a wall" if self.object_id is None else f"object {self.object_id}"
        if self.is_observed_only:
            name = "something seen" if self.object_id == SEEN_SURFACE else f"{name} (observed only)"
        return f"{name}, {self.distance_m:.2f} m away" if self.distance_m > 0 else f"{name}, which is there"


def blockers_at(space: FreeSpace, place: NDArray[np.float64]) -> tuple[Blocker, ...]:
    """Return the obstacles that a robot at (2,) collides with in some posture and heading, the nearest first."""
    ((row, column),) = space.frame.cells_of(place[None]).tolist()
    layers = space.all_layers()
    ids = sorted({object_id for layer in layers for object_id in layer.objects_at(row, column)})
    # For a body without width, as high as the robot, the configuration-space outlines are the obstacles' own.
    low_m, high_m = space.heights_m
    slim = Part(low_m=low_m, high_m=high_m)
    early = {*space.observed_only, SEEN_SURFACE}
    found = [
        Blocker(object_id=i, distance_m=_distance_m(place, *_outlines(space, i, slim)), is_observed_only=i in early)
        for i in ids
    ]
    if any(layer.is_wall_at(row, column) for layer in layers):
        apart_m = _distance_m(place, *outlines_of_hulls(space.walls, slim))
        found.append(Blocker(object_id=None, distance_m=apart_m))
    return tuple(sorted(found, key=lambda blocker: blocker.distance_m))


def _outlines(space: FreeSpace, object_id: int, part: Part) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    if object_id in space.hulls:
        return outlines_of_hulls(space.hulls[object_id], part)
    return outlines_of_rows(space.scene.rows(object_id), part)


def _distance_m(place: NDArray[np.float64], corners: NDArray[np.float64], starts: NDArray[np.int64]) -> float:
    import cv2

    here = (0.0, 0.0)
    inside_m = [
        # Relative to the place: single precision is enough there.
        cv2.pointPolygonTest((corners[first:last] - place).astype(np.float32)[:, None], here, measureDist=True)
        for first, last in pairwise(starts.tolist())
        if last > first
    ]
    return max(0.0, -max(inside_m, default=-np.inf))


Planner = Literal["rrt", "rrt-connect", "rrt-star"]
PLANNERS: tuple[str, ...] = get_args(Planner)
_FIRST_SAMPLES = 1500
_MOST_NAMED = 5
_SPACING_CELLS = 8.0
_MOST_PLACES = 70
_ROUNDS = 12
_STAR_STEP_CELLS = 24.0


@dataclass(frozen=True, kw_only=True, slots=True)
class SearchConfig(Ranged):
    """How to search.

    `step_cells` and `goal_bias` are as in the paper, whose RRT has 7,000 iterations; RRT-Connect takes longer steps,
    `connect_step_cells`. Up to `attempts` searches are made within the iterations, and the cheapest path is kept, since
    a single search may pass an obstacle on the wrong side. For a robot that need not turn the shortest route over the
    cells is a candidate, too. RRT* starts from the best of these and takes `star_iterations` more. `shortens`: whether
    paths are shortened.
    """

    planner: Planner = "rrt-connect"
    max_iterations: int = number(50_000, 1, 1_000_000_000, "iterations")
    step_cells: float = number(10.0, 0.1, 1e6, "cells")
    connect_step_cells: float = number(60.0, 0.1, 1e6, "cells")
    goal_bias: float = number(0.18, 0, 1, "probability")
    attempts: int = number(6, 1, 10_000, "searches")
    star_iterations: int = number(4000, 0, 1_000_000_000, "iterations")
    shortens: bool = True

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.planner not in PLANNERS:
            raise InputError(f"found the planner {self.planner!r}, expected one of {', '.join(PLANNERS)}")


class NoPathReason(StrEnum):
    """Why there is no path; `UNREACHABLE` and blocked ends are proven on the grid, `BUDGET` is inconclusive."""

    START_IN_COLLISION = "start-in-collision"
    START_UNKNOWN = "start-unknown"
    GOAL_IN_COLLISION = "goal-in-collision"
    GOAL_UNKNOWN = "goal-unknown"
    UNREACHABLE = "unreachable"
    BUDGET = "budget"


@dataclass(frozen=True, kw_only=True, slots=True)
class NoPath:
    """No path was found: an expected outcome. `blockers`: obstacles that start or goal collides with, nearest first."""

    reason: NoPathReason
    text: str
    num_iterations: int = 0
    blockers: tuple[Blocker, ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Path:
    """A path of straight legs; the robot turns on the spot between them."""

    #: (N, 2) in the world, metres
    points: NDArray[np.float64]
    #: (N - 1,) indices of the robot's postures
    postures: NDArray[np.int64]
    #: (N - 1,) of the legs, driven forwards or backwards; 0 for a round robot
    headings_rad: NDArray[np.float64]
    length_m: float
    cost_m: float
    num_iterations: int

    def __post_init__(self) -> None:
        freeze(self, "points", np.float64, (None, 2))
        freeze(self, "postures", np.int64, (len(self.points) - 1,))
        freeze(self, "headings_rad", np.float64, (len(self.points) - 1,))


def plan(
    space: FreeSpace,
    start: NDArray[np.float64],
    goal: NDArray[np.float64],
    config: SearchConfig | None = None,
    rng: np.random.Generator | None = None,
) -> Path | NoPath:
    """Return a verified path from start to goal, (2,) metres in the world, or why there is none; seed 0 without `rng`.

    Raises:
        InputError: start or goal is not finite, or outside of the map.
    """
    config = config or SearchConfig()
    rng = rng or np.random.default_rng(0)
    frame = space.frame
    ends = np.array([_place("start", start, space), _place("goal", goal, space)])
    refused = _refused(space, ends)
    if refused is not None:
        return refused
    cells = (ends - frame.origin_m) / frame.cell_m
    costs = np.array([posture.cost for posture in space.robot.postures])
    path, iterations = _searched(space, cells, config, costs, rng)
    if path is None:
        return NoPath(
            reason=NoPathReason.BUDGET,
            text=f"found no path within {iterations} iterations; there may be one",
            num_iterations=iterations,
        )
    none = tree_kernels.NO_STATE
    states, is_free = tree_kernels.states_along(space.blocked(), path, none, none)
    assert is_free
    points = frame.origin_m + path * frame.cell_m
    points[[0, -1]] = ends
    headings = space.robot.num_headings
    # Free cells are a proof already; this second check is independent of cells and counters.
    if not is_verified(space, points, states):
        raise AssertionError("a path over free cells meets an obstacle: the grid and the obstacles disagree")
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return Path(
        points=points,
        postures=states // headings,
        headings_rad=np.array(
            [
                _driven_heading(leg, int(s) % headings, headings)
                for leg, s in zip(np.diff(points, axis=0), states, strict=True)
            ]
        ),
        length_m=float(lengths.sum()),
        cost_m=float((lengths * costs[states // headings]).sum()),
        num_iterations=iterations,
    )


def refused_start(space: FreeSpace, start: NDArray[np.float64]) -> NoPath | None:
    """Return why no path begins at a place, (2,) metres, None if one may; raises InputError as `plan`."""
    place = _place("start", start, space)
    return _refused(space, np.array([place, place]))


def first_path(
    space: FreeSpace, start: NDArray[np.float64], goal: NDArray[np.float64], rng: np.random.Generator
) -> NDArray[np.float64] | None:
    """Return the (N, 2) points of a first path by RRT-Connect, without shortening; None if there is none."""
    if _refused(space, np.array([start, goal])) is not None:
        return None
    frame = space.frame
    cells = (np.array([start, goal]) - frame.origin_m) / frame.cell_m
    config = SearchConfig(attempts=1, shortens=False)
    found, _ = _searched(space, cells, config, np.ones(len(space.robot.postures)), rng)
    return None if found is None else frame.origin_m + found * frame.cell_m


def _place(name: str, place: NDArray[np.float64], space: FreeSpace) -> NDArray[np.float64]:
    point = np.asarray(place, dtype=np.float64)
    if point.shape != (2,) or not np.isfinite(point).all():
        raise InputError(f"found the {name} {np.asarray(place).tolist()}, expected two finite coordinates x, y")
    low, high = space.frame.origin_m, space.frame.high_m
    if not ((point >= low) & (point < high)).all():
        raise InputError(
            f"the {name} ({point[0]:g}, {point[1]:g}) is outside of the map, which reaches from "
            f"({low[0]:.2f}, {low[1]:.2f}) to ({high[0]:.2f}, {high[1]:.2f})"
        )
    return point


def _refused(space: FreeSpace, ends: NDArray[np.float64]) -> NoPath | None:
    labels = space.labels()
    pieces = []
    for name, (row, column), place in zip(("start", "goal"), space.frame.cells_of(ends), ends, strict=True):
        here = np.unique(labels[:, :, row, column])
        here = here[here > 0]
        if len(here) == 0:
            return _in_the_way(space, name, int(row), int(column), place)
        pieces.append(here)
    if np.isin(pieces[0], pieces[1]).any():
        return None
    return NoPath(
        reason=NoPathReason.UNREACHABLE,
        text=f"start and goal lie in different pieces of the free space: no path at cells of "
        f"{space.frame.cell_m:g} m and this robot's size",
    )


def _in_the_way(space: FreeSpace, name: str, row: int, column: int, place: NDArray[np.float64]) -> NoPath:
    states = {int(layer.states()[row, column]) for headings in space.layers for layer in headings}
    at = f"the {name} ({place[0]:g}, {place[1]:g})"
    if states == {int(Cell.OCCUPIED)}:
        reason = NoPathReason.START_IN_COLLISION if name == "start" else NoPathReason.GOAL_IN_COLLISION
        blockers = blockers_at(space, place)
        with_what = "; ".join(blocker.text for blocker in blockers[:_MOST_NAMED])
        more = f"; and {len(blockers) - _MOST_NAMED} more" if len(blockers) > _MOST_NAMED else ""
        text = f"{at} is in collision, in every posture and heading, with {with_what}{more}"
        return NoPath(reason=reason, text=text, blockers=blockers)
    reason = NoPathReason.START_UNKNOWN if name == "start" else NoPathReason.GOAL_UNKNOWN
    return NoPath(reason=reason, text=f"{at} reaches into space that was never seen; --unknown free would allow it")


def _searched(
    space: FreeSpace,
    cells: NDArray[np.float64],
    config: SearchConfig,
    costs: NDArray[np.float64],
    rng: np.random.Generator,
) -> tuple[NDArray[np.float64] | None, int]:
    none = tree_kernels.NO_STATE
    blocked = space.blocked()
    best: NDArray[np.float64] | None = None
    best_cost, iterations = np.inf, 0
    # In the first posture alone, then in the first two, ...: a path that ducks must not hide a detour that does not.
    for count in range(1, len(blocked) + 1) if config.shortens else (len(blocked),):
        allowed, is_last = blocked[:count], count == len(blocked)
        for _ in range(config.attempts):
            # A short run first: most paths are found early, and drawing samples costs more than using them.
            most = config.max_iterations - iterations
            budgets = (min(_FIRST_SAMPLES, most), most - _FIRST_SAMPLES) if is_last else (min(_FIRST_SAMPLES, most),)
            for budget in budgets:
                found, taken = _one(space, allowed, cells, config, budget, rng) if budget > 0 else (None, 0)
                iterations += taken
                if found is not None:
                    break
            if found is None:
                break
            if config.shortens:
                found = _tight(allowed, found, costs)
            states, _ = tree_kernels.states_along(allowed, found, none, none)
            cost = tree_kernels.cost_along(found, states, costs, blocked.shape[1])
            if cost < best_cost:
                best, best_cost = found, cost
            if len(found) == 2:
                break
    if config.shortens and best is not None and len(best) > 2 and blocked.shape[1] == 1:
        route = _routed(blocked, cells, costs)
        if route is not None:
            states, is_free = tree_kernels.states_along(blocked, route, none, none)
            cost = tree_kernels.cost_along(route, states, costs, 1)
            if is_free and cost < best_cost:
                best, best_cost = route, cost
    if config.planner == "rrt-star" and best is not None:
        samples, _ = _samples(space, cells, config.star_iterations, rng)
        found, taken = tree_kernels.grow_star(
            blocked, cells[0], cells[1], none, none, samples, costs, _STAR_STEP_CELLS, best_cost
        )
        iterations += taken
        if len(found):
            best = _tight(blocked, found, costs) if config.shortens else found
    return best, iterations


def _one(
    space: FreeSpace,
    blocked: NDArray[np.bool_],
    cells: NDArray[np.float64],
    config: SearchConfig,
    budget: int,
    rng: np.random.Generator,
) -> tuple[NDArray[np.float64] | None, int]:
    none = tree_kernels.NO_STATE
    samples, toss = _samples(space, cells, budget, rng)
    if config.planner == "rrt":
        found, iterations = tree_kernels.grow_rrt(
            blocked, cells[0], cells[1], none, none, samples, toss, config.step_cells, config.goal_bias
        )
    elif config.planner == "rrt-connect" or config.planner == "rrt-star":
        found, iterations = tree_kernels.grow_connect(
            blocked, cells[0], cells[1], none, none, samples, config.connect_step_cells
        )
    else:
        assert_never(config.planner)
    return (found if len(found) else None), int(iterations)


def _samples(
    space: FreeSpace, cells: NDArray[np.float64], count: int, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # (count, 2) points in cells, every other one in a narrow cell, and (count,) numbers in 0..1.
    everywhere, narrow = space.reachable_cells(cells[0])
    drawn = rng.random((count, 4))
    chosen = everywhere[(drawn[:, 0] * len(everywhere)).astype(np.int64)]
    if len(narrow):
        chosen[::2] = narrow[(drawn[::2, 0] * len(narrow)).astype(np.int64)]
    return chosen[:, ::-1] + drawn[:, 1:3], drawn[:, 3]


def _tight(blocked: NDArray[np.bool_], path: NDArray[np.float64], costs: NDArray[np.float64]) -> NDArray[np.float64]:
    none = tree_kernels.NO_STATE
    shorter = tree_kernels.shortened(blocked, path, none, none, costs, _SPACING_CELLS, _MOST_PLACES)
    pulled = tree_kernels.cut_corners(blocked, shorter, none, none, costs, _ROUNDS, _MOST_PLACES)
    return np.asarray(pulled)


def _routed(
    blocked: NDArray[np.bool_], cells: NDArray[np.float64], costs: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    cheapest = np.where(blocked[:, 0], np.inf, costs[:, None, None]).min(axis=0)
    (column, row), (goal_column, goal_row) = np.floor(cells).astype(np.int64).tolist()
    route = route_over_cells(cheapest, row, column, goal_row, goal_column)
    if len(route) == 0:
        return None
    none = tree_kernels.NO_STATE
    whole = np.concatenate([cells[:1], route, cells[1:]])
    return _tight(blocked, tree_kernels.thinned(blocked, whole, none), costs)


def _driven_heading(leg: NDArray[np.float64], index: int, num_headings: int) -> float:
    if num_headings == 1:
        return 0.0
    along = float(np.arctan2(leg[1], leg[0]))
    middle = 2 * np.pi * index / num_headings
    return along if np.cos(along - middle) > 0 else float(np.arctan2(-leg[1], -leg[0]))
