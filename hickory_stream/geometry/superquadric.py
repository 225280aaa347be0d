"""Superquadrics, the model of layers 3 and 4, and their canonical form.

All is evaluated through logarithms: with exponents down to 0.1 the powers of Eq. (sq) reach 20 and overflow. For
exponents in 0..2 a superquadric is the unit ball of a nested p-norm, so convex; its support is the dual norm.

The canonical one of many equal parameterisations, in this order:

1. A column of equal axes with e2 > 1 is written as its dual, turned by 45 degrees about z with 2 - e2, where this is a
   body the same to within `DUAL_TOLERANCE` of its radius: near a circle and near a square.
2. For e1 = e2 every order of the axes is the same body: the semi-axes fall. Else x and y may change places: a1 >= a2.
3. Of the rotations that are left (half turns; quarter turns about z for a1 = a2) it is the one closest to the frame's
   own axes, and of equally close ones the one whose matrix, row by row, is largest.
4. Primitives come by volume, largest first; of equal volumes by their semi-axes, then exponents, then centres.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from hickory_stream.geometry import portable
from hickory_stream.geometry.arrays import freeze, freeze_all
from hickory_stream.geometry.portable_kernels import power
from hickory_stream.geometry.rigid import apply, from_rotation_translation, invert, is_rigid

MIN_EXPONENT = 0.1
MAX_EXPONENT = 2.0

_EXPONENT_SLACK = 1e-9
# Transforms that were multiplied a few times.
_POSE_TOLERANCE = 1e-6
_TINY = 1e-300
_MAX_LOG = 700.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Superquadrics:
    """N primitives, largest volume first."""

    #: (N, 2) = (e1, e2), in 0.1..2
    exponents: NDArray[np.float64]
    #: (N, 3)
    semi_axes_m: NDArray[np.float64]
    #: (N, 4, 4)
    world_from_local: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze(self, "exponents", np.float64, (None, 2))
        count = len(self.exponents)
        freeze_all(self, np.float64, semi_axes_m=(count, 3), world_from_local=(count, 4, 4))

    def __len__(self) -> int:
        return len(self.exponents)


def check_bodies(primitives: Superquadrics) -> None:
    """Raise ValueError for numbers that are no superquadrics: not finite, beyond 0.1..2, not positive, not rigid."""
    exponents, axes = primitives.exponents, primitives.semi_axes_m
    if not ((exponents >= MIN_EXPONENT - _EXPONENT_SLACK) & (exponents <= MAX_EXPONENT + _EXPONENT_SLACK)).all():
        raise ValueError(f"exponents of superquadrics outside of {MIN_EXPONENT} to {MAX_EXPONENT}")
    if not (np.isfinite(axes) & (axes > 0)).all():
        raise ValueError("semi-axes of superquadrics that are not positive and finite")
    if not all(is_rigid(pose, tolerance=_POSE_TOLERANCE) for pose in primitives.world_from_local):
        raise ValueError("superquadrics whose poses are not rigid")


def log_implicit_value(primitives: Superquadrics, index: int, points_world: NDArray[Any]) -> NDArray[np.float64]:
    """Return (N,) ln G of Eq. (sq) of the paper for one primitive at (N, 3) points; finite everywhere."""
    local = apply(invert(primitives.world_from_local[index]), np.asarray(points_world, dtype=np.float64))
    e1, e2 = primitives.exponents[index]
    logs = portable.log(np.maximum(np.abs(local) / primitives.semi_axes_m[index], _TINY))
    log_xy = e2 / e1 * portable.logaddexp(2 / e2 * logs[:, 0], 2 / e2 * logs[:, 1])
    return np.asarray(portable.logaddexp(log_xy, 2 / e1 * logs[:, 2]))


def implicit_value(primitives: Superquadrics, index: int, points_world: NDArray[Any]) -> NDArray[np.float64]:
    """Return (N,) G of Eq. (sq) of the paper at (N, 3) points: below 1 inside, above 1 outside, at most e^700."""
    return np.asarray(portable.exp(np.minimum(log_implicit_value(primitives, index, points_world), _MAX_LOG)))


def outward_normals(primitives: Superquadrics, index: int, points_world: NDArray[Any]) -> NDArray[np.float64]:
    """Return (N, 3) unit vectors along the gradient of G; 0 at the centre, where there is none."""
    signs, logs = _log_gradient(primitives, index, points_world)
    # Whatever the size of the gradient: only its components against the largest one count.
    local = signs * portable.exp(np.maximum(logs - logs.max(axis=1, keepdims=True), -_MAX_LOG))
    lengths = np.maximum(np.linalg.norm(local, axis=1, keepdims=True), _TINY)
    return portable.matmul(local / lengths, primitives.world_from_local[index, :3, :3].T)


def volumes_m3(primitives: Superquadrics) -> NDArray[np.float64]:
    """Return the (N,) volumes in closed form: 2 a1 a2 a3 e1 e2 B(e1/2 + 1, e1) B(e2/2, e2/2) (Jaklic et al., 2000)."""
    return np.asarray(unit_volumes(primitives.exponents) * primitives.semi_axes_m.prod(axis=1))


def unit_volumes(exponents: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (N,) volumes of primitives with these exponents (N, 2) and semi-axes of 1."""
    e1, e2 = exponents[:, 0], exponents[:, 1]
    return np.asarray(2 * e1 * e2 * scipy.special.beta(e1 / 2 + 1, e1) * scipy.special.beta(e2 / 2, e2 / 2))


def centroid_world(primitives: Superquadrics) -> NDArray[np.float64]:
    """Return the (3,) mean of the centres, weighted by volume: the centroid as far as the primitives do not overlap."""
    weights = volumes_m3(primitives)
    return np.asarray(portable.matmul(weights, primitives.world_from_local[:, :3, 3]) / weights.sum())


def sorted_by_volume(primitives: Superquadrics) -> Superquadrics:
    """Return the primitives with the largest volume first; equal ones keep their order."""
    return taken(primitives, np.argsort(-volumes_m3(primitives), kind="stable"))


def taken(primitives: Superquadrics, indices: NDArray[Any]) -> Superquadrics:
    """Return the primitives at `indices`, in that order."""
    return Superquadrics(
        exponents=primitives.exponents[indices],
        semi_axes_m=primitives.semi_axes_m[indices],
        world_from_local=primitives.world_from_local[indices],
    )


def joined(parts: Sequence[Superquadrics]) -> Superquadrics:
    """Return the primitives of all parts, one part after the other."""
    return Superquadrics(
        exponents=np.concatenate([part.exponents for part in parts]),
        semi_axes_m=np.concatenate([part.semi_axes_m for part in parts]),
        world_from_local=np.concatenate([part.world_from_local for part in parts]),
    )


def moved(primitives: Superquadrics, a_from_world: NDArray[np.float64]) -> Superquadrics:
    """Return the primitives placed in frame a."""
    return replace(primitives, world_from_local=portable.matmul(a_from_world, primitives.world_from_local))


def support(primitives: Superquadrics, index: int, directions_world: NDArray[Any]) -> NDArray[np.float64]:
    """Return (N,) h(d) = max of d . p over the primitive, for (N, 3) directions of any length.

    The dual of the nested norm: p = 2/e becomes q = 2/(2 - e).
    """
    pose = primitives.world_from_local[index]
    directions = np.asarray(directions_world, dtype=np.float64)
    scaled = np.abs(portable.matmul(directions, pose[:3, :3])) * primitives.semi_axes_m[index]
    e1, e2 = primitives.exponents[index]
    reach = _dual_norm(_dual_norm(scaled[:, 0], scaled[:, 1], e2), scaled[:, 2], e1)
    return np.asarray(portable.matmul(directions, pose[:3, 3]) + reach)


def support_reach(primitives: Superquadrics, directions_world: NDArray[Any]) -> NDArray[np.float64]:
    """Return (K, N) max of d . (p - centre) over each of K primitives, for (N, 3) directions of any length."""
    directions = np.asarray(directions_world, dtype=np.float64)
    along = portable.matmul(directions, primitives.world_from_local[:, :3, :3])
    scaled = np.abs(along) * primitives.semi_axes_m[:, None]
    e1, e2 = primitives.exponents[:, :1], primitives.exponents[:, 1:]
    return _dual_norm(_dual_norm(scaled[..., 0], scaled[..., 1], e2), scaled[..., 2], e1)


def bounds_in(primitives: Superquadrics, frame_from_world: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (N, 2, 3) tight bounds along the axes of a frame, in that frame: lowest corner, highest corner."""
    centers = apply(frame_from_world, primitives.world_from_local[:, :3, 3])
    reach = support_reach(primitives, frame_from_world[:3, :3])
    return np.stack([centers - reach, centers + reach], axis=1)


def world_bounds(primitives: Superquadrics) -> NDArray[np.float64]:
    """Return the (N, 2, 3) tight axis-aligned bounds in the world: lowest corner, highest corner."""
    return bounds_in(primitives, np.eye(4))


def _log_gradient(
    primitives: Superquadrics, index: int, points_world: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # Signs and logarithms (N, 3) of the components of the gradient of G along the primitive's axes.
    local = apply(invert(primitives.world_from_local[index]), np.asarray(points_world, dtype=np.float64))
    e1, e2 = primitives.exponents[index]
    log_axes = portable.log(primitives.semi_axes_m[index])
    logs = portable.log(np.maximum(np.abs(local), _TINY)) - log_axes
    log_rho = portable.logaddexp(2 / e2 * logs[:, 0], 2 / e2 * logs[:, 1])
    # dG/dx = 2 / (e1 a1) rho^(e2 / e1 - 1) |x / a1|^(2 / e2 - 1), and dG/dz = 2 / (e1 a3) |z / a3|^(2 / e1 - 1).
    level = (e2 / e1 - 1) * log_rho[:, None] + (2 / e2 - 1) * logs[:, :2]
    upright = (2 / e1 - 1) * logs[:, 2:]
    return np.sign(local), portable.log(2 / e1) - log_axes + np.concatenate([level, upright], axis=1)


def _dual_norm(a: NDArray[np.float64], b: NDArray[np.float64], exponent: Any) -> NDArray[np.float64]:
    # The q-norm of (a, b) >= 0 for q = 2/(2 - exponent): from the sum towards the maximum.
    largest = np.maximum(a, b)
    ratio = np.minimum(a, b) / np.maximum(largest, _TINY)
    q = 2 / np.maximum(2 - exponent, 1e-3)
    return np.asarray(largest * portable.power(1 + portable.power(ratio, q), 1 / q))


# How far, in shares of the radius, the dual may be from the body that it replaces.
DUAL_TOLERANCE = 0.02
# Exponents and ratios of semi-axes that differ by less are equal.
_EQUAL = 1e-6
_ROUGHLY_EQUAL = 0.01


def canonical(primitives: Superquadrics) -> Superquadrics:
    """Return the same bodies in canonical form: one set of parameters for each, in a stated order."""
    rows = [_canonical_one(primitives, i) for i in range(len(primitives))]
    if not rows:
        return primitives
    found = Superquadrics(
        exponents=np.stack([exponents for exponents, _, _ in rows]),
        semi_axes_m=np.stack([axes for _, axes, _ in rows]),
        world_from_local=np.stack([pose for _, _, pose in rows]),
    )
    return taken(found, _order(found))


def _canonical_one(
    primitives: Superquadrics, index: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    exponents, axes = primitives.exponents[index].copy(), primitives.semi_axes_m[index].copy()
    pose = primitives.world_from_local[index]
    rotation = pose[:3, :3]
    if exponents[1] > 1 and abs(axes[0] - axes[1]) <= _ROUGHLY_EQUAL * axes[:2].max():
        dual = max(2 - float(exponents[1]), MIN_EXPONENT)
        if _dual_gap(float(exponents[1]), dual) <= DUAL_TOLERANCE:
            axes[:2] *= power(2.0, (1 - exponents[1]) / 2)
            exponents[1] = dual
            c = np.sqrt(0.5)
            rotation = portable.matmul(rotation, np.array([[c, -c, 0], [c, c, 0], [0, 0, 1.0]]))
    orders = permutations(range(3)) if abs(exponents[0] - exponents[1]) <= _EQUAL else ((0, 1, 2), (1, 0, 2))
    forms = [(tuple(axes[list(order)]), order) for order in orders]
    largest = max(form for form, _ in forms)
    near = tuple(_EQUAL * abs(length) for length in largest)
    equal = [o for form, o in forms if all(abs(a - b) <= c for a, b, c in zip(form, largest, near, strict=True))]
    turned = _closest_to_identity([rotation[:, list(order)] for order in equal])
    return exponents, np.array(largest), from_rotation_translation(turned, pose[:3, 3])


def _closest_to_identity(candidates: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    handed = [(c, portable.det3(c)) for c in candidates]
    proper = [c * signs for c, det in handed for signs in _SIGNS if det * (signs[0] * signs[1] * signs[2]) > 0]
    traces = [round(float(c.trace()), 9) for c in proper]
    most = max(traces)
    first = [c for c, trace in zip(proper, traces, strict=True) if trace == most]
    return first[0] if len(first) == 1 else max(first, key=lambda c: tuple(np.round(c, 9).ravel()))


_SIGNS = tuple(np.array(signs) for signs in product((1.0, -1.0), repeat=3))


def _dual_gap(exponent: float, dual: float) -> float:
    # The largest relative difference of radius between an outline and its dual.
    angles = np.linspace(0, np.pi / 4, 17)
    first = _radius(angles, exponent)
    second = power(2.0, (1 - exponent) / 2) * _radius(np.pi / 4 - angles, dual)
    return float(np.abs(second / first - 1).max())


def _radius(angles: NDArray[np.float64], exponent: float) -> NDArray[np.float64]:
    p = 2 / exponent
    c, s = np.abs(portable.cos(angles)), np.abs(portable.sin(angles))
    return portable.power(portable.power(c, p) + portable.power(s, p), -1 / p)


def _order(primitives: Superquadrics) -> NDArray[np.int64]:
    # Six digits: what is equal but for rounding is ordered by the next rule.
    def rounded(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.array([float(f"{value:.5e}") for value in values.ravel().tolist()]).reshape(values.shape)

    keys = [rounded(volumes_m3(primitives)), *rounded(primitives.semi_axes_m).T]
    keys += [*rounded(primitives.exponents).T, *primitives.world_from_local[:, :3, 3].T]
    return np.asarray(np.lexsort([-key for key in reversed(keys)]))
