"""Configuration-space obstacles: outlines on the floor of Minkowski sums of convex obstacles with a convex body.

A body at (x, y) collides with an obstacle if (x, y, 0) lies in the Minkowski sum of the obstacle and the mirrored body.
That sum is convex, and so is its slice at height 0: an outline. The slice has the support function

    h(d) = min over m of [support of the sum in the direction (d, m)],

since the slice is the sum cut by a plane (Lagrange). Every m gives a bound from above, so an outline that is made of
such bounds holds the whole slice, however early the search for m ends; the points where the sum is touched bound it
from below. Directions are added until outer and inner outline are within a tolerance of each other. No height is
sampled: a plate of a millimetre counts wherever in the band it lies.
"""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.navigation.kernels import AXES, CENTER, HIGH, LOW, POWER_1, POWER_2, ROTATION, touching
from hickory_stream.navigation.robot import Part

TOLERANCE_M = 0.002
_MOST = 96
_MOST_STEPS = 40
_STEEPEST = 1e6
# A row per direction while an outline is refined: x and y, the support, the touched point (2), the multiplier m.
_DX, _DY, _H, _PX, _PY, _M = 0, 1, 2, 3, 4, 5


def outlines_of_rows(
    rows: NDArray[np.float64], part: Part, tolerance_m: float = TOLERANCE_M
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the outlines of primitives (rows of `kernels`) for a part of a body.

    The corners (V, 2) of all outlines, and the index (N + 1,) at which each begins; one out of reach has no corners.
    """
    return _outlines(locked(rows), NO_HULLS, part.numbers, part.corners_m, tolerance_m)


def outlines_of_hulls(
    hulls: NDArray[np.float64], part: Part, tolerance_m: float = TOLERANCE_M
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the outlines of the convex hulls of (N, M, 3) points, as `outlines_of_rows` does."""
    return _outlines(NO_ROWS, locked(hulls), part.numbers, part.corners_m, tolerance_m)


def locked(array: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a contiguous read-only view: numba compiles a kernel once more for writable arrays."""
    view = np.ascontiguousarray(array, dtype=np.float64).view()
    view.flags.writeable = False
    return view


NO_ROWS, NO_HULLS = locked(np.empty((0, 25))), locked(np.empty((0, 1, 3)))


@kernel
def _outlines(rows, hulls, part, corners, tolerance):
    is_hull = len(hulls) > 0
    count = len(hulls) if is_hull else len(rows)
    out, starts = np.empty((max(16 * count, _MOST), 2)), np.zeros(count + 1, np.int64)
    found, after = np.empty((_MOST, 6)), np.empty(_MOST, np.int64)
    no_row, no_hull = np.empty(0), np.empty((0, 3))
    used = 0
    for i in range(count):
        row = no_row if is_hull else rows[i]
        hull = hulls[i] if is_hull else no_hull
        if used + _MOST > len(out):
            larger = np.empty((2 * len(out) + _MOST, 2))
            larger[:used] = out[:used]
            out = larger
        used += _outline(is_hull, row, hull, part, corners, tolerance, found, after, out[used:])
        starts[i + 1] = used
    return out[:used].copy(), starts


@kernel
def _outline(is_hull, row, hull, part, corners, tolerance, found, after, out):
    count = half_planes(is_hull, row, hull, part, corners, tolerance, found, after)
    corner = np.empty(2)
    i = 0
    for k in range(count):
        _meeting(found[i], found[after[i]], corner)
        out[k, 0], out[k, 1] = corner[0], corner[1]
        i = after[i]
    return count


@kernel
def half_planes(is_hull, row, hull, part, corners, tolerance, found, after):
    """Fill in the half planes of one outline and their successors, counter-clockwise from 0; return the number."""
    # 0 if the obstacle is out of reach. `found` (M, 6): a direction (2), the support along it, values for the search.
    if is_hull:
        low, high = hull[:, 2].min(), hull[:, 2].max()
    else:
        low, high = row[LOW + 2], row[HIGH + 2]
    if high + part[3] < part[0] or low - part[3] > part[1]:
        return 0
    # The first four directions are the axes of the primitive, which gives its faces at once.
    cx, cy = 1.0, 0.0
    if not is_hull:
        for axis in range(2):
            x, y = row[ROTATION + axis], row[ROTATION + 3 + axis]
            if x * x + y * y > 0.1:
                length = np.sqrt(x * x + y * y)
                cx, cy = x / length, y / length
                break
    count = 4
    for k in range(4):
        found[k, _DX], found[k, _DY] = cx, cy
        _touch_slice(is_hull, row, hull, part, corners, found[k], 0.0, 0.1 * tolerance)
        after[k] = (k + 1) % 4
        cx, cy = -cy, cx
    corner = np.empty(2)
    # Round by round, so that directions are distributed evenly if their number is not sufficient.
    before = 0
    while count > before:
        before = count
        i = 0
        while True:
            j = after[i]
            gap = _meeting(found[i], found[j], corner)
            if gap > tolerance and count < _MOST and _between(found[i], found[j], found[count]):
                guess = 0.5 * (found[i, _M] + found[j, _M])
                _touch_slice(is_hull, row, hull, part, corners, found[count], guess, 0.1 * tolerance)
                after[i], after[count] = count, j
                count += 1
            i = j
            if i == 0:
                break
    return count


@kernel
def _meeting(first, second, corner):
    # Fills in the intersection of two border lines; returns its distance beyond the chord of their touched points.
    cross = first[_DX] * second[_DY] - first[_DY] * second[_DX]
    corner[0] = (first[_H] * second[_DY] - second[_H] * first[_DY]) / cross
    corner[1] = (second[_H] * first[_DX] - first[_H] * second[_DX]) / cross
    ex, ey = second[_PX] - first[_PX], second[_PY] - first[_PY]
    gx, gy = corner[0] - first[_PX], corner[1] - first[_PY]
    length = np.sqrt(ex * ex + ey * ey)
    if length < 1e-9:
        return np.sqrt(gx * gx + gy * gy)
    return (gx * ey - gy * ex) / length


@kernel
def _between(first, second, new):
    # The normal of the chord of the touched points finds an edge at once.
    dx, dy = second[_PY] - first[_PY], first[_PX] - second[_PX]
    length = np.sqrt(dx * dx + dy * dy)
    if length > 1e-9:
        dx, dy = dx / length, dy / length
    if length <= 1e-9 or first[_DX] * dy - first[_DY] * dx < 1e-4 or dx * second[_DY] - dy * second[_DX] < 1e-4:
        dx, dy = first[_DX] + second[_DX], first[_DY] + second[_DY]
        length = np.sqrt(dx * dx + dy * dy)
        dx, dy = dx / length, dy / length
    new[_DX], new[_DY] = dx, dy
    return first[_DX] * dy - first[_DY] * dx > 1e-4


@kernel
def _touch_slice(is_hull, row, hull, part, corners, found, guess, tolerance):
    # Fills in a touched point and the multiplier; the support is at most `tolerance` too large, never too small.
    dx, dy = found[_DX], found[_DY]
    a, b, c = np.empty(4), np.empty(4), np.empty(4)
    _touch(is_hull, row, hull, part, corners, dx, dy, 0.0, a)
    # At m = 0 the height is not unique within the body's band: a[2] is that of the obstacle alone.
    if part[0] <= a[2] <= part[1]:
        found[_H], found[_PX], found[_PY], found[_M] = a[3], a[0], a[1], 0.0
        return
    is_above = a[2] > part[1]
    sign = -1.0 if is_above else 1.0
    a[2] -= part[1] if is_above else part[0]
    at_a, at_b = 0.0, guess if guess * sign > 0.0 else 0.05 * sign
    upper, best = a[3], 0.0
    while True:
        _touch(is_hull, row, hull, part, corners, dx, dy, at_b, b)
        if b[3] < upper:
            upper, best = b[3], at_b
        if b[2] * sign >= 0.0 or abs(at_b) > _STEEPEST:
            break
        a[:] = b
        at_a, at_b = at_b, 4.0 * at_b
    # The intersection of the tangents at both ends is a lower bound.
    for step in range(_MOST_STEPS):
        slope = b[2] - a[2]
        if slope * sign <= 0.0 or b[2] == 0.0 or b[2] * sign < 0.0:
            break
        at_c = (a[3] - b[3] + b[2] * at_b - a[2] * at_a) / slope
        lower = a[3] + a[2] * (at_c - at_a)
        if upper - lower <= tolerance:
            break
        if step % 3 == 2:
            at_c = 0.5 * (at_a + at_b)
        _touch(is_hull, row, hull, part, corners, dx, dy, at_c, c)
        if c[3] < upper:
            upper, best = c[3], at_c
        if c[2] * sign >= 0.0:
            b[:] = c
            at_b = at_c
        else:
            a[:] = c
            at_a = at_c
    found[_H], found[_M] = upper, best
    share = a[2] / (a[2] - b[2]) if a[2] != b[2] else 1.0
    share = min(max(share, 0.0), 1.0)
    found[_PX] = a[0] + share * (b[0] - a[0])
    found[_PY] = a[1] + share * (b[1] - a[1])


@kernel
def _touch(is_hull, row, hull, part, corners, dx, dy, m, out):
    # Fills in the point (3) where obstacle and mirrored body are touched along (dx, dy, m); for m = 0 the obstacle's
    # height.
    if is_hull:
        best = 0
        value = -np.inf
        for k in range(len(hull)):
            along = hull[k, 0] * dx + hull[k, 1] * dy + hull[k, 2] * m
            if along > value:
                best, value = k, along
        x, y, z = hull[best, 0], hull[best, 1], hull[best, 2]
    else:
        n0 = row[ROTATION] * dx + row[ROTATION + 3] * dy + row[ROTATION + 6] * m
        n1 = row[ROTATION + 1] * dx + row[ROTATION + 4] * dy + row[ROTATION + 7] * m
        n2 = row[ROTATION + 2] * dx + row[ROTATION + 5] * dy + row[ROTATION + 8] * m
        s0, s1, s2 = abs(n0) * row[AXES], abs(n1) * row[AXES + 1], abs(n2) * row[AXES + 2]
        u, v = touching(s0, s1, row[POWER_2])
        w, t = touching(u * s0 + v * s1, s2, row[POWER_1])
        q0 = w * u * row[AXES] * np.sign(n0)
        q1 = w * v * row[AXES + 1] * np.sign(n1)
        q2 = t * row[AXES + 2] * np.sign(n2)
        x = row[CENTER] + row[ROTATION] * q0 + row[ROTATION + 1] * q1 + row[ROTATION + 2] * q2
        y = row[CENTER + 1] + row[ROTATION + 3] * q0 + row[ROTATION + 4] * q1 + row[ROTATION + 5] * q2
        z = row[CENTER + 2] + row[ROTATION + 6] * q0 + row[ROTATION + 7] * q1 + row[ROTATION + 8] * q2
    # The mirrored body: its corners, a disc around each, a ball around those, from low to high.
    nearest = np.inf
    bx, by = 0.0, 0.0
    for k in range(len(corners)):
        along = corners[k, 0] * dx + corners[k, 1] * dy
        if along < nearest:
            nearest, bx, by = along, corners[k, 0], corners[k, 1]
    length = np.sqrt(1.0 + m * m)
    x += part[2] * dx + part[3] * dx / length - bx
    y += part[2] * dy + part[3] * dy / length - by
    if m > 0.0:
        z += part[3] * m / length - part[0]
    elif m < 0.0:
        z += part[3] * m / length - part[1]
    out[0], out[1], out[2] = x, y, z
    out[3] = x * dx + y * dy + (z * m if m != 0.0 else 0.0)


@kernel
def stamp(counts, corners, starts, origin, cell, delta):
    """Add `delta` to every cell that an outline touches, its closed square: whole cells, not their centres."""
    # `counts` (rows along y, columns along x); `origin` (2,) is its low corner.
    rows, columns = counts.shape
    left, right = np.empty(rows), np.empty(rows)
    for n in range(len(starts) - 1):
        first, last = starts[n], starts[n + 1]
        if first == last:
            continue
        # A tolerance: a border on the edge of a cell touches both of its neighbours.
        low = (corners[first:last, 1].min() - origin[1]) / cell - 1e-9
        high = (corners[first:last, 1].max() - origin[1]) / cell + 1e-9
        row_low, row_high = max(int(np.floor(low)), 0), min(int(np.floor(high)), rows - 1)
        for j in range(row_low, row_high + 1):
            left[j], right[j] = np.inf, -np.inf
        for k in range(first, last):
            following = k + 1 if k + 1 < last else first
            x0, y0 = (corners[k, 0] - origin[0]) / cell, (corners[k, 1] - origin[1]) / cell
            x1, y1 = (corners[following, 0] - origin[0]) / cell, (corners[following, 1] - origin[1]) / cell
            if y1 < y0:
                x0, y0, x1, y1 = x1, y1, x0, y0
            slope = (x1 - x0) / (y1 - y0) if y1 > y0 else 0.0
            for j in range(max(int(np.floor(y0 - 1e-9)), row_low), min(int(np.floor(y1 + 1e-9)), row_high) + 1):
                # The piece of this edge within the row.
                xa = x0 if y0 >= j else x0 + slope * (j - y0)
                xb = x1 if y1 <= j + 1 else x0 + slope * (j + 1 - y0)
                left[j] = min(left[j], xa, xb)
                right[j] = max(right[j], xa, xb)
        for j in range(row_low, row_high + 1):
            if left[j] <= right[j]:
                begin, end = max(int(np.floor(left[j] - 1e-9)), 0), min(int(np.floor(right[j] + 1e-9)), columns - 1)
                for i in range(begin, end + 1):
                    counts[j, i] += delta
