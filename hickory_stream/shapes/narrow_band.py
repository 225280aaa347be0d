"""Distances to a triangle for all cells near it, a block of cells at a time.

Bounds exclude most cells, and cells do not depend on one another: each step goes through all cells of a triangle before
the next one begins, without branches, so that the compiler can vectorise it. A block is one array with columns of
`_ROOM` numbers each, so that the compiler knows that no two columns overlap.
"""

from __future__ import annotations

import numpy as np

from hickory_stream.base.compiled import kernel

_ROOM = 512
# The columns: cells, their squared distances so far, and whether the triangle may be nearer.
_X, _Y, _Z, _KNOWN, _IS_NEAR = 0, _ROOM, 2 * _ROOM, 3 * _ROOM, 4 * _ROOM
# The same columns for those to which it may be, moved together; their squared distances and nearest points.
_NEAR_X, _NEAR_Y, _NEAR_Z, _NEAR_KNOWN = 5 * _ROOM, 6 * _ROOM, 7 * _ROOM, 8 * _ROOM
_SQUARED, _ALONG_AB, _ALONG_AC = 9 * _ROOM, 10 * _ROOM, 11 * _ROOM
_COLUMNS = 12


@kernel(error_model="numpy")
def lower_to_distances(corners, inside, squared, band):
    """Lower `squared` to the squared distance to the nearest triangle, for cells within `band` of one.

    Only the surface of the solid counts; surface of one part inside another is skipped. `corners` (F, 3, 3) and `band`
    in cells; `squared` (nx, ny, nz) float32 in C order, at most the square of the band.
    """
    _, size_y, size_z = squared.shape
    cells = squared.reshape(-1)
    block, where, near_where = np.ones(_COLUMNS * _ROOM), np.empty(_ROOM, np.int64), np.empty(_ROOM, np.int64)
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    nearest, normal, middle = np.empty(3), np.empty(3), np.empty(3)
    for f in range(corners.shape[0]):
        t = corners[f]
        if not unit_normal(t, normal):
            continue
        a = (t[0, 0], t[0, 1], t[0, 2])
        ab = (t[1, 0] - t[0, 0], t[1, 1] - t[0, 1], t[1, 2] - t[0, 2])
        ac = (t[2, 0] - t[0, 0], t[2, 1] - t[0, 1], t[2, 2] - t[0, 2])
        radius2 = 0.0
        for axis in range(3):
            middle[axis] = (t[0, axis] + t[1, axis] + t[2, axis]) / 3.0
        for corner in range(3):
            x, y, z = t[corner, 0] - middle[0], t[corner, 1] - middle[1], t[corner, 2] - middle[2]
            radius2 = max(radius2, x * x + y * y + z * z)
        for axis in range(3):
            low[axis] = max(int(np.ceil(min(t[0, axis], t[1, axis], t[2, axis]) - band)), 0)
            high[axis] = min(int(np.floor(max(t[0, axis], t[1, axis], t[2, axis]) + band)), squared.shape[axis] - 1)
        # Rows that pass the bounding ball by more than the band have no cell within it.
        reach2 = (np.sqrt(radius2) + band) ** 2 * (1.0 + 1e-6)
        count = 0
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                if (i - middle[0]) ** 2 + (j - middle[1]) ** 2 >= reach2:
                    continue
                row = (i * size_y + j) * size_z
                for k in range(low[2], high[2] + 1):
                    block[_X + count], block[_Y + count], block[_Z + count] = i, j, k
                    block[_KNOWN + count] = cells[row + k]
                    where[count] = row + k
                    count += 1
                    if count == _ROOM:
                        num_near = _gather_near(block, where, near_where, count, normal, middle, radius2)
                        _fill_squared(block, num_near, a, ab, ac)
                        _lower(cells, block, near_where, num_near, a, ab, ac, inside, normal, nearest)
                        count = 0
        num_near = _gather_near(block, where, near_where, count, normal, middle, radius2)
        _fill_squared(block, num_near, a, ab, ac)
        _lower(cells, block, near_where, num_near, a, ab, ac, inside, normal, nearest)


@kernel(error_model="numpy")
def _gather_near(block, where, near_where, count, normal, middle, radius2):
    """Move the cells together that a triangle may be nearer to; return their number.

    The distances to the triangle's plane and bounding ball are lower bounds.
    """
    n0, n1, n2, m0, m1, m2 = normal[0], normal[1], normal[2], middle[0], middle[1], middle[2]
    for n in range(count):
        x, y, z = block[_X + n] - m0, block[_Y + n] - m1, block[_Z + n] - m2
        known = (1.0 - 1e-5) * block[_KNOWN + n]
        out = n0 * x + n1 * y + n2 * z
        away = x * x + y * y + z * z
        slack = away + radius2 - known
        is_far = (out * out >= known) | ((away > radius2) & (slack > 0.0) & (slack * slack >= 4.0 * radius2 * away))
        block[_IS_NEAR + n] = 0.0 if is_far else 1.0
    num_near = 0
    for n in range(count):
        m = num_near
        block[_NEAR_X + m], block[_NEAR_Y + m], block[_NEAR_Z + m] = block[_X + n], block[_Y + n], block[_Z + n]
        block[_NEAR_KNOWN + m] = block[_KNOWN + n]
        near_where[m] = where[n]
        num_near += int(block[_IS_NEAR + n])
    return num_near


@kernel(error_model="numpy")
def _fill_squared(block, count, a, ab, ac):
    """Fill in the squared distances to a triangle, and the coordinates v, w of its nearest points a + v ab + w ac.

    From Ericson, Real-Time Collision Detection (2005), 5.1.5.
    """
    a0, a1, a2 = a
    abx, aby, abz = ab
    acx, acy, acz = ac
    bb, bc, cc = (
        abx * abx + aby * aby + abz * abz,
        abx * acx + aby * acy + abz * acz,
        acx * acx + acy * acy + acz * acz,
    )
    for n in range(count):
        apx, apy, apz = block[_NEAR_X + n] - a0, block[_NEAR_Y + n] - a1, block[_NEAR_Z + n] - a2
        d1 = abx * apx + aby * apy + abz * apz
        d2 = acx * apx + acy * apy + acz * apz
        d3, d4 = d1 - bb, d2 - bc
        d5, d6 = d1 - bc, d2 - cc
        vc, vb, va = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
        at_a = (d1 <= 0.0) & (d2 <= 0.0)
        at_b = (d3 >= 0.0) & (d4 <= d3)
        at_c = (d6 >= 0.0) & (d5 <= d6)
        on_ab = (vc <= 0.0) & (d1 >= 0.0) & (d3 <= 0.0)
        on_ac = (vb <= 0.0) & (d2 >= 0.0) & (d6 <= 0.0)
        on_bc = (va <= 0.0) & (d4 - d3 >= 0.0) & (d5 - d6 >= 0.0)
        part = d1 if on_ab else (d2 if on_ac else (d4 - d3 if on_bc else 1.0))
        whole = d1 - d3 if on_ab else (d2 - d6 if on_ac else ((d4 - d3) + (d5 - d6) if on_bc else va + vb + vc))
        share = part / max(whole, 1e-30)
        v = share if on_ab else (0.0 if on_ac else (1.0 - share if on_bc else vb * share))
        w = 0.0 if on_ab else (share if (on_ac | on_bc) else vc * share)
        v = 0.0 if at_a else (1.0 if at_b else (0.0 if at_c else v))
        w = 0.0 if (at_a | at_b) else (1.0 if at_c else w)
        ex = apx - v * abx - w * acx
        ey = apy - v * aby - w * acy
        ez = apz - v * abz - w * acz
        block[_SQUARED + n] = ex * ex + ey * ey + ez * ez
        block[_ALONG_AB + n] = v
        block[_ALONG_AC + n] = w


@kernel(error_model="numpy")
def _lower(cells, block, where, count, a, ab, ac, inside, normal, nearest):
    for n in range(count):
        if block[_SQUARED + n] >= block[_NEAR_KNOWN + n]:
            continue
        v, w = block[_ALONG_AB + n], block[_ALONG_AC + n]
        for axis in range(3):
            nearest[axis] = a[axis] + v * ab[axis] + w * ac[axis]
        if not is_buried(inside, nearest, normal):
            cells[where[n]] = block[_SQUARED + n]


@kernel
def unit_normal(t, normal):
    """Fill the unit normal of a triangle; return whether it has one."""
    ax, ay, az = t[1, 0] - t[0, 0], t[1, 1] - t[0, 1], t[1, 2] - t[0, 2]
    bx, by, bz = t[2, 0] - t[0, 0], t[2, 1] - t[0, 1], t[2, 2] - t[0, 2]
    normal[0], normal[1], normal[2] = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    length = np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    if length < 1e-12:
        return False
    normal /= length
    return True


@kernel
def is_buried(inside, point, normal):
    """Return whether the solid continues on both sides of a point of a triangle, at most of a cell's distance."""
    for side in (-0.75, 0.75):
        i = int(np.floor(point[0] + side * normal[0] + 0.5))
        j = int(np.floor(point[1] + side * normal[1] + 0.5))
        k = int(np.floor(point[2] + side * normal[2] + 0.5))
        if i < 0 or j < 0 or k < 0 or i >= inside.shape[0] or j >= inside.shape[1] or k >= inside.shape[2]:
            return False
        if not inside[i, j, k]:
            return False
    return True
