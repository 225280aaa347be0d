"""A superquadric fitted to points alone: an object's provisional shape before it has a mesh.

The points give the ends along the axes. The frame (upright or principal axes), the third axis and two exponents are few
enough to try them all: boxes, cylinders, ellipsoids and shapes between.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable
from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.geometry.portable_kernels import exp, log1p
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.geometry.superquadric import Superquadrics, canonical, unit_volumes

_MIN_POINTS = 20
_MAX_POINTS = 250
_EXPONENTS = (0.1, 0.3, 0.6, 1.0)
_ORDERS = tuple(np.roll(np.eye(3), shift, axis=1) for shift in range(3))
# An upright shape is given up only for one that is clearly better.
_CLEARLY = 0.9


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Trial:
    cost: float
    exponents: tuple[float, float]
    semi_axes_m: NDArray[np.float64]
    pose: NDArray[np.float64]


def sketch(points_world: NDArray[Any], box: OrientedBox) -> Superquadrics | None:
    """Return one superquadric for (N, 3) surface points and the upright box that stands around most of them.

    It has the least product of mean radial distance to the points and cube root of its volume, as in Solina and Bajcsy
    (1990). Semi-axes are at least the box's smallest half extent; None for fewer than 20 finite points in the box.
    """
    points = np.asarray(points_world).reshape(-1, 3)
    # What is not finite is in no box.
    inside = np.flatnonzero(box.contains(points, 1e-6))
    if len(inside) < _MIN_POINTS:
        return None
    some = np.linspace(0, len(inside) - 1, min(len(inside), _MAX_POINTS)).astype(np.int64)
    points = points[inside[some]].astype(np.float64)
    thinnest = float(box.half_extents_m.min())
    upright = _best(points, box.world_from_box[:3, :3], box.center, box.half_extents_m)
    axes = _principal_axes(points)
    local = portable.matmul(points, axes)
    low, high = local.min(axis=0), local.max(axis=0)
    center = portable.matmul(axes, (low + high) / 2)
    leaning = _best(points, axes, center, np.maximum((high - low) / 2, thinnest))
    chosen = leaning if leaning.cost < _CLEARLY * upright.cost else upright
    exponents, axes, pose = np.array([chosen.exponents]), chosen.semi_axes_m[None], chosen.pose[None]
    return canonical(Superquadrics(exponents=exponents, semi_axes_m=axes, world_from_local=pose))


def _best(
    points: NDArray[np.float64], axes: NDArray[np.float64], center: NDArray[np.float64], half: NDArray[np.float64]
) -> _Trial:
    offsets = points - center
    lengths = np.linalg.norm(offsets, axis=1)
    logs = portable.log(np.maximum(np.abs(portable.matmul(offsets, axes)) / half, 1e-9))
    semi_axes_m = [portable.matmul(half, order) for order in _ORDERS]
    sizes = np.concatenate([portable.cbrt(_unit_volumes() * own.prod()) for own in semi_axes_m])
    costs = _distances(np.ascontiguousarray(logs.T), lengths, np.array(_EXPONENTS)).mean(axis=1) * sizes
    best = int(np.argmin(costs))
    turn, of_e2, of_e1 = np.unravel_index(best, (len(_ORDERS), len(_EXPONENTS), len(_EXPONENTS)))
    return _Trial(
        cost=float(costs[best]),
        exponents=(_EXPONENTS[of_e1], _EXPONENTS[of_e2]),
        semi_axes_m=semi_axes_m[turn],
        pose=from_rotation_translation(portable.matmul(axes, _ORDERS[turn]), center),
    )


@cache
def _unit_volumes() -> NDArray[np.float64]:
    return unit_volumes(np.array([(e1, e2) for e2 in _EXPONENTS for e1 in _EXPONENTS]))


@kernel
def _distances(logs, lengths, exponents):
    # (T, N) by the order of the axes, then e2, then e1; `logs` (3, N) in shares of the half extents.
    count, kinds = len(lengths), len(exponents)
    out = np.empty((3 * kinds * kinds, count))
    log_rho, log_gauge, high, rest = np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    trial = 0
    for shift in range(3):
        # As the columns of the orders, which are turned by as many.
        x, y, z = logs[-shift % 3], logs[(1 - shift) % 3], logs[(2 - shift) % 3]
        for e2 in exponents:
            _add_logs(2 / e2, x, y, e2 / 2, high, rest, log_rho)
            for e1 in exponents:
                _add_logs(2 / e1, log_rho, z, e1 / 2, high, rest, log_gauge)
                _measure(lengths, log_gauge, out[trial])
                trial += 1
    return out


# Loops of one function each: they are vectorised.


@kernel(error_model="numpy")
def _add_logs(power, a, b, root, high, rest, out):
    # root ln(e^(power a) + e^(power b)) into `out`, as `logaddexp` has it; `high` and `rest` are used up.
    for i in range(len(out)):
        first, second = power * a[i], power * b[i]
        high[i] = max(first, second)
        rest[i] = exp(min(first, second) - high[i])
    for i in range(len(out)):
        out[i] = root * (high[i] + log1p(rest[i]))


@kernel(error_model="numpy")
def _measure(lengths, log_gauge, out):
    for i in range(len(out)):
        out[i] = abs(lengths[i] * (1.0 - exp(-log_gauge[i])))


def _principal_axes(points: NDArray[np.float64]) -> NDArray[np.float64]:
    centered = points - points.mean(axis=0)
    _, axes = portable.eigh(portable.matmul(centered.T, centered))
    return np.asarray(axes * np.array([np.sign(portable.det3(axes)), 1.0, 1.0]))
