"""A superquadric from points alone: what is known of an object's shape before it has a mesh.

The points lie on a surface of which a part was seen. Where a superquadric ends along its axes is read off the points;
left are the frame, which axis is the third, and the two exponents. These are few enough to try them all: upright or
along the principal axes, boxes, cylinders, ellipsoids and what lies between.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.compiled import numba
from hickory_stream.geometry import portable
from hickory_stream.geometry.canonical import canonical
from hickory_stream.geometry.portable_kernels import exp, logaddexp
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.geometry.superquadric import Superquadrics, unit_volumes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.geometry.boxes import OrientedBox

_MIN_POINTS = 20
_MAX_POINTS = 250
_EXPONENTS = (0.1, 0.3, 0.6, 1.0)
_ORDERS = tuple(np.roll(np.eye(3), shift, axis=1) for shift in range(3))
# An upright shape is given up only for one that is clearly better.
_CLEARLY = 0.9


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Trial:
    """One primitive and its cost."""

    cost: float
    exponents: tuple[float, float]
    semi_axes_m: NDArray[np.float64]
    pose: NDArray[np.float64]


def sketch(points_world: NDArray[Any], box: OrientedBox) -> Superquadrics | None:
    """Return one superquadric for (N, 3) surface points and the upright box that stands around most of them.

    Chosen is what has the least product of mean radial distance to the points and cube root of its volume, as in
    Solina and Bajcsy (1990). Semi-axes are at least the box's smallest half extent, so that a flat or straight cloud
    has a sketch, too; fewer than 20 finite points in the box have none.
    """
    points = np.asarray(points_world, dtype=np.float64).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    points = points[box.contains(points, 1e-6)]
    if len(points) < _MIN_POINTS:
        return None
    points = points[np.linspace(0, len(points) - 1, min(len(points), _MAX_POINTS)).astype(np.int64)]
    thinnest = float(box.half_extents_m.min())
    upright = _best(points, box.world_from_box[:3, :3], box.center, box.half_extents_m)
    axes = _principal_axes(points)
    local = portable.matmul(points, axes)
    low, high = local.min(axis=0), local.max(axis=0)
    center = portable.matmul(axes, (low + high) / 2)
    leaning = _best(points, axes, center, np.maximum((high - low) / 2, thinnest))
    chosen = leaning if leaning.cost < _CLEARLY * upright.cost else upright
    return canonical(_as_superquadrics(chosen.exponents, chosen.semi_axes_m, chosen.pose))


def _best(
    points: NDArray[np.float64], axes: NDArray[np.float64], center: NDArray[np.float64], half: NDArray[np.float64]
) -> _Trial:
    """Return the best primitive that just fits into a box: its axes (3, 3) as columns, its centre, its half extents."""
    offsets = points - center
    lengths = np.linalg.norm(offsets, axis=1)
    logs = portable.log(np.maximum(np.abs(portable.matmul(offsets, axes)) / half, 1e-9))
    semi_axes_m = [portable.matmul(half, order) for order in _ORDERS]
    sizes = np.concatenate([portable.cbrt(_unit_volumes() * own.prod()) for own in semi_axes_m])
    trials, distances = _distances(logs, lengths, np.array(_EXPONENTS), sizes)
    costs = distances.mean(axis=1) * sizes[trials]
    best = int(np.argmin(costs))
    turn, of_e2, of_e1 = np.unravel_index(trials[best], (len(_ORDERS), len(_EXPONENTS), len(_EXPONENTS)))
    return _Trial(
        cost=float(costs[best]),
        exponents=(_EXPONENTS[of_e1], _EXPONENTS[of_e2]),
        semi_axes_m=semi_axes_m[turn],
        pose=from_rotation_translation(portable.matmul(axes, _ORDERS[turn]), center),
    )


@cache
def _unit_volumes() -> NDArray[np.float64]:
    """Return the volumes of primitives with semi-axes of 1, by e2, then by e1."""
    return unit_volumes(np.array([(e1, e2) for e2 in _EXPONENTS for e1 in _EXPONENTS]))


@numba.njit(cache=True, nogil=True)
def _distances(logs, lengths, exponents, sizes):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return the numbers of the trials that may be best, ascending, and (M, N) how far each point is from them.

    Trials are numbered by the order of the axes, e2 and e1. `logs` (N, 3) are of the points along the axes, in shares
    of the half extents. A trial that costs more by some of the points than another one by all of them is given up.
    """
    count, kinds = len(lengths), len(exponents)
    trials = np.empty(3 * kinds * kinds, dtype=np.int64)
    distances = np.empty((len(trials), count))
    log_rho = np.empty(count)
    tried, least = 0, np.inf
    for shift in range(3):
        # As the columns of the orders, which are turned by as many.
        x, y, z = -shift % 3, (1 - shift) % 3, (2 - shift) % 3
        for j in range(kinds):
            e2 = exponents[j]
            for i in range(count):
                log_rho[i] = e2 / 2 * logaddexp(2 / e2 * logs[i, x], 2 / e2 * logs[i, y])
            for k in range(kinds):
                e1 = exponents[k]
                trial = (shift * kinds + j) * kinds + k
                # Beyond what the order of summation can make of it.
                limit = 1.001 * least * count
                total = 0.0
                for i in range(count):
                    log_gauge = e1 / 2 * logaddexp(2 / e1 * log_rho[i], 2 / e1 * logs[i, z])
                    distances[tried, i] = abs(lengths[i] * (1 - exp(-log_gauge)))
                    total += distances[tried, i] * sizes[trial]
                    if total > limit:
                        break
                if total <= limit:
                    trials[tried] = trial
                    tried += 1
                    least = min(least, total / count)
    return trials[:tried], distances[:tried]


def _principal_axes(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (3, 3) right-handed columns."""
    centered = points - points.mean(axis=0)
    _, axes = portable.eigh(portable.matmul(centered.T, centered))
    return np.asarray(axes * np.array([np.sign(portable.det3(axes)), 1.0, 1.0]))


def _as_superquadrics(
    exponents: tuple[float, float], semi_axes_m: NDArray[np.float64], pose: NDArray[np.float64]
) -> Superquadrics:
    return Superquadrics(exponents=np.array([exponents]), semi_axes_m=semi_axes_m[None], world_from_local=pose[None])
