"""The kernels of inflation: the smallest semi-axes with which a superquadric contains given balls.

A superquadric with exponents up to 2 is convex, and symmetric in its local planes: it contains the ball of radius r
around p if it contains |p| + c r d for a net of directions d in the first octant, where c >= 1 makes the net's facets
enclose the octant of the sphere: 21 points for each corner of a triangle, without a bound on curvature.

In the logarithms of the semi-axes ln h (h = G^(e1/2)) is convex and that of the volume linear: the smallest primitive
around given points is a convex problem in two unknowns, the ratios, since the scale follows from the worst point.

A body that contains a point contains all points no farther from any of its planes: only the maximal points count, of
8,000 vertices about 200. They are found from the farthest along x, with a staircase: y rises along it, and z falls.
"""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable
from hickory_stream.geometry.portable_kernels import exp, exp_each, log, log1p

# Subdivisions n per side of the net of directions over the octant: (n + 1)(n + 2) / 2 directions.
_NET = 5
# tan(k pi / 4 / 5)^0.86: about equal steps of angle along the sides make the facets nearly equal.
_STEPS = (0.0, 0.204999481350814, 0.380300934986841, 0.559967288272018, 0.759774117910865, 1.0)
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


def least_axes(
    points: NDArray[np.float64], before: NDArray[np.float64], e1: float, e2: float, limit: float
) -> NDArray[np.float64]:
    """Return the semi-axes of about the least volume, none below `before`, with ln h <= limit at (N, 3) points >= 0."""
    # A simplex search over the two ratios of the axes. Containment is exact: the scale follows from the worst point.
    logs = portable.log(np.maximum(points, 1e-200).T)
    floor = portable.log(before).tolist()

    def scaled(ratios: list[float]) -> list[float]:
        scale = _scale(logs, *ratios, e1, e2, limit)
        return [max(ratio + scale, least) for ratio, least in zip(ratios, floor, strict=True)]

    best = scaled(floor)
    if all(one <= least + 1e-12 for one, least in zip(best, floor, strict=True)):
        return before.copy()
    by_extent = scaled([max(one, least) for one, least in zip(logs.max(axis=1).tolist(), floor, strict=True)])
    start = by_extent if _total(*by_extent) < _total(*best) else best
    # Three vertices: log ratios of y and z to x, and the size.
    y, z = start[1] - start[0], start[2] - start[0]
    simplex = np.array([[y, z, 0.0], [y + 0.3, z, 0.0], [y, z + 0.3, 0.0]])
    _descend(simplex, logs, *floor, e1, e2, limit)
    found = scaled([0.0, *simplex[0, :2].tolist()])
    return exp_each(np.array(found if _total(*found) < _total(*start) else start))


def _total(x: float, y: float, z: float) -> float:
    # Python's own sum is of more than double precision since 3.12.
    return x + y + z


def local_abs(points: NDArray[np.float64], pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (N, 3) absolute local coordinates of world points in a (4, 4) pose."""
    return np.abs(portable.matmul(points - pose[:3, 3], pose[:3, :3]))


def extremes(points: NDArray[np.float64], directions: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which of (N, 3) points are the farthest in any of the directions."""
    chosen = np.zeros(len(points), np.bool_)
    chosen[portable.matmul(directions, points.T).argmax(axis=1)] = True
    return chosen


def with_net(points: NDArray[np.float64], radii: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the points that represent balls: (N, 3) centres >= 0 moved along the net; only the centre for radius 0."""
    moved = points[:, None] + (radii * NET_FACTOR)[:, None, None] * NET
    return moved[(radii > 0.0)[:, None] | (np.arange(len(NET)) == 0)]


def worst_balls(
    points: NDArray[np.float64],
    radii: NDArray[np.float64],
    axes: NDArray[np.float64],
    e1: float,
    e2: float,
    limit: float,
    most: int,
) -> NDArray[np.int64]:
    """Return up to `most` of the balls that protrude, evenly spread over all of these."""
    out = np.empty(len(points), np.int64)
    count = _protruding(points, radii, *axes.tolist(), e1, e2, limit, NET, NET_FACTOR, out)
    return out[: count : max(count // most, 1)]


def undominated(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return (N,) which of (N, 3) points, of coordinates of at least 0, have no other one beyond them in all three."""
    # Of equal points at least one is kept.
    kept = np.zeros(len(points), np.bool_)
    _keep_undominated(points, np.argsort(-points[:, 0], kind="stable"), np.empty((len(points), 3)), kept)
    return kept


@kernel(error_model="numpy")
def log_gauge(x, y, z, e1, e2):
    """Return ln h at a local point, of coordinates of at least 0 in shares of the semi-axes."""
    u, v, w = log(max(x, 1e-200)), log(max(y, 1e-200)), log(max(z, 1e-200))
    high = max(u, v)
    log_rho = high + 0.5 * e2 * log1p(exp(2.0 / e2 * (min(u, v) - high)))
    top = max(log_rho, w)
    return top + 0.5 * e1 * log1p(exp(2.0 / e1 * (min(log_rho, w) - top)))


@kernel(error_model="numpy")
def log_gauge_of_ball(x, y, z, radius, a, b, c, e1, e2, limit, net, factor):
    """Return an upper bound of ln h over a ball around a local point, exact enough to tell whether it is <= limit."""
    # Of semi-axes a, b, c. Beyond the limit, the first value found above it.
    worst = log_gauge((x + radius) / a, (y + radius) / b, (z + radius) / c, e1, e2)
    if worst <= limit or radius == 0.0:
        return worst
    worst = -1e300
    r = radius * factor
    for m in range(len(net)):
        value = log_gauge((x + r * net[m, 0]) / a, (y + r * net[m, 1]) / b, (z + r * net[m, 2]) / c, e1, e2)
        worst = max(worst, value)
        if worst > limit:
            break
    return worst


@kernel(error_model="numpy")
def _scale(logs, x, y, z, e1, e2, limit):
    # What must be added to log axes so that the body holds all points, given by their logarithms.
    worst = -1e300
    for n in range(logs.shape[1]):
        u, v, w = logs[0, n] - x, logs[1, n] - y, logs[2, n] - z
        high = max(u, v)
        log_rho = high + 0.5 * e2 * log1p(exp(2.0 / e2 * (min(u, v) - high)))
        top = max(log_rho, w)
        worst = max(worst, top + 0.5 * e1 * log1p(exp(2.0 / e1 * (min(log_rho, w) - top))))
    return worst - limit


@kernel
def _size(y, z, logs, floor_x, floor_y, floor_z, e1, e2, limit):
    # The sum of the log axes, raised to the floor, of a vertex.
    scale = _scale(logs, 0.0, y, z, e1, e2, limit)
    return max(scale, floor_x) + max(y + scale, floor_y) + max(z + scale, floor_z)


@kernel
def _descend(simplex, logs, floor_x, floor_y, floor_z, e1, e2, limit):
    # Nelder and Mead (1965); the best vertex ends as the first.
    for n in range(3):
        y, z = simplex[n, 0], simplex[n, 1]
        simplex[n, 2] = _size(y, z, logs, floor_x, floor_y, floor_z, e1, e2, limit)
    for step in range(51):
        for last in range(1, 3):
            n = last
            while n > 0 and simplex[n, 2] < simplex[n - 1, 2]:
                for i in range(3):
                    simplex[n, i], simplex[n - 1, i] = simplex[n - 1, i], simplex[n, i]
                n -= 1
        if step == 50 or simplex[2, 2] - simplex[0, 2] < 2e-4:
            return
        middle_y, middle_z = 0.5 * (simplex[0, 0] + simplex[1, 0]), 0.5 * (simplex[0, 1] + simplex[1, 1])
        last_y, last_z = simplex[2, 0], simplex[2, 1]
        y, z = 2.0 * middle_y - last_y, 2.0 * middle_z - last_z
        size = _size(y, z, logs, floor_x, floor_y, floor_z, e1, e2, limit)
        if size < simplex[0, 2]:
            far_y, far_z = 3.0 * middle_y - 2.0 * last_y, 3.0 * middle_z - 2.0 * last_z
            other = _size(far_y, far_z, logs, floor_x, floor_y, floor_z, e1, e2, limit)
            if other < size:
                y, z, size = far_y, far_z, other
        elif size >= simplex[1, 2]:
            y, z = 0.5 * (middle_y + last_y), 0.5 * (middle_z + last_z)
            size = _size(y, z, logs, floor_x, floor_y, floor_z, e1, e2, limit)
            if size >= simplex[2, 2]:
                for n in range(1, 3):
                    y, z = 0.5 * (simplex[0, 0] + simplex[n, 0]), 0.5 * (simplex[0, 1] + simplex[n, 1])
                    simplex[n, 0], simplex[n, 1] = y, z
                    simplex[n, 2] = _size(y, z, logs, floor_x, floor_y, floor_z, e1, e2, limit)
                continue
        simplex[2, 0], simplex[2, 1], simplex[2, 2] = y, z, size


@kernel(error_model="numpy")
def _protruding(points, radii, a, b, c, e1, e2, limit, net, factor, out):
    # Fills the first of `out` with the balls that protrude; returns their number.
    count = 0
    # Most balls need no logarithm: h lies between the largest share of a semi-axis and 2^((e1 + e2) / 2) times that.
    out_from = exp(limit) * (1.0 + 1e-9)
    in_up_to = exp(limit - 0.5 * (e1 + e2) * _LOG_2) * (1.0 - 1e-9)
    for n in range(len(points)):
        x, y, z, r = points[n, 0], points[n, 1], points[n, 2], radii[n]
        if max((x + r) / a, (y + r) / b, (z + r) / c) <= in_up_to:
            continue
        is_out = max(x / a, y / b, z / c) > out_from
        if is_out or log_gauge_of_ball(x, y, z, r, a, b, c, e1, e2, limit, net, factor) > limit:
            out[count] = n
            count += 1
    return count


@kernel
def _keep_undominated(points, order, stairs, kept):
    count = np.int64(0)
    for n in order:
        at = place_of(stairs, count, points[n, 1])
        if at == count or stairs[at, 1] < points[n, 2]:
            kept[n] = True
            count = put(stairs, count, at, points[n, 1], points[n, 2], 0.0)


@kernel
def place_of(stairs, count, y):
    """Return the first of `count` steps that reaches as far along y: if any dominates a point there, it does."""
    # `stairs` (M, 3) has room for the steps of a staircase: y, z, and a number that goes with them.
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
    for m in range(at, count):
        # The last one first where they make room.
        n = count - 1 + at - m if shift > 0 else m
        for i in range(3):
            stairs[n + shift, i] = stairs[n, i]
    stairs[first, 0], stairs[first, 1], stairs[first, 2] = y, z, number
    return count + shift
