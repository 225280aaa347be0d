"""The surface of a superquadric: meshes at a stated error, and points that are evenly spread.

A superquadric is the product of two outlines, one around and one from pole to pole.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.superquadric import Superquadrics, log_implicit_value

_TINY = 1e-300
# Of a quarter of an outline so many points are known; a chord between two of them is off by 3e-5 of the semi-axes.
_OUTLINE = 513
_MIN_ERROR = 1e-4


def display_mesh(
    primitives: Superquadrics, index: int, max_error_m: float | None = None
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return the closed surface of a primitive: (V, 3) float32 world vertices and (F, 3) int32 faces, looking outwards.

    Vertices lie on the surface, which is nowhere farther than `max_error_m` from the mesh: by default a hundredth of
    the largest semi-axis, at best a ten-thousandth. Outlines are polygons: faces are plane, and their errors add.
    """
    axes = primitives.semi_axes_m[index]
    e1, e2 = primitives.exponents[index]
    largest = float(axes.max())
    tolerance = max(largest / 100 if max_error_m is None else max_error_m, _MIN_ERROR * largest)
    x, y = _quarter(e2)
    kept = _polygon(x * axes[0], y * axes[1], 0.48 * tolerance)
    reach = float(portable.hypot(x * axes[0], y * axes[1]).max())
    radius, z = _quarter(e1)
    rings = _polygon(radius * reach, z * axes[2], 0.48 * tolerance)
    return _product_mesh(primitives, index, (x[kept], y[kept]), (radius[rings], z[rings]))


def surface_points(primitives: Superquadrics, index: int, count: int) -> NDArray[np.float64]:
    """Return (count, 3) points on the surface in the world, evenly spread: each stands for the same area.

    A space-filling curve walks through patches of the surface; a point follows each share of the area. Deterministic.
    """
    centers, areas = _patches(primitives, index, 24, 24)
    spacing = float(np.sqrt(areas.sum() / count))
    around, across = _lengths_m(primitives, index)
    # Patches well below the spacing, so that each point has several of them; their number is bounded.
    steps = np.clip(np.ceil(np.array([around, across]) / spacing * 2.5 / 4), 6, 128).astype(np.int64)
    centers, areas = _patches(primitives, index, int(steps[0]), int(steps[1]))
    order = np.argsort(_along_curve(centers), kind="stable")
    passed = np.cumsum(areas[order])
    wanted = (np.arange(count) + 0.5) / count * passed[-1]
    chosen = centers[order[np.searchsorted(passed, wanted)]]
    pose = primitives.world_from_local[index]
    # The middle of a patch is a little below the surface: on along the ray from the centre.
    log_g = log_implicit_value(primitives, index, apply(pose, chosen))
    return apply(pose, chosen * portable.exp(-primitives.exponents[index, 0] / 2 * log_g)[:, None])


@lru_cache(maxsize=64)
def _quarter(exponent: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # From (1, 0) to (0, 1), both exact; read-only.
    c, s = _unit_curve(np.linspace(0, np.pi / 2, _OUTLINE), exponent)
    c[-1], s[0] = 0.0, 0.0
    c.flags.writeable = s.flags.writeable = False
    return c, s


def _polygon(x: NDArray[np.float64], y: NDArray[np.float64], tolerance: float) -> NDArray[np.int64]:
    # No point of the convex arc is farther than `tolerance` from its chord.
    kept, spans = [0, len(x) - 1], [(0, len(x) - 1)]
    while spans:
        first, last = spans.pop()
        dx, dy = x[last] - x[first], y[last] - y[first]
        off = np.abs(dx * (y[first + 1 : last] - y[first]) - dy * (x[first + 1 : last] - x[first]))
        if len(off) == 0 or off.max() <= tolerance * portable.hypot(dx, dy):
            continue
        middle = first + 1 + int(np.argmax(off))
        kept.append(middle)
        spans += [(first, middle), (middle, last)]
    return np.array(sorted(kept))


def _product_mesh(
    primitives: Superquadrics,
    index: int,
    around: tuple[NDArray[np.float64], NDArray[np.float64]],
    upwards: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    (x, y), (radius, z) = around, upwards
    x = np.concatenate([x[:-1], -x[:0:-1], -x[:-1], x[:0:-1]])
    y = np.concatenate([y[:-1], y[:0:-1], -y[:-1], -y[:0:-1]])
    radius = np.concatenate([radius[-2:0:-1], radius[:-1]])
    z = np.concatenate([-z[-2:0:-1], z[:-1]])
    local = np.empty((len(z) * len(x) + 2, 3))
    local[:-2, 0] = np.outer(radius, x).ravel()
    local[:-2, 1] = np.outer(radius, y).ravel()
    local[:-2, 2] = np.repeat(z, len(x))
    local[-2:] = [[0, 0, -1], [0, 0, 1]]
    vertices = apply(primitives.world_from_local[index], local * primitives.semi_axes_m[index])
    return vertices.astype(np.float32), _sphere_faces(len(z), len(x))


def _lengths_m(primitives: Superquadrics, index: int) -> tuple[float, float]:
    axes = primitives.semi_axes_m[index]
    (x, y), (radius, z) = (_quarter(e) for e in primitives.exponents[index, ::-1])
    reach = float(portable.hypot(x * axes[0], y * axes[1]).max())
    around = 4 * _arc(x * axes[0], y * axes[1])[-1]
    return float(around), float(2 * _arc(radius * reach, z * axes[2])[-1])


def _patches(
    primitives: Superquadrics, index: int, steps_around: int, steps_upwards: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # (N, 3) middles in the primitive's frame and (N,) areas; a quarter of each outline has so many steps.
    axes = primitives.semi_axes_m[index]
    (x, y), (radius, z) = (_quarter(e) for e in primitives.exponents[index, ::-1])
    reach = float(portable.hypot(x * axes[0], y * axes[1]).max())
    x, y = _evenly(x, y, _arc(x * axes[0], y * axes[1]), steps_around)
    radius, z = _evenly(radius, z, _arc(radius * reach, z * axes[2]), steps_upwards)
    middles, areas = _patches_of_octant(x, y, radius, z, np.array(axes))
    signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], dtype=np.float64)
    return (signs[:, None] * middles[None]).reshape(-1, 3), np.tile(areas, len(signs))


def _arc(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.concatenate([[0.0], np.cumsum(portable.hypot(np.diff(x), np.diff(y)))])


def _evenly(
    x: NDArray[np.float64], y: NDArray[np.float64], passed: NDArray[np.float64], steps: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    wanted = np.linspace(0, passed[-1], steps + 1)
    return np.interp(wanted, passed, x), np.interp(wanted, passed, y)


def _along_curve(points: NDArray[np.float64]) -> NDArray[np.int64]:
    # Morton's curve.
    low = points.min(axis=0)
    return np.asarray(_places(points, low, max(float((points.max(axis=0) - low).max()), _TINY)))


@kernel
def _places(points, low, extent):
    out = np.zeros(len(points), np.int64)
    for n in range(len(points)):
        for axis in range(3):
            # 10 bits, with two zeros after each.
            bits = np.int64((points[n, axis] - low[axis]) / extent * 1023.0)
            bits = (bits | bits << 16) & 0x030000FF
            bits = (bits | bits << 8) & 0x0300F00F
            bits = (bits | bits << 4) & 0x030C30C3
            bits = (bits | bits << 2) & 0x09249249
            out[n] |= bits << axis
    return out


@kernel(error_model="numpy")
def _patches_of_octant(x, y, radius, z, axes):
    count = (len(radius) - 1) * (len(x) - 1)
    middles, areas = np.empty((count, 3)), np.empty(count)
    corners, across, along = np.empty((4, 3)), np.empty(3), np.empty(3)
    n = 0
    for ring in range(len(radius) - 1):
        for step in range(len(x) - 1):
            for c in range(4):
                i, j = ring + (1 if c > 1 else 0), step + (1 if c in (1, 2) else 0)
                corners[c, 0] = radius[i] * x[j] * axes[0]
                corners[c, 1] = radius[i] * y[j] * axes[1]
                corners[c, 2] = z[i] * axes[2]
            for axis in range(3):
                across[axis] = corners[2, axis] - corners[0, axis]
                along[axis] = corners[3, axis] - corners[1, axis]
                middles[n, axis] = (corners[0, axis] + corners[1, axis] + corners[2, axis] + corners[3, axis]) / 4.0
            a = across[1] * along[2] - across[2] * along[1]
            b = across[2] * along[0] - across[0] * along[2]
            c = across[0] * along[1] - across[1] * along[0]
            areas[n] = np.sqrt(a * a + b * b + c * c) / 2.0
            n += 1
    return middles, areas


def _unit_curve(angles: NDArray[np.float64], exponent: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # Points (c, s) of |c|^(2/e) + |s|^(2/e) = 1.
    c, s = portable.cos(angles), portable.sin(angles)
    log_c, log_s = (portable.log(np.maximum(np.abs(side), _TINY)) for side in (c, s))
    scale = portable.exp(-exponent / 2 * portable.logaddexp(2 / exponent * log_c, 2 / exponent * log_s))
    return c * scale, s * scale


def _sphere_faces(rings: int, segments: int) -> NDArray[np.int32]:
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
