"""Joint refinement of all primitives of an object, and rounding of their exponents to simple shapes.

The distance to a union is the least to its parts: every sample belongs to one primitive, and normal equations are block
diagonal. A sweep updates the primitives in turn and accepts a step only if the union fits better. The grid hardly
constrains exponents (0.1 or 0.2 for a box): simple shapes are kept if they fit nearly as well, so fits repeat.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable
from hickory_stream.geometry.portable_kernels import exp_each
from hickory_stream.shapes.fit.quadric_lm import OUTER_BAND, cut_distances, normal_step
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
    return np.asarray(_swept(rows, points, targets, band, sweeps, max_log_axis, with_exponents))


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
    near = np.flatnonzero(_near(row, points, band))
    if len(near) < 30:
        return row
    near = near[thinned(len(near), max_samples)]
    own, goal = points[near], np.clip(distances[near], -band, OUTER_BAND)
    beside = _union(others, own, band)
    return np.asarray(_stepped_beside(row, own, goal, beside, band, steps, max_log_axis, True)[0])


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
        near = np.flatnonzero(_near(rows[k], points, band))
        if len(near) < 30:
            continue
        near = near[thinned(len(near), per_primitive)]
        own, goal = points[near], targets[near]
        beside = np.delete(rows, k, axis=0)
        others = _union(beside, own, band)
        before = _misfit(np.minimum(others, cut_distances(rows[k], own, band)), goal, band)
        best, least = rows[k], before + tolerance
        # A few steps show which shapes are promising; only these are fitted to convergence.
        tried = [_stepped_beside(row, own, goal, others, band, 2, max_log_axis, False) for row in _simple_rows(rows[k])]
        for first, _ in sorted(tried, key=lambda one: float(one[1]))[:_FINALISTS]:
            trial, misfit = _stepped_beside(first, own, goal, others, band, sweeps - 2, max_log_axis, False)
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


@kernel
def _near(row, points, band):
    out = np.empty(len(points), np.bool_)
    reach = exp_each(row[2:5]) + band + 1.0
    for n in range(len(points)):
        dx, dy, dz = points[n, 0] - row[5], points[n, 1] - row[6], points[n, 2] - row[7]
        out[n] = (
            abs(row[8] * dx + row[11] * dy + row[14] * dz) < reach[0]
            and abs(row[9] * dx + row[12] * dy + row[15] * dz) < reach[1]
            and abs(row[10] * dx + row[13] * dy + row[16] * dz) < reach[2]
        )
    return out


@kernel
def _union(rows, points, band):
    out = np.full(len(points), OUTER_BAND)
    for k in range(len(rows)):
        out = np.minimum(out, cut_distances(rows[k], points, band))
    return out


@kernel
def _misfit(found, targets, band):
    total = 0.0
    for n in range(len(found)):
        r = found[n] - targets[n]
        total += r * r
    return np.sqrt(total / max(len(found), 1))


@kernel
def _swept(rows, points, targets, band, sweeps, max_log_axis, with_exponents):
    rows = rows.copy()
    count = len(rows)
    distances = np.empty((count, len(points)))
    for k in range(count):
        distances[k] = cut_distances(rows[k], points, band)
    damping = np.full(count, 1e-3)
    resting = np.zeros(count, np.int64)
    others = np.empty(len(points))
    for _ in range(sweeps):
        for k in range(count):
            if resting[k] > 1:
                continue
            others[:] = OUTER_BAND
            for j in range(count):
                if j != k:
                    for n in range(len(points)):
                        others[n] = min(others[n], distances[j, n])
            row, found, gain = normal_step(
                rows[k], points, targets, others, distances[k], band, damping, k, max_log_axis, with_exponents
            )
            if gain > 0.0:
                rows[k] = row
                distances[k] = found
            resting[k] = 0 if gain > 1e-3 else resting[k] + 1
    return rows


@kernel
def _stepped_beside(row, points, targets, others, band, steps, max_log_axis, with_exponents):
    damping = np.full(1, 1e-3)
    found = cut_distances(row, points, band)
    for _ in range(steps):
        row, found, gain = normal_step(
            row, points, targets, others, found, band, damping, 0, max_log_axis, with_exponents
        )
        if gain < 1e-3:
            break
    return row, _misfit(np.minimum(others, found), targets, band)
