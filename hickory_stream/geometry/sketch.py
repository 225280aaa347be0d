"""A superquadric from points alone: what is known of an object's shape before it has a mesh.

The points lie on a surface of which a part was seen. Where a superquadric ends along its axes is read off the points;
left are the frame, which axis is the third, and the two exponents. These are few enough to try them all: upright or
along the principal axes, boxes, cylinders, ellipsoids and what lies between.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.geometry import portable
from hickory_stream.geometry.canonical import canonical
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.geometry.superquadric import Superquadrics, volumes_m3

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
    costs, semi_axes_m = [], [portable.matmul(half, order) for order in _ORDERS]
    for order, own_axes in zip(_ORDERS, semi_axes_m, strict=True):
        own = portable.matmul(logs, order)
        size = portable.cbrt(_volumes_m3(own_axes))
        for i, e2 in enumerate(_EXPONENTS):
            log_rho = e2 / 2 * portable.logaddexp(2 / e2 * own[:, 0], 2 / e2 * own[:, 1])
            for j, e1 in enumerate(_EXPONENTS):
                log_gauge = e1 / 2 * portable.logaddexp(2 / e1 * log_rho, 2 / e1 * own[:, 2])
                distance = float(np.abs(lengths * (1 - portable.exp(-log_gauge))).mean())
                costs.append(distance * float(size[i, j]))
    best = int(np.argmin(costs))
    turn, of_e2, of_e1 = np.unravel_index(best, (len(_ORDERS), len(_EXPONENTS), len(_EXPONENTS)))
    return _Trial(
        cost=costs[best],
        exponents=(_EXPONENTS[of_e1], _EXPONENTS[of_e2]),
        semi_axes_m=semi_axes_m[turn],
        pose=from_rotation_translation(portable.matmul(axes, _ORDERS[turn]), center),
    )


def _volumes_m3(semi_axes_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the volumes of primitives with these semi-axes (3,), by the number of e2, then of e1."""
    exponents = np.array([(e1, e2) for e2 in _EXPONENTS for e1 in _EXPONENTS])
    poses = np.broadcast_to(np.eye(4), (len(exponents), 4, 4))
    trials = Superquadrics(
        exponents=exponents, semi_axes_m=np.tile(semi_axes_m, (len(exponents), 1)), world_from_local=poses
    )
    return volumes_m3(trials).reshape(len(_EXPONENTS), len(_EXPONENTS))


def _principal_axes(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (3, 3) right-handed columns."""
    centered = points - points.mean(axis=0)
    _, axes = portable.eigh(portable.matmul(centered.T, centered))
    return np.asarray(axes * np.array([np.sign(portable.det3(axes)), 1.0, 1.0]))


def _as_superquadrics(
    exponents: tuple[float, float], semi_axes_m: NDArray[np.float64], pose: NDArray[np.float64]
) -> Superquadrics:
    return Superquadrics(exponents=np.array([exponents]), semi_axes_m=semi_axes_m[None], world_from_local=pose[None])
