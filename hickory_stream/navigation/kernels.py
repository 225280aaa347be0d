"""Collision kernels over flat arrays: one row of numbers per primitive, and a two-level grid of nearby primitives.

A block lists the primitives near it and has a brick of cells with lists of their own. A cell stores for each primitive
whether it fills the cell: then no formula is evaluated.
"""

import numpy as np

from hickory_stream.base.compiled import kernel, numba

# A primitive is a row: centre (3), rotation row by row (9; columns are the local axes), semi-axes (3), 2/e1, 2/e2,
# e2/e1, e1/2, low corner of its bounds (3), high corner (3).
CENTER, ROTATION, AXES = 0, 3, 12
POWER_1, POWER_2, RATIO, GAUGE = 15, 16, 17, 18
LOW, HIGH = 19, 22
ROW = 25
# A block is a brick of 8 cells along each side.
SHIFT, MASK, CELLS = 3, 7, 8
# The states of the answers, in order of severity: the most severe one over all primitives is returned.
FREE, UNKNOWN, HIT_GENERATED, HIT_SEEN = 0, 1, 2, 3


@kernel
def _power(x, p):
    # x ** p for x in 0..2; simple shapes, the most frequent ones, have integer powers and need no logarithm.
    if p == 2.0:
        return x * x
    n = int(p)
    if n == p and n <= 32:
        result = 1.0
        while n:
            if n & 1:
                result *= x
            x *= x
            n >>= 1
        return result
    if x <= 0.0:
        return 0.0
    return np.exp(p * np.log(x))


@kernel
def is_inside(row, x, y, z):
    """Return whether G <= 1 at a point."""
    dx, dy, dz = x - row[CENTER], y - row[CENTER + 1], z - row[CENTER + 2]
    w = abs(row[ROTATION + 2] * dx + row[ROTATION + 5] * dy + row[ROTATION + 8] * dz) / row[AXES + 2]
    if w > 1.0:
        return False
    u = abs(row[ROTATION] * dx + row[ROTATION + 3] * dy + row[ROTATION + 6] * dz) / row[AXES]
    if u > 1.0:
        return False
    v = abs(row[ROTATION + 1] * dx + row[ROTATION + 4] * dy + row[ROTATION + 7] * dz) / row[AXES + 1]
    if v > 1.0:
        return False
    # Powers are expensive: a body with exponents up to 1 contains the ellipsoid of its axes; others are inside theirs.
    ball = u * u + v * v + w * w
    if row[POWER_1] >= 2.0 and row[POWER_2] >= 2.0:
        if ball <= 1.0:
            return True
    elif row[POWER_1] <= 2.0 and row[POWER_2] <= 2.0 and ball > 1.0:
        return False
    # No coordinate exceeds 1 here: nothing overflows, and what underflows is 0 as it should be.
    planar = _power(u, row[POWER_2]) + _power(v, row[POWER_2])
    if row[RATIO] != 1.0:
        planar = _power(planar, row[RATIO])
    return planar + _power(w, row[POWER_1]) <= 1.0


@kernel
def log_gauge(row, x, y, z, gradient):
    """Return ln h, h = G^(e1/2), at a point; fill its gradient in the world."""
    dx, dy, dz = x - row[CENTER], y - row[CENTER + 1], z - row[CENTER + 2]
    p0 = row[ROTATION] * dx + row[ROTATION + 3] * dy + row[ROTATION + 6] * dz
    p1 = row[ROTATION + 1] * dx + row[ROTATION + 4] * dy + row[ROTATION + 7] * dz
    p2 = row[ROTATION + 2] * dx + row[ROTATION + 5] * dy + row[ROTATION + 8] * dz
    tiny = 1e-9 * min(row[AXES], row[AXES + 1], row[AXES + 2])
    p0 = p0 if abs(p0) > tiny else tiny
    p1 = p1 if abs(p1) > tiny else tiny
    p2 = p2 if abs(p2) > tiny else tiny
    u, v = np.log(abs(p0) / row[AXES]), np.log(abs(p1) / row[AXES + 1])
    w = np.log(abs(p2) / row[AXES + 2])
    high = max(u, v)
    share_x, share_y = np.exp(row[POWER_2] * (u - high)), np.exp(row[POWER_2] * (v - high))
    total = share_x + share_y
    log_rho = high + np.log(total) / row[POWER_2]
    top = max(log_rho, w)
    share_r, share_z = np.exp(row[POWER_1] * (log_rho - top)), np.exp(row[POWER_1] * (w - top))
    whole = share_r + share_z
    g0 = share_r / whole * share_x / total / p0
    g1 = share_r / whole * share_y / total / p1
    g2 = share_z / whole / p2
    for i in range(3):
        at = ROTATION + 3 * i
        gradient[i] = row[at] * g0 + row[at + 1] * g1 + row[at + 2] * g2
    return top + row[GAUGE] * np.log(whole)


@kernel
def bound_outside(row, x, y, z, gradient):
    """Return a lower bound of the distance to a primitive, 0 inside."""
    # The larger of the distances to its box and to the tangent plane on the ray from the centre.
    dx, dy, dz = x - row[CENTER], y - row[CENTER + 1], z - row[CENTER + 2]
    squared = 0.0
    for i in range(3):
        along = row[ROTATION + i] * dx + row[ROTATION + 3 + i] * dy + row[ROTATION + 6 + i] * dz
        beyond = abs(along) - row[AXES + i]
        if beyond > 0.0:
            squared += beyond * beyond
    log_h = log_gauge(row, x, y, z, gradient)
    if log_h <= 0.0:
        return 0.0
    slope = np.sqrt(gradient[0] ** 2 + gradient[1] ** 2 + gradient[2] ** 2)
    # In d(ln h) the plane is at distance (1 - 1/h) / |grad ln h|, slightly reduced so that rounding is conservative.
    plane = (1.0 - np.exp(-log_h)) / slope
    return max(np.sqrt(squared), plane) * (1.0 - 1e-9)


@kernel
def exact_outside(row, x, y, z, gradient):
    """Return the distance to a primitive, 0 inside: its dual, the largest distance to a plane that it lies behind."""
    # The maximum over directions n of n . p - support(n). The ascent turns n towards the offset from the support point;
    # it ends where that offset is parallel to n.
    best = bound_outside(row, x, y, z, gradient)
    if best == 0.0:
        return 0.0
    dx, dy, dz = x - row[CENTER], y - row[CENTER + 1], z - row[CENTER + 2]
    p = np.empty(3)
    for i in range(3):
        p[i] = row[ROTATION + i] * dx + row[ROTATION + 3 + i] * dy + row[ROTATION + 6 + i] * dz
    # By symmetry in the first octant.
    p = np.abs(p)
    n, q = np.empty(3), np.empty(3)
    for i in range(3):
        along = (
            row[ROTATION + i] * gradient[0] + row[ROTATION + 3 + i] * gradient[1] + row[ROTATION + 6 + i] * gradient[2]
        )
        n[i] = abs(along)
    # The best of a net of directions, refined by shrinking nets around it: the dual is smooth, but nearly has edges for
    # boxes, on which gradient ascent stalls.
    value = _behind(row, p, n, q)
    first, second, trial = np.empty(3), np.empty(3), np.empty(3)
    for i in range(3):
        trial[i] = max(p[i] - row[AXES + i], 0.0)
    if trial.sum() > 0.0 and _behind(row, p, trial, q) > value:
        n[:] = trial
    n /= np.sqrt((n * n).sum())
    value = _behind(row, p, n, q)
    width = 0.6
    while width > 1e-7:
        least = int(np.argmin(n))
        first[:] = 0.0
        first[least] = 1.0
        first -= n[least] * n
        first /= np.sqrt((first * first).sum())
        second[0] = n[1] * first[2] - n[2] * first[1]
        second[1] = n[2] * first[0] - n[0] * first[2]
        second[2] = n[0] * first[1] - n[1] * first[0]
        # Towards the offset from the touching point, and eight directions around.
        _behind(row, p, n, q)
        improved = False
        for m in range(9):
            if m == 0:
                trial[:] = p - q
            else:
                c, s = _CIRCLE[m - 1, 0] * width, _CIRCLE[m - 1, 1] * width
                trial[:] = n + c * first + s * second
            trial[:] = np.abs(trial)
            length = np.sqrt((trial * trial).sum())
            if length == 0.0:
                continue
            trial /= length
            ahead = _behind(row, p, trial, q)
            if ahead > value:
                value, improved = ahead, True
                n[:] = trial
                break
        if not improved:
            width *= 0.35
    return max(best, value)


_CIRCLE = np.array([[np.cos(a), np.sin(a)] for a in np.arange(8) * np.pi / 4])


@kernel
def _behind(row, p, n, q):
    # The distance of p from the plane with normal n (>= 0) that touches the body, at q, which is filled.
    length = np.sqrt((n * n).sum())
    a, b = touching(row[AXES] * n[0], row[AXES + 1] * n[1], row[POWER_2])
    planar = a * row[AXES] * n[0] + b * row[AXES + 1] * n[1]
    c, d = touching(planar, row[AXES + 2] * n[2], row[POWER_1])
    q[0], q[1], q[2] = c * a * row[AXES], c * b * row[AXES + 1], d * row[AXES + 2]
    return (n[0] * (p[0] - q[0]) + n[1] * (p[1] - q[1]) + n[2] * (p[2] - q[2])) / length


@kernel
def touching(s, t, p):
    """Return the point (a, b) of a^p + b^p = 1, both >= 0, that is farthest along (s, t)."""
    largest, smallest = max(s, t), min(s, t)
    # The farthest point of a diamond (p = 1), the limit of the rest, is a corner.
    if largest <= 0.0 or p == 1.0:
        return (1.0, 0.0) if s >= t else (0.0, 1.0)
    b = smallest / largest
    if p == 2.0:
        norm = np.sqrt(1.0 + b * b)
    else:
        b **= 1.0 / (p - 1.0)
        norm = (1.0 + _power(b, p)) ** (1.0 / p)
    return (1.0 / norm, b / norm) if s >= t else (b / norm, 1.0 / norm)


@kernel
def inserted(row, index, layout, top, bricks, values, links, free_item):
    """Enter a primitive into the two grids; return the next free item (there must be enough), and the number used."""
    # `layout`: low corner of the grid (3), side of a block; `top` (X, Y, Z, 2): brick of a block (-1: none), head of
    # the list near it; `bricks` (B, 512): heads of the lists of cells. Lists are chains through `links`, -1 at the end;
    # a value is 2 * primitive, plus 1 where it fills the cell.
    side = layout[3]
    cell = side / CELLS
    gradient = np.empty(3)
    used = 0
    for i, j, k in blocks_of(row, layout, top.shape[:3]):
        x, y, z = layout[0] + i * side, layout[1] + j * side, layout[2] + k * side
        free_item = _chained(top[i, j, k], 1, 2 * index, values, links, free_item)
        used += 1
        brick = bricks[top[i, j, k, 0]]
        for n in range(CELLS * CELLS * CELLS):
            px = x + (n // (CELLS * CELLS) + 0.5) * cell
            py = y + (n // CELLS % CELLS + 0.5) * cell
            pz = z + (n % CELLS + 0.5) * cell
            if _far_from_box(row, px, py, pz, 0.5 * cell):
                continue
            # Half a cell's diagonal and a tolerance: a point on the border of two cells may be assigned to either.
            if bound_outside(row, px, py, pz, gradient) <= 0.867 * cell:
                filled = _fills(row, px, py, pz, 0.5 * cell)
                free_item = _chained(brick, n, 2 * index + filled, values, links, free_item)
                used += 1
    return free_item, used


@kernel
def blocks_of(row, layout, shape):
    """Return (M, 3) the blocks that a primitive may reach into."""
    side = layout[3]
    gradient, low, high = np.empty(3), np.empty(3, np.int64), np.empty(3, np.int64)
    for axis in range(3):
        low[axis] = max(int(np.floor((row[LOW + axis] - layout[axis]) / side)), 0)
        high[axis] = min(int(np.floor((row[HIGH + axis] - layout[axis]) / side)), shape[axis] - 1)
    out = np.empty((max((high - low + 1).prod(), 0), 3), np.int64)
    count = 0
    for i in range(low[0], high[0] + 1):
        for j in range(low[1], high[1] + 1):
            for k in range(low[2], high[2] + 1):
                x, y, z = layout[0] + (i + 0.5) * side, layout[1] + (j + 0.5) * side, layout[2] + (k + 0.5) * side
                if bound_outside(row, x, y, z, gradient) <= 0.867 * side:
                    out[count, 0], out[count, 1], out[count, 2] = i, j, k
                    count += 1
    return out[:count]


@kernel
def removed(row, index, layout, top, bricks, values, links, free_item):
    """Remove a primitive from the lists of its blocks; return the first free item, and the number of items freed."""
    released = 0
    for i, j, k in blocks_of(row, layout, top.shape[:3]):
        free_item, count = _unchained(top[i, j, k], 1, index, values, links, free_item)
        released += count
        brick = bricks[top[i, j, k, 0]]
        for n in range(CELLS * CELLS * CELLS):
            free_item, count = _unchained(brick, n, index, values, links, free_item)
            released += count
    return free_item, released


@kernel
def _chained(heads, at, value, values, links, free_item):
    after = links[free_item]
    values[free_item], links[free_item] = value, heads[at]
    heads[at] = free_item
    return after


@kernel
def _unchained(heads, at, index, values, links, free_item):
    before, item, count = -1, heads[at], 0
    while item >= 0:
        after = links[item]
        if values[item] >> 1 == index:
            if before < 0:
                heads[at] = after
            else:
                links[before] = after
            links[item] = free_item
            free_item = item
            count += 1
        else:
            before = item
        item = after
    return free_item, count


@kernel
def _far_from_box(row, x, y, z, half):
    return (
        x + half < row[LOW]
        or x - half > row[HIGH]
        or y + half < row[LOW + 1]
        or y - half > row[HIGH + 1]
        or z + half < row[LOW + 2]
        or z - half > row[HIGH + 2]
    )


@kernel
def _fills(row, x, y, z, half):
    half *= 1.0 + 1e-6
    for corner in range(8):
        dx = half if corner & 1 else -half
        dy = half if corner & 2 else -half
        dz = half if corner & 4 else -half
        if not is_inside(row, x + dx, y + dy, z + dz):
            return 0
    return 1


@kernel
def point_states(points, rows, kinds, layout, top, bricks, values, links):
    """Return (N,) uint8: FREE, or the most severe kind of the primitives that contain each of (N, 3) points."""
    out = np.zeros(len(points), np.uint8)
    _states(points, rows, kinds, layout, top, bricks, values, links, out, 0, len(points))
    return out


@kernel(parallel=True)
def point_states_parallel(points, rows, kinds, layout, top, bricks, values, links):
    """Return what `point_states` returns, on all cores."""
    out = np.zeros(len(points), np.uint8)
    block = 8192
    for b in numba.prange((len(points) + block - 1) // block):
        last = min((b + 1) * block, len(points))
        _states(points, rows, kinds, layout, top, bricks, values, links, out, b * block, last)
    return out


@kernel
def _states(points, rows, kinds, layout, top, bricks, values, links, out, first, last):
    inverse = CELLS / layout[3]
    ox, oy, oz = layout[0], layout[1], layout[2]
    nx, ny, nz = top.shape[0] * CELLS, top.shape[1] * CELLS, top.shape[2] * CELLS
    for n in range(first, last):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        fx, fy, fz = (x - ox) * inverse, (y - oy) * inverse, (z - oz) * inverse
        if not (fx >= 0.0 and fy >= 0.0 and fz >= 0.0 and fx < nx and fy < ny and fz < nz):
            continue
        i, j, k = int(fx), int(fy), int(fz)
        brick = top[i >> SHIFT, j >> SHIFT, k >> SHIFT, 0]
        if brick < 0:
            continue
        item = bricks[brick, ((i & MASK) << 2 * SHIFT) | ((j & MASK) << SHIFT) | (k & MASK)]
        gravest = 0
        while item >= 0:
            value = values[item]
            kind = kinds[value >> 1]
            if kind > gravest and (value & 1 or is_inside(rows[value >> 1], x, y, z)):
                gravest = kind
                if gravest == HIT_SEEN:
                    break
            item = links[item]
        out[n] = gravest


@kernel
def clearances(points, rows, is_exact, reach, layout, top, values, links):
    """Return (N,) the distance to the nearest primitive, or a lower bound of it, truncated at `reach`."""
    out = np.empty(len(points))
    gradient = np.empty(3)
    seen = np.full(len(rows), -1, np.int64)
    side = layout[3]
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        best = reach
        looked = 0.0
        while looked < best:
            # A cube of blocks around the point, doubled until nothing nearer can lie outside of it.
            looked = min(max(2.0 * looked, 0.5 * side), best)
            for axis in range(3):
                low[axis] = max(int(np.floor((points[n, axis] - looked - layout[axis]) / side)), 0)
                high[axis] = min(int(np.floor((points[n, axis] + looked - layout[axis]) / side)), top.shape[axis] - 1)
            for i in range(low[0], high[0] + 1):
                for j in range(low[1], high[1] + 1):
                    for k in range(low[2], high[2] + 1):
                        item = top[i, j, k, 1]
                        while item >= 0:
                            row = values[item] >> 1
                            if seen[row] != n and _box_distance(rows[row], x, y, z) < best:
                                seen[row] = n
                                if is_exact:
                                    best = min(best, exact_outside(rows[row], x, y, z, gradient))
                                else:
                                    best = min(best, bound_outside(rows[row], x, y, z, gradient))
                            item = links[item]
        out[n] = best
    return out


@kernel
def _box_distance(row, x, y, z):
    dx = max(row[LOW] - x, 0.0, x - row[HIGH])
    dy = max(row[LOW + 1] - y, 0.0, y - row[HIGH + 1])
    dz = max(row[LOW + 2] - z, 0.0, z - row[HIGH + 2])
    return np.sqrt(dx * dx + dy * dy + dz * dz)
