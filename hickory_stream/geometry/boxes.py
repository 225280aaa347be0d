"""Oriented boxes: the gravity-aligned box of minimum area, and the exact intersection of any two.

The boundary of an intersection consists of the faces of each box inside the other: clipping twelve squares and summing
their cones gives its volume exactly, without building the polyhedron.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable
from hickory_stream.geometry.arrays import freeze_all, read_only
from hickory_stream.geometry.portable_kernels import arctan2, cos, sin
from hickory_stream.geometry.rigid import apply

# A faced box is looked for in such steps, among rectangles this much larger than the smallest, with so many points.
_FACE_STEP_DEG = 2.0
_FACE_SLACK = 1.25
_FACE_POINTS = 800
# More than rounding takes off the reach of a box.
_SLACK_M = 1e-4
_CORNERS = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
"""The corners of a box, in half extents."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class OrientedBox:
    """A box: `world_from_box` (4, 4), its centre the origin of the box frame; `half_extents_m` (3,), all positive."""

    world_from_box: NDArray[np.float64]
    half_extents_m: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze_all(self, np.float64, world_from_box=(4, 4), half_extents_m=(3,))
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
        return apply(self.world_from_box, _CORNERS * self.half_extents_m)

    def contains(self, points_world: NDArray[Any], margin_m: float = 0.0) -> NDArray[np.bool_]:
        """Return for each of (N, 3) points whether it lies in the box grown by `margin_m`."""
        return self._holds(points_world, margin_m, is_column=False)

    def is_over_or_under(self, points_world: NDArray[Any], margin_m: float = 0.0) -> NDArray[np.bool_]:
        """Return for each of (N, 3) points whether it lies in the column of an upright box grown by `margin_m`."""
        return self._holds(points_world, margin_m, is_column=True)

    def _holds(self, points_world: NDArray[Any], margin_m: float, *, is_column: bool) -> NDArray[np.bool_]:
        limits = self.half_extents_m + margin_m
        return _held(read_only(points_world), self.world_from_box, limits, is_column)

    def grown(self, margin_m: float) -> "OrientedBox":
        """Return the box with every half extent larger by `margin_m`."""
        return OrientedBox(world_from_box=self.world_from_box, half_extents_m=self.half_extents_m + margin_m)


def gravity_aligned_box(points_world: NDArray[Any], min_half_extent_m: float) -> OrientedBox:
    """Return the upright box of minimum footprint around (N, 3) points, N >= 1; half extents are at least the minimum.

    Rotating calipers: a minimal rectangle shares a side with the convex hull.
    """
    points = np.asarray(points_world, dtype=np.float64)
    pose, half_extents_m = _smallest_upright(points, float(min_half_extent_m))
    return OrientedBox(world_from_box=pose, half_extents_m=half_extents_m)


def faced_box(points_world: NDArray[Any], min_half_extent_m: float) -> OrientedBox:
    """Return the upright box around (N, 3) points, N >= 1, whose sides the points lie along.

    A box seen from its front and a side has a triangular footprint, whose longest side has as small a rectangle as the
    true one. Of the rectangles hardly larger than the smallest, this has its sides closest to the points (closeness
    criterion of Zhang et al., Efficient L-Shape Fitting, 2017).
    """
    points = np.asarray(points_world, dtype=np.float64)
    hull = _hull_2d(points)
    angles = np.unique(np.concatenate([_side_angles(hull), np.deg2rad(np.arange(0, 90, _FACE_STEP_DEG))]))
    sizes, lows = _rectangles(hull, angles)
    areas = sizes[0] * sizes[1] + 1e-9 * sizes.sum(axis=0)
    near = np.flatnonzero(areas <= _FACE_SLACK * areas.min())
    some = points[:: max(1, len(points) // _FACE_POINTS), :2]
    scores = _closeness(read_only(some), angles[near], sizes[:, near], lows[:, near], 2 * float(min_half_extent_m))
    angle = float(angles[near[int(np.argmax(scores))]])
    pose, half_extents_m = _upright(points, hull, angle, float(min_half_extent_m))
    return OrientedBox(world_from_box=pose, half_extents_m=half_extents_m)


@kernel
def _closeness(points, angles, sizes, lows, least):
    scores = np.zeros(len(angles))
    for n in range(len(angles)):
        c, s = cos(angles[n]), sin(angles[n])
        for i in range(len(points)):
            along = points[i, 0] * c + points[i, 1] * s - lows[0, n]
            across = points[i, 1] * c - points[i, 0] * s - lows[1, n]
            away = min(along, sizes[0, n] - along, across, sizes[1, n] - across)
            scores[n] += 1.0 / max(away, least)
    return scores


def box_iou(a: OrientedBox, b: OrientedBox) -> float:
    """Return the exact intersection over union of two oriented boxes."""
    shared = intersection_volume_m3(a, b)
    return shared / (a.volume_m3 + b.volume_m3 - shared)


def intersection_volume_m3(a: OrientedBox, b: OrientedBox, margin_m: float = 0.0) -> float:
    """Return the exact volume of the intersection of two boxes, both grown by a margin; 0.0 when they only touch."""
    half_a, half_b = a.half_extents_m + margin_m, b.half_extents_m + margin_m
    if _are_apart(a.world_from_box, half_a, b.world_from_box, half_b):
        return 0.0
    shared = _shared_volume(a.world_from_box, half_a, b.world_from_box, half_b)
    return float(min(max(shared, 0.0), _volume_m3(half_a), _volume_m3(half_b)))


def _volume_m3(half_extents_m: NDArray[np.float64]) -> float:
    x, y, z = half_extents_m.tolist()
    return float(8.0 * (x * y * z))


@kernel
def _held(points, world_from_box, limits, is_column):
    r = world_from_box
    x0, y0, z0 = r[0, 3], r[1, 3], r[2, 3]
    # A first look at the upright, unturned box around it.
    reach = np.empty(3)
    for k in range(3):
        total = 0.0
        for axis in range(3):
            total += abs(r[k, axis]) * limits[axis]
        reach[k] = total + _SLACK_M
    level = np.empty(1, dtype=points.dtype)
    level[0] = z0
    out = np.zeros(len(points), dtype=np.bool_)
    for i in range(len(points)):
        z = level[0] if is_column else points[i, 2]
        x, y, z = points[i, 0] - x0, points[i, 1] - y0, z - z0
        if abs(x) <= reach[0] and abs(y) <= reach[1] and (is_column or abs(z) <= reach[2]):
            along = abs(x * r[0, 0] + y * r[1, 0] + z * r[2, 0])
            across = abs(x * r[0, 1] + y * r[1, 1] + z * r[2, 1])
            up = abs(x * r[0, 2] + y * r[1, 2] + z * r[2, 2])
            out[i] = (along <= limits[0]) & (across <= limits[1]) & (up <= limits[2])
    return out


@kernel
def _smallest_upright(points, min_half_extent):
    hull = _hull_2d(points)
    angles = _side_angles(hull)
    sizes, _ = _rectangles(hull, angles)
    # Of equal rectangles the one of the smallest angle.
    angle, least = 0.0, np.inf
    for i in range(len(angles)):
        area = sizes[0, i] * sizes[1, i] + 1e-9 * (sizes[0, i] + sizes[1, i])
        if area < least or (area == least and angles[i] < angle):
            angle, least = angles[i], area
    return _upright(points, hull, angle, min_half_extent)


@kernel
def _upright(points, hull, angle, min_half_extent):
    angles = np.empty(1)
    angles[0] = angle
    sizes, lows = _rectangles(hull, angles)
    z_low, z_high = points[0, 2], points[0, 2]
    for i in range(1, len(points)):
        z_low, z_high = min(z_low, points[i, 2]), max(z_high, points[i, 2])
    along, across, up = lows[0, 0] + sizes[0, 0] / 2, lows[1, 0] + sizes[1, 0] / 2, (z_low + z_high) / 2
    c, s = cos(angle), sin(angle)
    pose = np.zeros((4, 4))
    pose[0, 0], pose[0, 1], pose[1, 0], pose[1, 1], pose[2, 2], pose[3, 3] = c, -s, s, c, 1.0, 1.0
    for k in range(3):
        pose[k, 3] = 0.0 + pose[k, 0] * along + pose[k, 1] * across + pose[k, 2] * up
    half = np.empty(3)
    half[0], half[1], half[2] = sizes[0, 0] / 2, sizes[1, 0] / 2, (z_high - z_low) / 2
    for k in range(3):
        half[k] = max(half[k], min_half_extent)
    return pose, half


@kernel
def _side_angles(hull):
    angles = np.empty(len(hull))
    for i in range(len(hull)):
        j = i + 1 if i + 1 < len(hull) else 0
        # No zero with a sign.
        angles[i] = abs(arctan2(hull[j, 1] - hull[i, 1], hull[j, 0] - hull[i, 0]) % (np.pi / 2))
    return angles


@kernel
def _rectangles(hull, angles):
    # (2, A) sizes along and across each of A directions, and where they begin.
    sizes, lows = np.empty((2, len(angles))), np.empty((2, len(angles)))
    for n in range(len(angles)):
        c, s = cos(angles[n]), sin(angles[n])
        low, high, near, far = np.inf, -np.inf, np.inf, -np.inf
        for i in range(len(hull)):
            along = 0.0 + hull[i, 0] * c + hull[i, 1] * s
            across = 0.0 + hull[i, 0] * -s + hull[i, 1] * c
            low, high = min(low, along), max(high, along)
            near, far = min(near, across), max(far, across)
        sizes[0, n], lows[0, n], sizes[1, n], lows[1, n] = high - low, low, far - near, near
    return sizes, lows


@kernel
def _are_apart(world_from_a, half_a, world_from_b, half_b):
    way, reach_a, reach_b = 0.0, 0.0, 0.0
    for i in range(3):
        way += (world_from_a[i, 3] - world_from_b[i, 3]) ** 2
        reach_a += half_a[i] ** 2
        reach_b += half_b[i] ** 2
    return np.sqrt(way) >= np.sqrt(reach_a) + np.sqrt(reach_b)


@kernel
def _hull_2d(points):
    # Counter-clockwise; of collinear points the ends, of one the same twice.
    corners = _monotone_chain(_by_x_then_y(_outer(points)))
    if len(corners) > 1:
        return corners
    twice = np.empty((2, 2))
    for k in range(2):
        twice[k, 0], twice[k, 1] = corners[0, 0], corners[0, 1]
    return twice


@kernel
def _by_x_then_y(points):
    # Shell's method, in place: numba's own sort takes a second to compile.
    gap = len(points)
    while gap > 1:
        gap = max(1, gap * 5 // 11)
        for i in range(gap, len(points)):
            x, y = points[i, 0], points[i, 1]
            k = i
            while k >= gap and (points[k - gap, 0] > x or (points[k - gap, 0] == x and points[k - gap, 1] > y)):
                points[k, 0], points[k, 1] = points[k - gap, 0], points[k - gap, 1]
                k -= gap
            points[k, 0], points[k, 1] = x, y
    return points


@kernel
def _outer(points):
    # (M, 2) points that are not inside the octagon of extreme ones (Akl and Toussaint).
    extreme = _extreme_in_eight(points)
    edges, offsets = np.empty((8, 2)), np.empty(8)
    count = 0
    for k in range(8):
        i, j = extreme[k], extreme[(k + 1) & 7]
        x, y = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
        if x != 0.0 or y != 0.0:
            # Left of an edge: edge x (point - start) > 0, which is linear in the point.
            edges[count, 0], edges[count, 1], offsets[count] = x, y, x * points[i, 1] - y * points[i, 0]
            count += 1
    out = np.empty((len(points), 2))
    kept = 0
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        is_inside = count > 0
        for k in range(count):
            if edges[k, 0] * y - edges[k, 1] * x <= offsets[k]:
                is_inside = False
                break
        if not is_inside:
            out[kept, 0], out[kept, 1] = x, y
            kept += 1
    return out[:kept]


@kernel
def _extreme_in_eight(points):
    # (8,) first points that are extreme in eight directions, counter-clockwise.
    best = np.full(8, -np.inf)
    out = np.zeros(8, dtype=np.int64)
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        total, difference = x + y, x - y
        for k, value in enumerate((x, total, y, -difference, -x, -total, -y, difference)):
            if value > best[k]:
                best[k], out[k] = value, i
    return out


@kernel
def _monotone_chain(points):
    # Andrew's monotone chain over points sorted by x, then y.
    count = len(points)
    hull = np.empty((2 * count + 1, 2))
    size = 0
    for sweep in range(2):
        start = size
        for k in range(count):
            at = k if sweep == 0 else count - 1 - k
            x, y = points[at, 0], points[at, 1]
            while size - start >= 2:
                ax, ay, bx, by = hull[size - 2, 0], hull[size - 2, 1], hull[size - 1, 0], hull[size - 1, 1]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0.0:
                    break
                size -= 1
            if size > start and hull[size - 1, 0] == x and hull[size - 1, 1] == y:
                continue
            hull[size, 0], hull[size, 1] = x, y
            size += 1
        size -= 1  # the last point of a sweep is the first of the next
    return hull[: max(size, 1)]


@kernel
def _clip(polygon, out, count, n0, n1, n2, height, tolerance):
    # Keeps n . p <= height + tolerance, in place; `out` is room for as many corners; returns the new count.
    kept = 0
    for i in range(count):
        after = (i + 1) % count
        px, py, pz = polygon[i, 0], polygon[i, 1], polygon[i, 2]
        qx, qy, qz = polygon[after, 0], polygon[after, 1], polygon[after, 2]
        dp = n0 * px + n1 * py + n2 * pz - height - tolerance
        dq = n0 * qx + n1 * qy + n2 * qz - height - tolerance
        if dp <= 0.0:
            out[kept, 0], out[kept, 1], out[kept, 2] = px, py, pz
            kept += 1
        if (dp < 0.0 < dq) or (dq < 0.0 < dp):
            share = dp / (dp - dq)
            out[kept, 0], out[kept, 1] = px + (qx - px) * share, py + (qy - py) * share
            out[kept, 2] = pz + (qz - pz) * share
            kept += 1
    for i in range(kept):
        for axis in range(3):
            polygon[i, axis] = out[i, axis]
    return kept


@kernel
def _cones(rotation, offset, half, other_rotation, other_offset, other_half, tolerance):
    # The cones, seen from the origin, of the faces of one box that lie inside the other.
    total = 0.0
    polygon, room = np.empty((16, 3)), np.empty((16, 3))
    normal, middle, area = np.empty(3), np.empty(3), np.empty(3)
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for sign in (-1.0, 1.0):
            for i in range(3):
                normal[i] = sign * rotation[i, axis]
                middle[i] = offset[i] + normal[i] * half[axis]
            for corner in range(4):
                du = half[u] if corner == 1 or corner == 2 else -half[u]
                dv = half[v] if corner >= 2 else -half[v]
                for i in range(3):
                    polygon[corner, i] = middle[i] + rotation[i, u] * du + rotation[i, v] * dv
            count = 4
            for other_axis in range(3):
                for other_sign in (-1.0, 1.0):
                    n0, n1 = other_sign * other_rotation[0, other_axis], other_sign * other_rotation[1, other_axis]
                    n2 = other_sign * other_rotation[2, other_axis]
                    height = n0 * other_offset[0] + n1 * other_offset[1] + n2 * other_offset[2] + other_half[other_axis]
                    if count:
                        count = _clip(polygon, room, count, n0, n1, n2, height, tolerance)
            area[0], area[1], area[2] = 0.0, 0.0, 0.0
            for i in range(1, count - 1):
                for k in range(3):
                    after, beyond = (k + 1) % 3, (k + 2) % 3
                    au, av = polygon[i, after] - polygon[0, after], polygon[i, beyond] - polygon[0, beyond]
                    bu, bv = polygon[i + 1, after] - polygon[0, after], polygon[i + 1, beyond] - polygon[0, beyond]
                    area[k] += 0.5 * (au * bv - av * bu)
            facing = area[0] * normal[0] + area[1] * normal[1] + area[2] * normal[2]
            height = normal[0] * middle[0] + normal[1] * middle[1] + normal[2] * middle[2]
            total += abs(facing) * height / 3.0
    return total


@kernel
def _shared_volume(world_from_a, half_a, world_from_b, half_b):
    # A face that the boxes share (same plane, same side) must be counted once: the faces of a are clipped by b with a
    # small tolerance outwards, those of b by a with the same tolerance inwards.
    rotation, offset, identity, origin = np.empty((3, 3)), np.empty(3), np.empty((3, 3)), np.empty(3)
    a, b = world_from_a, world_from_b
    x, y, z = b[0, 3] - a[0, 3], b[1, 3] - a[1, 3], b[2, 3] - a[2, 3]
    tolerance = 0.0
    for i in range(3):
        for j in range(3):
            rotation[i, j] = a[0, i] * b[0, j] + a[1, i] * b[1, j] + a[2, i] * b[2, j]
            identity[i, j] = 1.0 if i == j else 0.0
        offset[i] = 0.0 + a[0, i] * x + a[1, i] * y + a[2, i] * z
        origin[i] = 0.0
        tolerance = max(tolerance, 1e-10 * half_a[i], 1e-10 * half_b[i])
    for i in range(3):
        reach_a, reach_b, along = 0.0, 0.0, 0.0
        for j in range(3):
            reach_a += abs(rotation[i, j]) * half_b[j]
            reach_b += abs(rotation[j, i]) * half_a[j]
            along += offset[j] * rotation[j, i]
        if (
            abs(offset[i]) >= half_a[i] + reach_a - 4.0 * tolerance
            or abs(along) >= half_b[i] + reach_b - 4.0 * tolerance
        ):
            return 0.0
    return _cones(identity, origin, half_a, rotation, offset, half_b, tolerance) + _cones(
        rotation, offset, half_b, identity, origin, half_a, -tolerance
    )
