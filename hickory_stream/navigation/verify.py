"""Verification of a path against the obstacles themselves, without a grid: every leg and every turn.

A straight motion collides with a convex obstacle if the reference point passes through the configuration-space
obstacle: an intersection of half planes, by each of which the segment is clipped. A free answer is a proof.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.navigation.free_space import FreeSpace
from hickory_stream.navigation.outline import NO_HULLS, NO_ROWS, TOLERANCE_M, half_planes, locked
from hickory_stream.navigation.robot import Part, grown


def is_verified(space: FreeSpace, points: NDArray[np.float64], states: NDArray[np.int64]) -> bool:
    """Return whether a robot can drive the segments between (N, 2) points in N - 1 states, and turn between them."""
    rows = locked(space.scene.rows())
    for part, start, end in _moves(space, points, states):
        off = grown(part, space.hull_margin_m)
        if _meets(rows, NO_HULLS, part.numbers, part.corners_m, start, end, TOLERANCE_M):
            return False
        low, high = np.minimum(start, end) - off.reach_m, np.maximum(start, end) + off.reach_m
        for group in space.hull_groups():
            # Neighbours in the list are neighbours in space, so that most groups are skipped as a whole.
            if (group.low > high).any() or (group.high < low).any():
                continue
            near = ((group.lows <= high) & (group.highs >= low)).all(axis=1)
            if _meets(NO_ROWS, locked(group.hulls[near]), off.numbers, off.corners_m, start, end, TOLERANCE_M):
                return False
    return True


def _moves(
    space: FreeSpace, points: NDArray[np.float64], states: NDArray[np.int64]
) -> Iterator[tuple[Part, NDArray[np.float64], NDArray[np.float64]]]:
    headings = space.robot.num_headings
    before = None
    for start, end, state in zip(points[:-1], points[1:], states.tolist(), strict=True):
        posture, heading = divmod(state, headings)
        if before is not None and before % headings != heading:
            for part in _turn(space, start, before, state):
                yield part, start, start
        for part in space.parts[posture][heading]:
            yield part, start, end
        before = state


def _turn(space: FreeSpace, place: NDArray[np.float64], before: int, after: int) -> list[Part]:
    # For the first of four variants with free cells.
    headings = space.robot.num_headings
    ((row, column),) = space.frame.cells_of(place[None])
    blocked = space.blocked()[:, :, row, column]
    for posture in (before // headings, after // headings):
        for way in (1, -1):
            passed = [before % headings]
            while passed[-1] != after % headings:
                passed.append((passed[-1] + way) % headings)
            if not blocked[posture, passed].any():
                return [part for k in passed for part in space.parts[posture][k]]
    raise AssertionError("a path turns at cells that are not free")


@kernel
def _meets(rows, hulls, part, corners, start, end, tolerance):
    is_hull = len(hulls) > 0
    no_row, no_hull = np.empty(0), np.empty((0, 3))
    found, after = np.empty((96, 6)), np.empty(96, np.int64)
    reach = part[2] + part[3] + np.sqrt((corners**2).sum(axis=1).max())
    for i in range(len(hulls) if is_hull else len(rows)):
        row = no_row if is_hull else rows[i]
        hull = hulls[i] if is_hull else no_hull
        is_far = False
        for axis in range(2):
            low = hull[:, axis].min() if is_hull else row[19 + axis]
            high = hull[:, axis].max() if is_hull else row[22 + axis]
            if max(start[axis], end[axis]) + reach < low or min(start[axis], end[axis]) - reach > high:
                is_far = True
        if is_far:
            continue
        count = half_planes(is_hull, row, hull, part, corners, tolerance, found, after)
        if count == 0:
            continue
        first, last = 0.0, 1.0
        for k in range(count):
            ahead = found[k, 0] * start[0] + found[k, 1] * start[1] - found[k, 2]
            speed = found[k, 0] * (end[0] - start[0]) + found[k, 1] * (end[1] - start[1])
            # Within the half plane: ahead + t * speed <= 0.
            if speed == 0.0:
                if ahead > 0.0:
                    first = 2.0
            elif speed > 0.0:
                last = min(last, -ahead / speed)
            else:
                first = max(first, -ahead / speed)
        if first <= last:
            return True
    return False
