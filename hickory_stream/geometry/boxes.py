"""Oriented boxes: the gravity-aligned box of minimum area, and the exact intersection of any two.

The intersection of two boxes is a convex polyhedron. Its boundary is what remains of the faces of each box inside the
other, so that clipping twelve squares and summing their cones gives its volume exactly, without building the
polyhedron.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.compiled import numba
from hickory_stream.geometry import portable
from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.portable_kernels import cos, sin
from hickory_stream.geometry.rigid import apply, from_rotation_translation, yaw_rotation

if TYPE_CHECKING:
    from numpy.typing import NDArray


# A faced box is looked for in such steps, among rectangles this much larger than the smallest, with so many points.
_FACE_STEP_DEG = 2.0
_FACE_SLACK = 1.25
_FACE_POINTS = 800
# More than rounding takes off the reach of a box.
_SLACK_M = 1e-4


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class OrientedBox:
    """A box: `world_from_box` (4, 4), its centre the origin of the box frame; `half_extents_m` (3,), all positive."""

    world_from_box: NDArray[np.float64]
    half_extents_m: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze(self, "world_from_box", np.float64, (4, 4))
        freeze(self, "half_extents_m", np.float64, (3,))
        if not (self.half_extents_m > 0).all():
            raise ValueError(f"half extents must be positive, found {self.half_extents_m}")

    @property
    def center(self) -> NDArray[np.float64]:
        """The centre in the world, (3,)."""
        return self.world_from_box[:3, 3]

    @property
    def volume_m3(self) -> float:
        """The volume."""
        return _volume_m3(self.half_extents_m)

    @property
    def diagonal_m(self) -> float:
        """The length of the space diagonal."""
        return 2.0 * portable.norm(self.half_extents_m)

    def corners_world(self) -> NDArray[np.float64]:
        """Return the (8, 3) corners in the world."""
        signs = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        return apply(self.world_from_box, signs * self.half_extents_m)

    def contains(self, points_world: NDArray[Any], margin_m: float = 0.0) -> NDArray[np.bool_]:
        """Return for each of (N, 3) points whether it lies in the box grown by `margin_m`."""
        near = self._near(points_world, margin_m)
        return self._holds(points_world, near, points_world.take(near, axis=0), margin_m)

    def is_over_or_under(self, points_world: NDArray[Any], margin_m: float = 0.0) -> NDArray[np.bool_]:
        """Return for each of (N, 3) points whether it lies in the column of an upright box grown by `margin_m`."""
        near = self._near(points_world, margin_m, is_column=True)
        level = points_world.take(near, axis=0)
        level[:, 2] = self.center[2]
        return self._holds(points_world, near, level, margin_m)

    def _near(self, points_world: NDArray[Any], margin_m: float, *, is_column: bool = False) -> NDArray[np.int64]:
        """Return the numbers of the points in the upright, unturned box around this one, or in its column."""
        reach_m = portable.matmul(np.abs(self.world_from_box[:3, :3]), self.half_extents_m + margin_m) + _SLACK_M
        if is_column:
            reach_m[2] = np.inf
        near: NDArray[np.int64] = _within(np.ascontiguousarray(points_world), self.center, reach_m)
        return near

    def _holds(
        self, points_world: NDArray[Any], near: NDArray[np.int64], candidates: NDArray[Any], margin_m: float
    ) -> NDArray[np.bool_]:
        local = np.abs(portable.matmul(candidates - self.center, self.world_from_box[:3, :3]))
        inside = local <= self.half_extents_m + margin_m
        held = np.zeros(len(points_world), dtype=bool)
        held[near] = inside[:, 0] & inside[:, 1] & inside[:, 2]
        return held

    def grown(self, margin_m: float) -> OrientedBox:
        """Return the box with every half extent larger by `margin_m`."""
        return OrientedBox(world_from_box=self.world_from_box, half_extents_m=self.half_extents_m + margin_m)


def gravity_aligned_box(points_world: NDArray[Any], min_half_extent_m: float) -> OrientedBox:
    """Return the upright box of minimum footprint around (N, 3) points, N >= 1; half extents are at least the minimum.

    The footprint is found by rotating calipers: a minimal rectangle shares a side with the convex hull.
    """
    points = np.asarray(points_world, dtype=np.float64)
    hull = _hull_2d(points[:, :2])
    angles = _side_angles(hull)
    sizes, _ = _rectangles(hull, angles)
    best = int(np.argmin(sizes[0] * sizes[1] + 1e-9 * sizes.sum(axis=0)))
    return _upright_box(points, hull, float(angles[best]), min_half_extent_m)


def faced_box(points_world: NDArray[Any], min_half_extent_m: float) -> OrientedBox:
    """Return the upright box around (N, 3) points, N >= 1, whose sides the points lie along.

    Of a box whose front and one side were seen, the footprint is a triangle: the rectangle along its longest side is as
    small as the true one. Of the rectangles that are hardly larger than the smallest, this is the one with the sides
    closest to the points (the closeness criterion of Zhang et al., Efficient L-Shape Fitting, 2017).
    """
    points = np.asarray(points_world, dtype=np.float64)
    hull = _hull_2d(points[:, :2])
    angles = np.unique(np.concatenate([_side_angles(hull), np.deg2rad(np.arange(0, 90, _FACE_STEP_DEG))]))
    sizes, lows = _rectangles(hull, angles)
    areas = sizes[0] * sizes[1] + 1e-9 * sizes.sum(axis=0)
    near = np.flatnonzero(areas <= _FACE_SLACK * areas.min())
    some = points[:: max(1, len(points) // _FACE_POINTS), :2]
    scores = np.empty(len(near))
    for n, i in enumerate(near):
        c, s = cos(angles[i]), sin(angles[i])
        along, across = some[:, 0] * c + some[:, 1] * s - lows[0, i], some[:, 1] * c - some[:, 0] * s - lows[1, i]
        away = np.minimum(np.minimum(along, sizes[0, i] - along), np.minimum(across, sizes[1, i] - across))
        scores[n] = (1.0 / np.maximum(away, 2 * min_half_extent_m)).sum()
    return _upright_box(points, hull, float(angles[near[int(np.argmax(scores))]]), min_half_extent_m)


def _side_angles(hull: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the directions of a hull's sides, within a quarter of a turn."""
    edges = np.diff(np.vstack([hull, hull[:1]]), axis=0)
    return np.unique(np.mod(portable.arctan2(edges[:, 1], edges[:, 0]), np.pi / 2))


def _rectangles(
    hull: NDArray[np.float64], angles: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the (2, A) sizes along and across each of A directions, and where they begin."""
    c, s = portable.cos(angles), portable.sin(angles)
    along, across = portable.matmul(hull, np.stack([c, s])), portable.matmul(hull, np.stack([-s, c]))
    sizes = np.stack([np.ptp(along, axis=0), np.ptp(across, axis=0)])
    return sizes, np.stack([along.min(axis=0), across.min(axis=0)])


def _upright_box(
    points: NDArray[np.float64], hull: NDArray[np.float64], angle: float, min_half_extent_m: float
) -> OrientedBox:
    sizes, lows = _rectangles(hull, np.array([angle]))
    rotation = yaw_rotation(angle)
    z_low, z_high = _ends(points[:, 2])
    middle = portable.matmul(rotation, np.array([*(lows[:, 0] + sizes[:, 0] / 2), (z_low + z_high) / 2]))
    half = np.array([*sizes[:, 0], z_high - z_low]) / 2
    return OrientedBox(
        world_from_box=from_rotation_translation(rotation, middle),
        half_extents_m=np.maximum(half, min_half_extent_m),
    )


def box_iou(a: OrientedBox, b: OrientedBox) -> float:
    """Return the exact intersection over union of two oriented boxes."""
    shared = intersection_volume_m3(a, b)
    return shared / (a.volume_m3 + b.volume_m3 - shared)


def intersection_volume_m3(a: OrientedBox, b: OrientedBox, margin_m: float = 0.0) -> float:
    """Return the exact volume of the intersection of two boxes, both grown by a margin; 0.0 when they only touch."""
    half_a, half_b = a.half_extents_m + margin_m, b.half_extents_m + margin_m
    if _are_apart(a.world_from_box, half_a, b.world_from_box, half_b):
        return 0.0
    rotation_ab = portable.matmul(a.world_from_box[:3, :3].T, b.world_from_box[:3, :3])
    offset_ab = portable.matmul(a.world_from_box[:3, :3].T, b.center - a.center)
    shared = _intersection_volume(half_a, half_b, rotation_ab, offset_ab)
    return float(min(max(shared, 0.0), _volume_m3(half_a), _volume_m3(half_b)))


def _volume_m3(half_extents_m: NDArray[np.float64]) -> float:
    x, y, z = half_extents_m.tolist()
    return float(8.0 * (x * y * z))


@numba.njit(cache=True, nogil=True)
def _ends(values):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return the least and the greatest of at least one value; along a column NumPy takes several times as long."""
    low = high = values[0]
    for i in range(1, len(values)):
        low, high = min(low, values[i]), max(high, values[i])
    return low, high


@numba.njit(cache=True, nogil=True)
def _within(points, center, reach):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return the numbers of the points within a reach (3,) of a centre along each axis."""
    out = np.empty(len(points), dtype=np.int64)
    count = 0
    for i in range(len(points)):
        out[count] = i
        count += (
            (abs(points[i, 0] - center[0]) <= reach[0])
            & (abs(points[i, 1] - center[1]) <= reach[1])
            & (abs(points[i, 2] - center[2]) <= reach[2])
        )
    return out[:count]


@numba.njit(cache=True, nogil=True)
def _are_apart(world_from_a, half_a, world_from_b, half_b):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return whether the balls around two boxes are apart."""
    way, reach_a, reach_b = 0.0, 0.0, 0.0
    for i in range(3):
        way += (world_from_a[i, 3] - world_from_b[i, 3]) ** 2
        reach_a += half_a[i] ** 2
        reach_b += half_b[i] ** 2
    return np.sqrt(way) >= np.sqrt(reach_a) + np.sqrt(reach_b)


def _hull_2d(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the hull's corners in order, counter-clockwise; of collinear points the ends, of one the same twice."""
    outer = points[_may_be_corner(points)]
    corners = _monotone_chain(outer[np.lexsort((outer[:, 1], outer[:, 0]))])
    return corners if len(corners) > 1 else np.repeat(corners, 2, axis=0)


def _may_be_corner(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which points are not strictly inside the octagon of extreme points (Akl, Toussaint)."""
    corners = points[_extreme_in_eight(points)]
    edges = np.roll(corners, -1, axis=0) - corners
    edges, starts = edges[(edges != 0).any(axis=1)], corners[(edges != 0).any(axis=1)]
    if len(edges) == 0:
        return np.ones(len(points), dtype=bool)
    # Left of an edge: edge x (point - start) > 0, which is linear in the point.
    offsets = edges[:, 0] * starts[:, 1] - edges[:, 1] * starts[:, 0]
    return np.asarray(~_left_of_all(points, edges, offsets))


@numba.njit(cache=True, nogil=True)
def _extreme_in_eight(points):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return the (8,) numbers of the first points that are extreme in eight directions, counter-clockwise."""
    best = np.full(8, -np.inf)
    out = np.zeros(8, dtype=np.int64)
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        total, difference = x + y, x - y
        for k, value in enumerate((x, total, y, -difference, -x, -total, -y, difference)):
            if value > best[k]:
                best[k], out[k] = value, i
    return out


@numba.njit(cache=True, nogil=True)
def _left_of_all(points, edges, offsets):  # type: ignore[no-untyped-def] # pragma: no cover
    inside = np.ones(len(points), dtype=np.bool_)
    for i in range(len(points)):
        for k in range(len(edges)):
            if edges[k, 0] * points[i, 1] - edges[k, 1] * points[i, 0] <= offsets[k]:
                inside[i] = False
                break
    return inside


@numba.njit(cache=True, nogil=True)
def _monotone_chain(points):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return the convex hull of points sorted by x, then y (Andrew's monotone chain)."""
    count = len(points)
    hull = np.empty((2 * count + 1, 2))
    size = 0
    for sweep in range(2):
        start = size
        for k in range(count):
            p = points[k] if sweep == 0 else points[count - 1 - k]
            while size - start >= 2:
                a, b = hull[size - 2], hull[size - 1]
                if (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) > 0.0:
                    break
                size -= 1
            if size > start and hull[size - 1, 0] == p[0] and hull[size - 1, 1] == p[1]:
                continue
            hull[size] = p
            size += 1
        size -= 1  # the last point of a sweep is the first of the next
    return hull[: max(size, 1)].copy()


@numba.njit(cache=True, nogil=True)
def _clip(polygon, count, normal, offset, tolerance):  # type: ignore[no-untyped-def] # pragma: no cover
    """Keep the part of a convex polygon with normal . p <= offset + tolerance; in place, returns the new count."""
    out = np.empty_like(polygon)
    kept = 0
    for i in range(count):
        p, q = polygon[i], polygon[(i + 1) % count]
        dp = normal[0] * p[0] + normal[1] * p[1] + normal[2] * p[2] - offset - tolerance
        dq = normal[0] * q[0] + normal[1] * q[1] + normal[2] * q[2] - offset - tolerance
        if dp <= 0.0:
            out[kept] = p
            kept += 1
        if (dp < 0.0 < dq) or (dq < 0.0 < dp):
            out[kept] = p + (q - p) * (dp / (dp - dq))
            kept += 1
    polygon[:kept] = out[:kept]
    return kept


@numba.njit(cache=True, nogil=True)
def _cones(rotation, offset, half, other_rotation, other_offset, other_half, tolerance):  # type: ignore[no-untyped-def] # pragma: no cover
    """Sum the cones, seen from the origin, of the faces of one box that lie inside the other."""
    total = 0.0
    polygon = np.empty((16, 3))
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for sign in (-1.0, 1.0):
            normal = sign * np.ascontiguousarray(rotation[:, axis])
            middle = offset + normal * half[axis]
            for corner in range(4):
                du = half[u] if corner in (1, 2) else -half[u]
                dv = half[v] if corner in (2, 3) else -half[v]
                polygon[corner] = middle + rotation[:, u] * du + rotation[:, v] * dv
            count = 4
            for other_axis in range(3):
                for other_sign in (-1.0, 1.0):
                    plane = other_sign * np.ascontiguousarray(other_rotation[:, other_axis])
                    height = _dot(plane, other_offset) + other_half[other_axis]
                    if count:
                        count = _clip(polygon, count, plane, height, tolerance)
            area = np.zeros(3)
            for i in range(1, count - 1):
                area += 0.5 * np.cross(polygon[i] - polygon[0], polygon[i + 1] - polygon[0])
            total += abs(_dot(area, normal)) * _dot(normal, middle) / 3.0
    return total


@numba.njit(cache=True, nogil=True)
def _dot(a, b):  # type: ignore[no-untyped-def] # pragma: no cover
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True, nogil=True)
def _separated(half_a, half_b, rotation, offset, tolerance):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return whether a face direction of either box separates them, or leaves them only touching."""
    for i in range(3):
        reach_a = half_a[i] + (np.abs(rotation[i, :]) * half_b).sum()
        reach_b = half_b[i] + (np.abs(rotation[:, i]) * half_a).sum()
        distance_b = abs((offset * rotation[:, i]).sum())
        if abs(offset[i]) >= reach_a - tolerance or distance_b >= reach_b - tolerance:
            return True
    return False


@numba.njit(cache=True, nogil=True)
def _intersection_volume(half_a, half_b, rotation, offset):  # type: ignore[no-untyped-def] # pragma: no cover
    # A face that the boxes share (same plane, same side) must be counted once: the faces of a are clipped by b with a
    # small tolerance outwards, those of b by a with the same tolerance inwards.
    tolerance = 1e-10 * max(half_a.max(), half_b.max())
    if _separated(half_a, half_b, rotation, offset, 4.0 * tolerance):
        return 0.0
    identity, origin = np.eye(3), np.zeros(3)
    return _cones(identity, origin, half_a, rotation, offset, half_b, tolerance) + _cones(
        rotation, offset, half_b, identity, origin, half_a, -tolerance
    )
