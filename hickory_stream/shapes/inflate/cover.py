"""The kernels of inflation: the smallest semi-axes with which a superquadric contains given balls.

A superquadric with exponents up to 2 is convex, and symmetric in its local planes: it contains the ball of radius r
around p if it contains |p| + c r d for a net of directions d in the first octant, where c >= 1 makes the net's facets
enclose the octant of the sphere: 21 points for each corner of a triangle, without a bound on curvature.

In the logarithms of the semi-axes ln h (h = G^(e1/2)) is convex and that of the volume linear: the smallest primitive
around given points is a convex problem in two unknowns, the ratios, since the scale follows from the worst point.

A body that contains a point contains all points no farther from any of its planes: only the maximal points count, of
8,000 vertices about 200. They are found from the farthest along x, with a staircase: y rises along it, and z falls.
"""

from __future__ import annotations

import numpy as np

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.portable_kernels import exp, exp_each, log, log1p

# Subdivisions n per side of the net of directions over the octant: (n + 1)(n + 2) / 2 directions.
_NET = 5
# tan(k pi / 4 / 5)^0.86: about equal steps of angle along the sides make the facets nearly equal.
_STEPS = (0.0, 0.204999481350814, 0.380300934986841, 0.559967288272018, 0.759774117910865, 1.0)
_TINY = 1e-12
_LOG_2 = 0.6931471805599453


def _net() -> tuple[np.ndarray, float]:
    # (M, 3) unit directions, and the factor c that lets the net's facets enclose the octant.
    places = [(i, j) for i in range(_NET + 1) for j in range(_NET + 1 - i)]
    directions = np.array([[_STEPS[i], _STEPS[j], _STEPS[_NET - i - j]] for i, j in places])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    index = {place: n for n, place in enumerate(places)}
    nearest = 1.0
    for i, j in places:
        for corners in (((i, j), (i + 1, j), (i, j + 1)), ((i + 1, j), (i + 1, j + 1), (i, j + 1))):
            if all(corner in index for corner in corners):
                a, b, c = (directions[index[corner]] for corner in corners)
                normal = np.cross(b - a, c - a)
                nearest = min(nearest, abs(float((normal * a).sum())) / float(np.sqrt((normal * normal).sum())))
    return directions, 1.0 / nearest


NET, _factor = _net()
NET_FACTOR = _factor * (1 + 1e-12)


@kernel
def log_gauge(x, y, z, axes, e1, e2):
    """Return ln h at a local point with coordinates of at least 0; `axes` are semi-axes, three numbers."""
    u, v, w = log(max(x / axes[0], 1e-200)), log(max(y / axes[1], 1e-200)), log(max(z / axes[2], 1e-200))
    high = max(u, v)
    log_rho = high + 0.5 * e2 * log1p(exp(2.0 / e2 * (min(u, v) - high)))
    top = max(log_rho, w)
    return top + 0.5 * e1 * log1p(exp(2.0 / e1 * (min(log_rho, w) - top)))


@kernel
def log_gauge_of_ball(x, y, z, radius, axes, e1, e2, limit, net, factor):
    """Return an upper bound of ln h over a ball around a local point, exact enough to tell whether it is <= limit."""
    # Beyond the limit, the first value found above it.
    corner = log_gauge(x + radius, y + radius, z + radius, axes, e1, e2)
    if corner <= limit or radius == 0.0:
        return corner
    return _worst_over_net(x, y, z, radius * factor, axes, e1, e2, limit, net)


@kernel
def _worst_over_net(x, y, z, r, axes, e1, e2, limit, net):
    worst = -1e300
    for m in range(len(net)):
        value = log_gauge(x + r * net[m, 0], y + r * net[m, 1], z + r * net[m, 2], axes, e1, e2)
        if value > worst:
            worst = value
            if worst > limit:
                break
    return worst


@kernel
def least_axes(points, before, e1, e2, limit):
    """Return the semi-axes of about the least volume, none below `before`, with ln h <= limit at (N, 3) points >= 0."""
    # A simplex search over the two ratios of the axes. Containment is exact: the scale follows from the worst point.
    logs = np.empty((len(points), 3))
    for n in range(len(points)):
        for i in range(3):
            logs[n, i] = log(max(points[n, i], 1e-200))
    floor = np.array([log(before[0]), log(before[1]), log(before[2])])
    best = _scaled(logs, floor, floor, e1, e2, limit)
    if (best <= floor + 1e-12).all():
        return before.copy()
    extent = np.empty(3)
    for i in range(3):
        extent[i] = max(logs[:, i].max(), floor[i])
    by_extent = _scaled(logs, extent, floor, e1, e2, limit)
    start = by_extent if by_extent.sum() < best.sum() else best
    # Vertices of the simplex: log ratios of y and z to x.
    simplex = np.empty((3, 2))
    values = np.empty(3)
    for n in range(3):
        simplex[n, 0] = start[1] - start[0] + (0.3 if n == 1 else 0.0)
        simplex[n, 1] = start[2] - start[0] + (0.3 if n == 2 else 0.0)
        values[n] = _size(simplex[n], logs, floor, e1, e2, limit)
    for _ in range(50):
        order = np.argsort(values)
        simplex, values = simplex[order], values[order]
        if values[2] - values[0] < 2e-4:
            break
        middle = 0.5 * (simplex[0] + simplex[1])
        mirrored = 2.0 * middle - simplex[2]
        value = _size(mirrored, logs, floor, e1, e2, limit)
        if value < values[0]:
            further = 3.0 * middle - 2.0 * simplex[2]
            other = _size(further, logs, floor, e1, e2, limit)
            if other < value:
                mirrored, value = further, other
        elif value >= values[1]:
            mirrored = 0.5 * (middle + simplex[2])
            value = _size(mirrored, logs, floor, e1, e2, limit)
            if value >= values[2]:
                for n in range(1, 3):
                    simplex[n] = 0.5 * (simplex[0] + simplex[n])
                    values[n] = _size(simplex[n], logs, floor, e1, e2, limit)
                continue
        simplex[2], values[2] = mirrored, value
    n = int(np.argmin(values))
    ratios = np.array([0.0, simplex[n, 0], simplex[n, 1]])
    found = _scaled(logs, ratios, floor, e1, e2, limit)
    return exp_each(found if found.sum() < start.sum() else start)


@kernel
def _size(ratios, logs, floor, e1, e2, limit):
    return _scaled(logs, np.array([0.0, ratios[0], ratios[1]]), floor, e1, e2, limit).sum()


@kernel
def _scaled(logs, axes, floor, e1, e2, limit):
    # Log axes of these ratios at the scale that holds all points, raised to the floor.
    worst = -1e300
    for n in range(len(logs)):
        u, v, w = logs[n, 0] - axes[0], logs[n, 1] - axes[1], logs[n, 2] - axes[2]
        high = max(u, v)
        log_rho = high + 0.5 * e2 * log1p(exp(2.0 / e2 * (min(u, v) - high)))
        top = max(log_rho, w)
        worst = max(worst, top + 0.5 * e1 * log1p(exp(2.0 / e1 * (min(log_rho, w) - top))))
    return np.maximum(axes + (worst - limit), floor)


@kernel
def local_abs(points, pose):
    """Return (N, 3) absolute local coordinates of world points in a (4, 4) pose."""
    out = np.empty((len(points), 3))
    for n in range(len(points)):
        dx, dy, dz = points[n, 0] - pose[0, 3], points[n, 1] - pose[1, 3], points[n, 2] - pose[2, 3]
        for i in range(3):
            out[n, i] = abs(pose[0, i] * dx + pose[1, i] * dy + pose[2, i] * dz)
    return out


@kernel
def extremes(points, directions):
    """Return which of (N, 3) points are the farthest in any of the directions."""
    chosen = np.zeros(len(points), np.bool_)
    for m in range(len(directions)):
        best, at = -1e300, 0
        for n in range(len(points)):
            reach = points[n, 0] * directions[m, 0] + points[n, 1] * directions[m, 1] + points[n, 2] * directions[m, 2]
            if reach > best:
                best, at = reach, n
        chosen[at] = True
    return chosen


@kernel
def with_net(points, radii, net, factor):
    """Return the points that represent balls: (N, 3) centres >= 0 moved along the net; only the centre for radius 0."""
    out = np.empty((len(points) * len(net), 3))
    count = 0
    for n in range(len(points)):
        for m in range(len(net) if radii[n] > 0.0 else 1):
            for i in range(3):
                out[count, i] = points[n, i] + radii[n] * factor * (net[m, i] if radii[n] > 0.0 else 0.0)
            count += 1
    return out[:count]


@kernel
def worst_balls(points, radii, axes, e1, e2, limit, net, factor, most):
    """Return up to `most` of the balls that protrude, evenly spread over all of these, and their number."""
    out = np.empty(len(points), np.int64)
    count = 0
    sizes = (axes[0], axes[1], axes[2])
    # Most balls need no logarithm: h lies between the largest share of a semi-axis and 2^((e1 + e2) / 2) times that.
    out_from = exp(limit) * (1.0 + 1e-9)
    in_up_to = exp(limit - 0.5 * (e1 + e2) * _LOG_2) * (1.0 - 1e-9)
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        r = radii[n]
        if max((x + r) / axes[0], (y + r) / axes[1], (z + r) / axes[2]) <= in_up_to:
            continue
        is_out = max(x / axes[0], y / axes[1], z / axes[2]) > out_from
        if is_out or log_gauge_of_ball(x, y, z, radii[n], sizes, e1, e2, limit, net, factor) > limit:
            out[count] = n
            count += 1
    step = max(count // most, 1)
    return out[:count:step].copy(), count


@kernel
def undominated(points):
    """Return (N,) which of (N, 3) points, of coordinates of at least 0, have no other one beyond them in all three."""
    # Of equal points at least one is kept.
    kept = np.zeros(len(points), np.bool_)
    stairs = new_stairs(len(points))
    count = 0
    for n in np.argsort(-points[:, 0], kind="mergesort"):
        at = place_of(stairs, count, points[n, 1])
        if at < count and stairs[at, 1] >= points[n, 2]:
            continue
        kept[n] = True
        count = put(stairs, count, at, points[n, 1], points[n, 2], 0.0)
    return kept


@kernel
def new_stairs(most):
    """Return (most, 3) room for the steps of a staircase: y, z, and a number that goes with them."""
    return np.empty((most, 3))


@kernel
def place_of(stairs, count, y):
    """Return the first of `count` steps that reaches as far along y: if any dominates a point there, it does."""
    low, high = 0, count
    while low < high:
        middle = (low + high) // 2
        if stairs[middle, 0] >= y:
            high = middle
        else:
            low = middle + 1
    return low


@kernel
def put(stairs, count, at, y, z, number):
    """Put a step that none dominates where `place_of` says, in place of those it dominates; return the new count."""
    first = at
    while first > 0 and stairs[first - 1, 1] <= z:
        first -= 1
    shift = first + 1 - at
    if shift > 0:
        for n in range(count - 1, at - 1, -1):
            for i in range(3):
                stairs[n + shift, i] = stairs[n, i]
    elif shift < 0:
        for n in range(at, count):
            for i in range(3):
                stairs[n + shift, i] = stairs[n, i]
    stairs[first, 0], stairs[first, 1], stairs[first, 2] = y, z, number
    return count + shift
