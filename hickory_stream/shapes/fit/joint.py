"""Joint refinement of all primitives of an object, and rounding of their exponents to simple shapes.

The distance to a union is the least to its parts: every sample belongs to one primitive, and normal equations are block
diagonal. A sweep updates the primitives in turn and accepts a step only if the union fits better. The grid hardly
constrains exponents (0.1 or 0.2 for a box): simple shapes are kept if they fit nearly as well, so fits repeat.
"""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable
from hickory_stream.geometry.portable_kernels import exp_each
from hickory_stream.shapes.fit.quadric_lm import OUTER_BAND, ROW, cut_distances, new_workspace, normal_step
from hickory_stream.shapes.fit.thinning import thinned

# The exponents of the simple shapes, and the number of distinct cyclic orders of their axes: one for a box.
_SIMPLE = ((0.1, 0.1, 1), (1.0, 1.0, 1), (0.1, 1.0, 3), (2.0, 1.0, 3))
_FINALISTS = 3
# The cyclic orders of the axes.
_TURNS = np.array([[0, 1, 2], [2, 0, 1], [1, 2, 0]])


def jointly_refined(
    rows: NDArray[np.float64],
    points: NDArray[np.float64],
    distances: NDArray[np.float64],
    *,
    band: float,
    sweeps: int,
    max_log_axis: float,
    with_exponents: bool = True,
) -> NDArray[np.float64]:
    """Return the (K, 17) rows that fit (N,) signed distances at (N, 3) points best as a union, in units of cells."""
    targets = np.clip(distances, -band, OUTER_BAND)
    rows, workspace = rows.copy(), new_workspace(len(points))
    found = [cut_distances(row, points, band) for row in rows]
    damping, resting = [1e-3] * len(rows), [0] * len(rows)
    for _ in range(sweeps):
        for k in range(len(rows)):
            if resting[k] > 1:
                continue
            others = np.full(len(points), OUTER_BAND)
            for other in found[:k] + found[k + 1 :]:
                np.minimum(others, other, out=others)
            row, again = np.empty(ROW), np.empty(len(points))
            gain, damping[k] = normal_step(
                rows[k], points, targets, others, found[k], band, damping[k], 0 if with_exponents else 2, max_log_axis,
                row, again, *workspace,
            )  # fmt: skip
            if gain > 0.0:
                rows[k], found[k] = row, again
            resting[k] = 0 if gain > 1e-3 else resting[k] + 1
    return rows


def refined_beside(
    row: NDArray[np.float64],
    others: NDArray[np.float64],
    points: NDArray[np.float64],
    distances: NDArray[np.float64],
    *,
    band: float,
    steps: int,
    max_log_axis: float,
    max_samples: int,
) -> NDArray[np.float64]:
    """Return the (17,) row refined with the (K, 17) `others` held fixed, on about `max_samples` samples around it."""
    near = _near(row, points, band)
    if len(near) < 30:
        return row
    near = near[thinned(len(near), max_samples)]
    own, goal = points[near], np.clip(distances[near], -band, OUTER_BAND)
    beside = _union(others, own, band)
    return _stepped_beside(row, own, goal, beside, band, steps, max_log_axis, num_held=0)[0]


def simplified(
    rows: NDArray[np.float64],
    points: NDArray[np.float64],
    distances: NDArray[np.float64],
    *,
    band: float,
    sweeps: int,
    max_log_axis: float,
    tolerance: float,
    per_primitive: int,
) -> NDArray[np.float64]:
    """Return the rows with simple exponents where these raise a primitive's misfit by no more than `tolerance` cells.

    Each primitive is judged on about `per_primitive` of the samples around it.
    """
    targets = np.clip(distances, -band, OUTER_BAND)
    rows = rows.copy()
    for k in range(len(rows)):
        near = _near(rows[k], points, band)
        if len(near) < 30:
            continue
        near = near[thinned(len(near), per_primitive)]
        own, goal = points[near], targets[near]
        beside = np.delete(rows, k, axis=0)
        others = _union(beside, own, band)
        before = _misfit(np.minimum(others, cut_distances(rows[k], own, band)), goal)
        best, least = rows[k], before + tolerance
        # A few steps show which shapes are promising; only these are fitted to convergence.
        tried = [
            _stepped_beside(row, own, goal, others, band, 2, max_log_axis, num_held=2) for row in _simple_rows(rows[k])
        ]
        for first, _ in sorted(tried, key=lambda one: one[1])[:_FINALISTS]:
            trial, misfit = _stepped_beside(first, own, goal, others, band, sweeps - 2, max_log_axis, num_held=2)
            # A primitive that moves outside of the samples around it cannot be judged.
            if misfit < least and _stays(trial, rows[k]):
                best, least = trial, misfit
        rows[k] = best
    return rows


def _simple_rows(row: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    rows = []
    for e1, e2, turns in _SIMPLE:
        for turn in range(turns):
            trial = _turned(row, turn)
            trial[:2] = e1, e2
            rows.append(trial)
    return rows


def _stays(row: NDArray[np.float64], before: NDArray[np.float64]) -> bool:
    # Within two cells.
    reach = portable.matmul(np.abs(row[8:17].reshape(3, 3)), exp_each(row[2:5]))
    room = portable.matmul(np.abs(before[8:17].reshape(3, 3)), exp_each(before[2:5])) + 2.0
    return bool((np.abs(row[5:8] - before[5:8]) + reach <= 1.1 * room).all())


def _turned(row: NDArray[np.float64], turn: int) -> NDArray[np.float64]:
    # The same box, another axis for a cylinder.
    out = row.copy()
    order = _TURNS[turn]
    out[2:5] = row[2:5][order]
    out[8:17] = row[8:17].reshape(3, 3)[:, order].ravel()
    return out


def _near(row: NDArray[np.float64], points: NDArray[np.float64], band: float) -> NDArray[np.int64]:
    out = np.empty(len(points), np.bool_)
    _mark_near(row, points, *(exp_each(row[2:5]) + band + 1.0).tolist(), out)
    return np.flatnonzero(out)


@kernel
def _mark_near(row, points, reach_x, reach_y, reach_z, out):
    for n in range(len(points)):
        dx, dy, dz = points[n, 0] - row[5], points[n, 1] - row[6], points[n, 2] - row[7]
        out[n] = (
            abs(row[8] * dx + row[11] * dy + row[14] * dz) < reach_x
            and abs(row[9] * dx + row[12] * dy + row[15] * dz) < reach_y
            and abs(row[10] * dx + row[13] * dy + row[16] * dz) < reach_z
        )


def _union(rows: NDArray[np.float64], points: NDArray[np.float64], band: float) -> NDArray[np.float64]:
    out = np.full(len(points), OUTER_BAND)
    for row in rows:
        np.minimum(out, cut_distances(row, points, band), out=out)
    return out


def _misfit(found: NDArray[np.float64], targets: NDArray[np.float64]) -> float:
    off = found - targets
    return float(np.sqrt(portable.dot(off, off) / max(len(off), 1)))


def _stepped_beside(
    row: NDArray[np.float64],
    points: NDArray[np.float64],
    targets: NDArray[np.float64],
    others: NDArray[np.float64],
    band: float,
    steps: int,
    max_log_axis: float,
    *,
    num_held: int,
) -> tuple[NDArray[np.float64], float]:
    # The row after some steps, and its misfit.
    damping, workspace = 1e-3, new_workspace(len(points))
    found = cut_distances(row, points, band)
    for _ in range(steps):
        trial, again = np.empty(ROW), np.empty(len(points))
        gain, damping = normal_step(
            row, points, targets, others, found, band, damping, num_held, max_log_axis, trial, again, *workspace
        )
        if gain > 0.0:
            row, found = trial, again
        if gain < 1e-3:
            break
    return row, _misfit(np.minimum(others, found), targets)
