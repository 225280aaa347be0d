"""Swept balls and boxes against superquadrics: both are convex, so they are disjoint if a plane separates them.

The core is the Minkowski sum of a segment and a box. Its distance to a primitive, the origin's to their Minkowski
difference, is found by the algorithm of Gilbert, Johnson and Keerthi (1988): a motion is free as soon as a plane
separates both by more than the ball's radius; the nearest point, an upper bound, proves a collision.
"""

import numpy as np

from hickory_stream.base.compiled import kernel
from hickory_stream.navigation.kernels import (
    AXES,
    CENTER,
    HIGH,
    HIT_SEEN,
    LOW,
    POWER_1,
    POWER_2,
    ROTATION,
    is_inside,
    touching,
)

# A motion with less than this clearance counts as a collision, so that the search ends.
NEAR_M = 1e-4
# Ten to twenty planes suffice for a micrometre.
_MOST_PLANES = 100
# A relative reserve of a separating plane, several orders of magnitude above the rounding error.
_ROUNDING = 1e-10


@kernel
def sweep_states(starts, ends, half, radius, rows, kinds, layout, top, values, links):
    """Return (N,) uint8: the most severe kind that a body touches between (N, 3) starts and ends, else FREE."""
    # The body is a box of half extents `half` (3), rounded by `radius`; a ball for half extents of 0.
    out = np.zeros(len(starts), np.uint8)
    way, local, edges = np.empty(3), np.empty((2, 3)), np.zeros((3, 3))
    simplex, nearest, direction = np.empty((4, 3)), np.empty(3), np.empty(3)
    seen = np.full(len(rows), -1, np.int64)
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    first, last = np.empty(3), np.empty(3)
    side = layout[3]
    for n in range(len(starts)):
        for axis in range(3):
            way[axis] = ends[n, axis] - starts[n, axis]
            first[axis] = min(starts[n, axis], ends[n, axis]) - half[axis] - radius
            last[axis] = max(starts[n, axis], ends[n, axis]) + half[axis] + radius
            low[axis] = max(int(np.floor((first[axis] - layout[axis]) / side)), 0)
            high[axis] = min(int(np.floor((last[axis] - layout[axis]) / side)), top.shape[axis] - 1)
        gravest = 0
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    item = top[i, j, k, 1]
                    while item >= 0 and gravest < HIT_SEEN:
                        index = values[item] >> 1
                        item = links[item]
                        if seen[index] == n or kinds[index] <= gravest:
                            continue
                        seen[index] = n
                        row = rows[index]
                        if (
                            row[LOW] > last[0]
                            or row[LOW + 1] > last[1]
                            or row[LOW + 2] > last[2]
                            or row[HIGH] < first[0]
                            or row[HIGH + 1] < first[1]
                            or row[HIGH + 2] < first[2]
                        ):
                            continue
                        if _passes_its_box(row, starts[n], way, half, radius, local, edges):
                            continue
                        t = _nearest_to_center(row, local)
                        x, y, z = (starts[n, 0] + t * way[0], starts[n, 1] + t * way[1], starts[n, 2] + t * way[2])
                        if is_inside(row, x, y, z) or _touches(
                            row, t, radius, local, edges, simplex, nearest, direction
                        ):
                            gravest = kinds[index]
        out[n] = gravest
    return out


@kernel
def _passes_its_box(row, start, way, half, radius, local, edges):
    # Fills `local`, the start and the way along the primitive's axes, and `edges`, the half edges of the swept box.
    for i in range(3):
        s, w, reach = 0.0, 0.0, radius
        for j in range(3):
            turn = row[ROTATION + 3 * j + i]
            s += turn * (start[j] - row[CENTER + j])
            w += turn * way[j]
            edges[j, i] = turn * half[j]
            reach += abs(edges[j, i])
        local[0, i], local[1, i] = s, w
        beyond = max(min(s, s + w), -max(s, s + w)) - reach
        if beyond > row[AXES + i] + _ROUNDING * (1.0 + abs(s) + abs(w)):
            return True
    return False


@kernel
def _nearest_to_center(row, local):
    # In units of the semi-axes.
    t, length = 0.0, 0.0
    for i in range(3):
        inverse = 1.0 / (row[AXES + i] * row[AXES + i])
        t -= local[0, i] * local[1, i] * inverse
        length += local[1, i] * local[1, i] * inverse
    return min(max(t / length, 0.0), 1.0) if length > 0.0 else 0.0


@kernel
def _touches(row, t, radius, local, edges, simplex, nearest, direction):
    size = 0.0
    # The first plane is that of an ellipsoid, from the point of the motion nearest to the primitive's centre.
    for i in range(3):
        size += abs(local[0, i]) + abs(local[1, i])
        direction[i] = (local[0, i] + t * local[1, i]) / row[AXES + i] ** 2
    count = 0
    for _ in range(_MOST_PLANES):
        ahead = _supported(row, local, edges, direction, simplex[count])
        slope = np.sqrt(direction[0] ** 2 + direction[1] ** 2 + direction[2] ** 2)
        if slope == 0.0:
            return True
        if ahead / slope > radius + _ROUNDING * (1.0 + size):
            return False
        count = _nearest_of_simplex(simplex, count + 1, nearest)
        if count == 0 or np.sqrt(nearest[0] ** 2 + nearest[1] ** 2 + nearest[2] ** 2) <= radius + NEAR_M:
            return True
        direction[:] = nearest
    return True


@kernel
def _supported(row, local, edges, direction, point):
    # The least direction . (x - y) over x of the core and y of the primitive; `point` is filled with x - y.
    x, y, z = direction[0], direction[1], direction[2]
    end = 1.0 if x * local[1, 0] + y * local[1, 1] + z * local[1, 2] < 0.0 else 0.0
    for i in range(3):
        point[i] = local[0, i] + end * local[1, i]
    for j in range(3):
        along = x * edges[j, 0] + y * edges[j, 1] + z * edges[j, 2]
        if along != 0.0:
            for i in range(3):
                point[i] -= edges[j, i] if along > 0.0 else -edges[j, i]
    s, t, u = abs(x) * row[AXES], abs(y) * row[AXES + 1], abs(z) * row[AXES + 2]
    a, b = touching(s, t, row[POWER_2])
    c, d = touching(a * s + b * t, u, row[POWER_1])
    point[0] -= c * a * row[AXES] if x > 0.0 else -c * a * row[AXES]
    point[1] -= c * b * row[AXES + 1] if y > 0.0 else -c * b * row[AXES + 1]
    point[2] -= d * row[AXES + 2] if z > 0.0 else -d * row[AXES + 2]
    return x * point[0] + y * point[1] + z * point[2]


@kernel
def _nearest_of_simplex(simplex, count, nearest):
    # Moves the points that span the nearest one to the front, returns their number; 0 if the origin is inside.
    if count == 1:
        nearest[:] = simplex[0]
        return 1
    if count == 2:
        return _nearest_of_edge(simplex, nearest)
    if count == 3:
        weights = _nearest_of_triangle(simplex[0], simplex[1], simplex[2])
        return _kept(simplex, (0, 1, 2), weights, nearest)
    best, chosen, best_weights = np.inf, (0, 1, 2), (1.0, 0.0, 0.0)
    is_inside = True
    for face in ((1, 2, 3, 0), (0, 2, 3, 1), (0, 1, 3, 2), (0, 1, 2, 3)):
        a, b, c, d = simplex[face[0]], simplex[face[1]], simplex[face[2]], simplex[face[3]]
        # For a flat tetrahedron, which has no inside, the last face is used.
        if _volume(a, b, c, d) * _volume_to_origin(a, b, c) > 0.0:
            continue
        is_inside = False
        weights = _nearest_of_triangle(a, b, c)
        squared = 0.0
        for i in range(3):
            squared += (weights[0] * a[i] + weights[1] * b[i] + weights[2] * c[i]) ** 2
        if squared < best:
            best, chosen, best_weights = squared, (face[0], face[1], face[2]), weights
    if is_inside:
        return 0
    return _kept(simplex, chosen, best_weights, nearest)


@kernel
def _nearest_of_edge(simplex, nearest):
    along, squared = 0.0, 0.0
    for i in range(3):
        edge = simplex[1, i] - simplex[0, i]
        along -= simplex[0, i] * edge
        squared += edge * edge
    if along <= 0.0:
        nearest[:] = simplex[0]
        return 1
    if along >= squared:
        simplex[0] = simplex[1]
        nearest[:] = simplex[0]
        return 1
    for i in range(3):
        nearest[i] = simplex[0, i] + along / squared * (simplex[1, i] - simplex[0, i])
    return 2


@kernel
def _kept(simplex, corners, weights, nearest):
    for i in range(3):
        nearest[i] = 0.0
        for m in range(3):
            nearest[i] += weights[m] * simplex[corners[m], i]
    count = 0
    # The corners are in ascending order, so that none is overwritten before it is moved.
    for m in range(3):
        if weights[m] > 0.0:
            for i in range(3):
                simplex[count, i] = simplex[corners[m], i]
            count += 1
    return count


@kernel
def _nearest_of_triangle(a, b, c):
    # Ericson (2005), Real-Time Collision Detection, 5.1.5.
    d1, d2, d3, d4, d5, d6 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(3):
        ab, ac = b[i] - a[i], c[i] - a[i]
        d1 -= ab * a[i]
        d2 -= ac * a[i]
        d3 -= ab * b[i]
        d4 -= ac * b[i]
        d5 -= ab * c[i]
        d6 -= ac * c[i]
    if d1 <= 0.0 and d2 <= 0.0:
        return 1.0, 0.0, 0.0
    if d3 >= 0.0 and d4 <= d3:
        return 0.0, 1.0, 0.0
    on_c = d1 * d4 - d3 * d2
    if on_c <= 0.0 and d1 >= 0.0 and d3 <= 0.0 and d1 > d3:
        return 1.0 - d1 / (d1 - d3), d1 / (d1 - d3), 0.0
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 0.0, 1.0
    on_b = d5 * d2 - d1 * d6
    if on_b <= 0.0 and d2 >= 0.0 and d6 <= 0.0 and d2 > d6:
        return 1.0 - d2 / (d2 - d6), 0.0, d2 / (d2 - d6)
    on_a = d3 * d6 - d5 * d4
    towards_c, towards_b = d4 - d3, d5 - d6
    if on_a <= 0.0 and towards_c >= 0.0 and towards_b >= 0.0 and towards_c + towards_b > 0.0:
        share = towards_c / (towards_c + towards_b)
        return 0.0, 1.0 - share, share
    total = on_a + on_b + on_c
    if total <= 0.0:
        return 1.0, 0.0, 0.0
    return on_a / total, on_b / total, on_c / total


@kernel
def _volume(a, b, c, d):
    x0, x1, x2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    y0, y1, y2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    z0, z1, z2 = d[0] - a[0], d[1] - a[1], d[2] - a[2]
    return x0 * (y1 * z2 - y2 * z1) - x1 * (y0 * z2 - y2 * z0) + x2 * (y0 * z1 - y1 * z0)


@kernel
def _volume_to_origin(a, b, c):
    x0, x1, x2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    y0, y1, y2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    return -a[0] * (x1 * y2 - x2 * y1) - a[1] * (x2 * y0 - x0 * y2) - a[2] * (x0 * y1 - x1 * y0)
