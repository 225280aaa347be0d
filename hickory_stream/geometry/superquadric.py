"""Superquadrics: the model of layers 3 and 4.

Everything is evaluated through logarithms: with exponents down to 0.1 the powers of Eq. (sq) reach 20 and more, which
overflows for points a few semi-axes away. For exponents in 0..2 a superquadric is the unit ball of a nested p-norm, and
so convex; its support function is the dual norm.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import beta

from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.rigid import apply, invert

if TYPE_CHECKING:
    from numpy.typing import NDArray

MIN_EXPONENT = 0.1
MAX_EXPONENT = 2.0

_TINY = 1e-300
_MAX_LOG = 700.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Superquadrics:
    """N primitives, largest volume first.

    `exponents` (N, 2) = (e1, e2), in 0.1..2; `semi_axes_m` (N, 3); `world_from_local` (N, 4, 4).
    """

    exponents: NDArray[np.float64]
    semi_axes_m: NDArray[np.float64]
    world_from_local: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze(self, "exponents", np.float64, (None, 2))
        count = len(self.exponents)
        freeze(self, "semi_axes_m", np.float64, (count, 3))
        freeze(self, "world_from_local", np.float64, (count, 4, 4))

    def __len__(self) -> int:
        return len(self.exponents)


def log_implicit_value(primitives: Superquadrics, index: int, points_world: NDArray[Any]) -> NDArray[np.float64]:
    """Return (N,) ln G of Eq. (sq) of the paper for one primitive at (N, 3) points; finite everywhere."""
    local = apply(invert(primitives.world_from_local[index]), np.asarray(points_world, dtype=np.float64))
    e1, e2 = primitives.exponents[index]
    logs = np.log(np.maximum(np.abs(local) / primitives.semi_axes_m[index], _TINY))
    log_xy = e2 / e1 * np.logaddexp(2 / e2 * logs[:, 0], 2 / e2 * logs[:, 1])
    return np.asarray(np.logaddexp(log_xy, 2 / e1 * logs[:, 2]))


def implicit_value(primitives: Superquadrics, index: int, points_world: NDArray[Any]) -> NDArray[np.float64]:
    """Return (N,) G of Eq. (sq) of the paper at (N, 3) points: below 1 inside, above 1 outside, at most e^700."""
    return np.asarray(np.exp(np.minimum(log_implicit_value(primitives, index, points_world), _MAX_LOG)))


def radial_distance_m(primitives: Superquadrics, index: int, points_world: NDArray[Any]) -> NDArray[np.float64]:
    """Return (N,) signed distances to the surface along the ray from the centre, negative inside.

    The radial Euclidean distance |p| (1 - G^(-e1/2)); at the centre itself minus the smallest semi-axis.
    """
    offsets = np.asarray(points_world, dtype=np.float64) - primitives.world_from_local[index, :3, 3]
    lengths = np.linalg.norm(offsets, axis=1)
    log_g = log_implicit_value(primitives, index, points_world)
    smallest = float(primitives.semi_axes_m[index].min())
    # The surface point on the ray is at |p| G^(-e1/2), and never nearer than a diamond's face is to the centre.
    surface = np.exp(np.log(np.maximum(lengths, _TINY)) - primitives.exponents[index, 0] / 2 * log_g)
    return np.asarray(np.where(lengths > 1e-12 * smallest, lengths - surface, -smallest))


def volumes_m3(primitives: Superquadrics) -> NDArray[np.float64]:
    """Return the (N,) volumes in closed form: 2 a1 a2 a3 e1 e2 B(e1/2 + 1, e1) B(e2/2, e2/2) (Jaklic et al., 2000)."""
    e1, e2 = primitives.exponents[:, 0], primitives.exponents[:, 1]
    shape = 2 * e1 * e2 * beta(e1 / 2 + 1, e1) * beta(e2 / 2, e2 / 2)
    return np.asarray(shape * primitives.semi_axes_m.prod(axis=1))


def centroid_world(primitives: Superquadrics) -> NDArray[np.float64]:
    """Return the (3,) mean of the centres, weighted by volume: the centroid as far as the primitives do not overlap."""
    weights = volumes_m3(primitives)
    return np.asarray(weights @ primitives.world_from_local[:, :3, 3] / weights.sum())


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


def moved(primitives: Superquadrics, a_from_world: NDArray[np.float64]) -> Superquadrics:
    """Return the primitives placed in frame a."""
    return Superquadrics(
        exponents=primitives.exponents,
        semi_axes_m=primitives.semi_axes_m,
        world_from_local=a_from_world @ primitives.world_from_local,
    )


def support(primitives: Superquadrics, index: int, directions_world: NDArray[Any]) -> NDArray[np.float64]:
    """Return (N,) h(d) = max of d . p over the primitive, for (N, 3) directions of any length.

    The dual of the nested norm: p = 2/e becomes q = 2/(2 - e).
    """
    pose = primitives.world_from_local[index]
    directions = np.asarray(directions_world, dtype=np.float64)
    scaled = np.abs(directions @ pose[:3, :3]) * primitives.semi_axes_m[index]
    e1, e2 = primitives.exponents[index]
    reach = _dual_norm(_dual_norm(scaled[:, 0], scaled[:, 1], e2), scaled[:, 2], e1)
    return np.asarray(directions @ pose[:3, 3] + reach)


def support_reach(primitives: Superquadrics, directions_world: NDArray[Any]) -> NDArray[np.float64]:
    """Return (K, N) max of d . (p - centre) over each of K primitives, for (N, 3) directions of any length."""
    directions = np.asarray(directions_world, dtype=np.float64)
    scaled = np.abs(directions @ primitives.world_from_local[:, :3, :3]) * primitives.semi_axes_m[:, None]
    e1, e2 = primitives.exponents[:, :1], primitives.exponents[:, 1:]
    return _dual_norm(_dual_norm(scaled[..., 0], scaled[..., 1], e2), scaled[..., 2], e1)


def world_bounds(primitives: Superquadrics) -> NDArray[np.float64]:
    """Return the (N, 2, 3) tight axis-aligned bounds in the world: lowest corner, highest corner."""
    centers = primitives.world_from_local[:, :3, 3]
    reach = support_reach(primitives, np.eye(3))
    return np.stack([centers - reach, centers + reach], axis=1)


def display_mesh(
    primitives: Superquadrics, index: int, segments: int = 24
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return the closed surface of a primitive: (V, 3) float32 world vertices and (F, 3) int32 faces, looking outwards.

    `segments` around the z axis (a multiple of 8 puts vertices on the edges of a box), half as many from pole to pole.
    The angles are those of the direction in the space of unit semi-axes: with the usual parameters the vertices of a
    box would all crowd at its corners.
    """
    e1, e2 = primitives.exponents[index]
    longitude = 2 * np.pi * np.arange(segments) / segments
    rings = segments // 2
    latitude = np.pi * (np.arange(1, rings) / rings - 0.5)
    x, y = _unit_curve(longitude, e2)
    radius, z = _unit_curve(latitude, e1)
    local = np.empty((len(latitude) * segments + 2, 3))
    local[:-2, 0] = np.outer(radius, x).ravel()
    local[:-2, 1] = np.outer(radius, y).ravel()
    local[:-2, 2] = np.repeat(z, segments)
    local[-2:] = [[0, 0, -1], [0, 0, 1]]
    vertices = apply(primitives.world_from_local[index], local * primitives.semi_axes_m[index])
    return vertices.astype(np.float32), _sphere_faces(len(latitude), segments)


def _unit_curve(angles: NDArray[np.float64], exponent: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the points (c, s) of |c|^(2/e) + |s|^(2/e) = 1 in the directions of `angles`."""
    c, s = np.cos(angles), np.sin(angles)
    log_c, log_s = np.log(np.maximum(np.abs(c), _TINY)), np.log(np.maximum(np.abs(s), _TINY))
    scale = np.exp(-exponent / 2 * np.logaddexp(2 / exponent * log_c, 2 / exponent * log_s))
    return c * scale, s * scale


def _sphere_faces(rings: int, segments: int) -> NDArray[np.int32]:
    """Return the faces of `rings` closed rings of `segments` vertices, then the lower and the upper pole."""
    here = np.arange(segments)
    after = (here + 1) % segments
    south, north = rings * segments, rings * segments + 1
    faces = [np.stack([np.full(segments, south), after, here], axis=1)]
    for ring in range(rings - 1):
        low, high = ring * segments, (ring + 1) * segments
        faces.append(np.stack([low + here, low + after, high + after], axis=1))
        faces.append(np.stack([low + here, high + after, high + here], axis=1))
    last = (rings - 1) * segments
    faces.append(np.stack([last + here, last + after, np.full(segments, north)], axis=1))
    return np.concatenate(faces).astype(np.int32)


def _dual_norm(a: NDArray[np.float64], b: NDArray[np.float64], exponent: Any) -> NDArray[np.float64]:
    """Return the q-norm of (a, b), both at least 0, for q = 2/(2 - exponent): from the sum towards the maximum."""
    largest = np.maximum(a, b)
    ratio = np.minimum(a, b) / np.maximum(largest, _TINY)
    q = 2 / np.maximum(2 - exponent, 1e-3)
    return np.asarray(largest * (1 + ratio**q) ** (1 / q))
