"""One superquadric around a whole surface: of its box, cylinders in it and a fitted one, the one of least volume."""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.geometry.portable_kernels import exp
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.geometry.sketch import sketch
from hickory_stream.geometry.superquadric import MIN_EXPONENT, Superquadrics, log_implicit_value, volumes_m3


def box_superquadric(vertices: NDArray[np.float64], min_size_m: float) -> Superquadrics:
    """Return the axis-aligned box of (N, 3) vertices as one superquadric with exponents of 0.1."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return Superquadrics(
        exponents=np.full((1, 2), 0.1),
        semi_axes_m=np.maximum((high - low) / 2, min_size_m / 2)[None],
        world_from_local=from_rotation_translation(np.eye(3), (low + high) / 2)[None],
    )


def around_all(vertices: NDArray[np.float64], faces: NDArray[np.int32], min_size_m: float) -> Superquadrics:
    """Return the superquadric of least volume that contains the surface of a mesh, of a few candidates.

    These are its box, the cylinders in that box along each axis, and a fitted superquadric, for bowls and bins.
    """
    extent = np.ptp(vertices, axis=0)
    whole = box_superquadric(vertices, min_size_m)
    if extent.min() <= min_size_m:
        return whole
    box = OrientedBox(world_from_box=whole.world_from_local[0], half_extents_m=whole.semi_axes_m[0])
    surface = surface_samples(vertices[faces])
    found = sketch(surface, box)
    candidates = [whole, *_cylinders_in(whole), *([] if found is None else [found])]
    return min(candidates, key=lambda candidate: _cover_m3(candidate, surface))


def _cylinders_in(box: Superquadrics) -> list[Superquadrics]:
    pose = box.world_from_local[0]
    cylinders = []
    for turn in ([0, 1, 2], [1, 2, 0], [2, 0, 1]):
        turned = pose.copy()
        turned[:3, :3] = pose[:3, turn]
        cylinders.append(
            Superquadrics(
                exponents=np.array([[MIN_EXPONENT, 1.0]]),
                semi_axes_m=box.semi_axes_m[:, turn],
                world_from_local=turned[None],
            )
        )
    return cylinders


def _cover_m3(primitive: Superquadrics, points: NDArray[np.float64]) -> float:
    # A scale s divides G by s^(2 / e1).
    scale = exp(float(log_implicit_value(primitive, 0, points).max()) * primitive.exponents[0, 0] / 2)
    return float(volumes_m3(primitive)[0] * (scale * scale * scale))


def surface_samples(corners: NDArray[np.float64], count: int = 500) -> NDArray[np.float64]:
    """Return (count, 3) points distributed over (F, 3, 3) triangles by area, deterministically."""
    a, b, c = corners.transpose(1, 0, 2)
    passed = np.cumsum(np.linalg.norm(np.cross(b - a, c - a), axis=1))
    steps = np.arange(count)
    chosen = np.searchsorted(passed, (steps + 0.5) / count * passed[-1])
    # A low-discrepancy sequence in the unit square, folded into a triangle.
    u, v = (steps * 0.7548776662466927) % 1.0, (steps * 0.5698402909980532) % 1.0
    u, v = np.where(u + v > 1, 1 - u, u)[:, None], np.where(u + v > 1, 1 - v, v)[:, None]
    return np.asarray(a[chosen] + u * (b - a)[chosen] + v * (c - a)[chosen])
