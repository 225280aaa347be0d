"""One superquadric fitted to signed distances: Levenberg-Marquardt with analytic Jacobians.

The distance of a point is to a tangent plane near it, exact for spheres and over a box's faces. With the gauge h =
G^(e1/2), ln h is a nested log-sum-exp of the log coordinates; its derivatives are softmax weights and entropies, so
nothing overflows for exponents down to 0.1. Rotations are updated on the manifold.

Residuals follow Marching-Primitives (Liu et al., 2023): truncated distances, and a mixture of a Gaussian and a uniform
distribution for the share that belongs to another primitive. Only missing cover can belong to another primitive.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable
from hickory_stream.geometry.portable_kernels import cos, exp, exp_each, log, sin, solve_in_place, times_3
from hickory_stream.geometry.superquadric import Superquadrics
from hickory_stream.shapes.fit.tangent_planes import (
    BLOCK,
    DISTANCE,
    JACOBIAN,
    X,
    Y,
    Z,
    distances_of,
    fill_distances,
    fill_jacobian,
    new_block,
)

# A primitive is a row of 17 numbers: e1, e2, ln a1..a3, the centre, the rotation row by row.
ROW = 17
# Outside, distances are cut off early: near an edge the tangent planes understate them, which would round every box.
OUTER_BAND = 1.0
# The density of the uniform distribution relative to the peak of the Gaussian.
OUTLIER = 0.1
# Beyond this many cells, missing cover counts linearly: it may belong to a part that has no primitive.
_HUBER = 1.0
_PADDED = 12
# Parameter order of a step: e1, e2, ln a (3), centre in the local frame (3), rotation vector in the local frame (3).


def row_of(
    exponents: tuple[float, float],
    semi_axes: NDArray[np.float64],
    center: NDArray[np.float64],
    rotation: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the (17,) row of a primitive; `rotation` (3, 3) turns local into grid directions."""
    return np.concatenate([exponents, portable.log(semi_axes), center, rotation.ravel()])


def rows_in(primitives: Superquadrics, unit_m: float, offset_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (K, 17) rows of primitives, in a unit, off an offset (3,)."""
    parts = zip(primitives.exponents.tolist(), primitives.semi_axes_m, primitives.world_from_local, strict=True)
    return np.stack(
        [
            row_of((e1, e2), axes / unit_m, (pose[:3, 3] - offset_m) / unit_m, pose[:3, :3])
            for (e1, e2), axes, pose in parts
        ]
    )


def refined(
    row: NDArray[np.float64],
    points: NDArray[np.float64],
    distances: NDArray[np.float64],
    weights: NDArray[np.float64],
    *,
    band: float,
    iterations: int,
    max_log_axis: float,
) -> NDArray[np.float64]:
    """Return the row fitted to signed `distances` (N,) at `points` (N, 3), negative inside, truncated at `band`.

    `weights` (N,) are 0 where another primitive explains the object. The unit is a cell.
    """
    return np.asarray(lm_fit(row, points, distances, weights, band, iterations, max_log_axis))


@kernel
def tangent_distance(row, x, y, z, local, gradient, shape, with_shape, depth):
    """Return the signed distance of a point to a tangent plane near it; fill local point and derivatives."""
    # Of ln h: `gradient` (3,), and `shape` (5,) by e1, e2, ln a1..a3. A convex body lies behind its tangent planes: the
    # distance to one bounds the true distance from below outside, from above inside. Outside, the plane touches on the
    # ray from the centre; inside it is the nearest of that plane and of those met along the three axes, since the first
    # alone would place the rim of a plate nearer than its faces. Beyond `depth`, some deeper value is returned, and
    # nothing is filled.
    dx, dy, dz = x - row[5], y - row[6], z - row[7]
    # The columns of the rotation are the local axes.
    px = row[8] * dx + row[11] * dy + row[14] * dz
    py = row[9] * dx + row[12] * dy + row[15] * dz
    pz = row[10] * dx + row[13] * dy + row[16] * dz
    px = px if abs(px) > 1e-6 else 1e-6
    py = py if abs(py) > 1e-6 else 1e-6
    pz = pz if abs(pz) > 1e-6 else 1e-6
    log_x, log_y, log_z = log(abs(px)) - row[2], log(abs(py)) - row[3], log(abs(pz)) - row[4]
    # ln of the gauge in the xy plane, and of all three: the shares are the softmax weights of the nested sums.
    log_rho, share_x, share_y = _softmax(log_x, log_y, row[1])
    log_h, share_r, share_z = _softmax(log_rho, log_z, row[0])
    local[0], local[1], local[2] = px, py, pz
    gradient[0], gradient[1], gradient[2] = share_r * share_x / px, share_r * share_y / py, share_z / pz
    slope = np.sqrt(gradient[0] ** 2 + gradient[1] ** 2 + gradient[2] ** 2)
    if log_h >= 0.0:
        if with_shape:
            _fill_shape(share_x, share_y, share_r, share_z, shape)
        return (1.0 - exp(-log_h)) / slope
    h = max(exp(log_h), 1e-200)
    # The body holds the ellipsoid, or else the octahedron, of its semi-axes; 1 - h is the share of the way out.
    smallest = exp(min(row[2], row[3], row[4])) * (1.0 if row[0] <= 1.0 and row[1] <= 1.0 else 0.57735)
    if (1.0 - h) * smallest > depth:
        return -(1.0 - h) * smallest
    best = (1.0 / h - 1.0) / slope
    axis, reach, foot_x, foot_y, foot_r, foot_z = _nearest_along_axes(
        row, px, py, pz, log_rho, log_h, share_x, share_y, share_r, share_z
    )
    if reach < best * 4.0:
        sx = px + (reach if px > 0.0 else -reach) * (axis == 0)
        sy = py + (reach if py > 0.0 else -reach) * (axis == 1)
        sz = pz + (reach if pz > 0.0 else -reach) * (axis == 2)
        gx, gy, gz = foot_r * foot_x / sx, foot_r * foot_y / sy, foot_z / sz
        along = gx if axis == 0 else (gy if axis == 1 else gz)
        planar = reach * abs(along) / np.sqrt(gx * gx + gy * gy + gz * gz)
        if planar < best:
            best = planar
            gradient[0], gradient[1], gradient[2] = gx, gy, gz
            share_x, share_y, share_r, share_z = foot_x, foot_y, foot_r, foot_z
    if with_shape:
        _fill_shape(share_x, share_y, share_r, share_z, shape)
    return -best


@kernel
def _softmax(log_a, log_b, exponent):
    # ln (a^(2/e) + b^(2/e))^(e/2) and the shares of both in the sum, without overflow.
    gap = 2.0 / exponent * (log_b - log_a)
    small = exp(-abs(gap))
    total = 1.0 + small
    log_sum = max(log_a, log_b) + 0.5 * exponent * log(total)
    large = 1.0 / total
    return (log_sum, small * large, large) if gap > 0.0 else (log_sum, large, small * large)


@kernel
def _fill_shape(share_x, share_y, share_r, share_z, shape):
    # d ln h / d (e1, e2, ln a1, ln a2, ln a3).
    shape[0] = 0.5 * _entropy(share_r, share_z)
    shape[1] = 0.5 * share_r * _entropy(share_x, share_y)
    shape[2] = -share_r * share_x
    shape[3] = -share_r * share_y
    shape[4] = -share_z


@kernel
def _entropy(p, q):
    return -(p * log(max(p, 1e-300)) + q * log(max(q, 1e-300)))


@kernel
def _nearest_along_axes(row, px, py, pz, log_rho, log_h, share_x, share_y, share_r, share_z):
    e1, e2 = row[0], row[1]
    whole = exp(2.0 / e1 * log_h)
    in_plane, along_z = share_r * whole, share_z * whole
    rest_z, rest_r = max(1.0 - in_plane, 1e-300), max(1.0 - along_z, 1e-300)
    best_axis, best = 2, exp(row[4] + 0.5 * e1 * log(rest_z)) - abs(pz)
    # ln of the largest gauge in the plane at this height, and what the point's own is of it.
    log_most = 0.5 * e1 * log(rest_r)
    own = exp(min(2.0 / e2 * (log_rho - log_most), 0.0))
    rest_x, rest_y = max(1.0 - share_y * own, 1e-300), max(1.0 - share_x * own, 1e-300)
    reach_x = exp(row[2] + log_most + 0.5 * e2 * log(rest_x)) - abs(px)
    reach_y = exp(row[3] + log_most + 0.5 * e2 * log(rest_y)) - abs(py)
    if reach_x < best:
        best_axis, best = 0, reach_x
    if reach_y < best:
        best_axis, best = 1, reach_y
    best = max(best, 0.0)
    if best_axis == 2:
        return best_axis, best, share_x, share_y, in_plane, rest_z
    if best_axis == 0:
        return best_axis, best, rest_x, 1.0 - rest_x, rest_r, along_z
    return best_axis, best, 1.0 - rest_y, rest_y, rest_r, along_z


@kernel
def _cost(d, targets, weights, band, sigma2):
    # The negative log likelihood of the mixture, up to constants.
    total = 0.0
    for n in range(len(d)):
        r = min(max(d[n], -band), OUTER_BAND) - targets[n]
        if r > 0.0:
            total -= weights[n] * 2.0 * sigma2 * log((exp(-0.5 * r * r / sigma2) + OUTLIER) / (1.0 + OUTLIER))
        else:
            total += weights[n] * r * r
    return total


@kernel
def _normal_equations(row, points, targets, weights, band, sigma2):
    a, b = np.zeros((11, _PADDED)), np.zeros(11)
    block, which = new_block(), np.empty(BLOCK, np.int64)
    own, residuals = np.empty(BLOCK), np.empty(BLOCK)
    for first in range(0, len(points), BLOCK):
        count = min(BLOCK, len(points) - first)
        for n in range(count):
            block[X + n], block[Y + n], block[Z + n] = points[first + n, 0], points[first + n, 1], points[first + n, 2]
        fill_distances(block, count, row, band)
        fill_jacobian(block)
        num_added = 0
        for n in range(count):
            d = block[DISTANCE + n]
            if d > OUTER_BAND or d < -band:
                continue
            r = d - targets[first + n]
            w = weights[first + n]
            if r > 0.0:
                gauss = exp(-0.5 * r * r / sigma2)
                w *= gauss / (gauss + OUTLIER)
            which[num_added], own[num_added], residuals[num_added] = n, w, r
            num_added += 1
        _add(a, b, block, which, own, residuals, num_added)
    return a[:, :11].copy(), b


@kernel
def _add(a, b, block, which, weights, residuals, count):
    # Rows are padded to a length that fits registers.
    jacobian = np.zeros(_PADDED)
    for m in range(count):
        for p in range(11):
            jacobian[p] = block[JACOBIAN + p * BLOCK + which[m]]
        for p in range(11):
            wj = weights[m] * jacobian[p]
            b[p] -= wj * residuals[m]
            for q in range(_PADDED):
                a[p, q] += wj * jacobian[q]


@kernel
def _stepped(row, step, max_log_axis):
    out = row.copy()
    for p in range(2):
        out[p] = min(max(row[p] + min(max(step[p], -0.4), 0.4), 0.1), 2.0)
    for p in range(3):
        # No thinner than half a cell across, no longer than the object.
        out[2 + p] = min(max(row[2 + p] + min(max(step[2 + p], -0.5), 0.5), -1.4), max_log_axis)
    rotation = np.ascontiguousarray(row[8:17]).reshape(3, 3)
    for i in range(3):
        out[5 + i] += rotation[i, 0] * step[5] + rotation[i, 1] * step[6] + rotation[i, 2] * step[7]
    angle = np.sqrt(step[8] ** 2 + step[9] ** 2 + step[10] ** 2)
    if angle > 1e-12:
        x, y, z = step[8] / angle, step[9] / angle, step[10] / angle
        turn = min(angle, 0.5)
        s, c = sin(turn), 1.0 - cos(turn)
        k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        rotation = times_3(rotation, np.eye(3) + s * k + c * times_3(k, k))
        out[8:17] = rotation.ravel()
    return out


@kernel
def _sigma2(d, targets, weights, band, sigma2):
    # The maximisation step of the mixture's variance; never below half a cell squared.
    total, count = 0.0, 0.0
    for n in range(len(d)):
        r = min(max(d[n], -band), OUTER_BAND) - targets[n]
        w = weights[n]
        if r > 0.0:
            gauss = exp(-0.5 * r * r / sigma2)
            w *= gauss / (gauss + OUTLIER)
        total += w * r * r
        count += w
    return max(total / max(count, 1e-9), 0.25)


@kernel
def lm_fit(row, points, distances, weights, band, iterations, max_log_axis):
    """Return what `refined` does."""
    targets = np.minimum(np.maximum(distances, -band), OUTER_BAND)
    d = distances_of(row, points, band)
    sigma2 = _sigma2(d, targets, weights, band, band * band)
    cost = _cost(d, targets, weights, band, sigma2)
    damping = 1e-3
    for _ in range(iterations):
        a, b = _normal_equations(row, points, targets, weights, band, sigma2)
        gain = 0.0
        for _ in range(4):
            lhs = a.copy()
            for p in range(11):
                lhs[p, p] += damping * a[p, p] + 1e-6 * (a[0, 0] + a[5, 5] + 1.0)
            step = b.copy()
            solve_in_place(lhs, step)
            candidate = _stepped(row, step, max_log_axis)
            d = distances_of(candidate, points, band)
            new_cost = _cost(d, targets, weights, band, sigma2)
            if new_cost < cost:
                gain = (cost - new_cost) / max(cost, 1e-12)
                row, damping = candidate, max(damping * 0.3, 1e-6)
                break
            damping = min(damping * 8.0, 1e6)
        if gain < 1e-3:
            break
        sigma2 = min(sigma2, _sigma2(d, targets, weights, band, sigma2))
        cost = _cost(d, targets, weights, band, sigma2)
    return row


@kernel
def _loss(r):
    return r * r if r <= _HUBER else _HUBER * (2.0 * r - _HUBER)


@kernel
def cut_distances(row, points, band):
    """Return the (N,) distances to a primitive, truncated at the band; points outside its box are skipped."""
    out = np.full(len(points), OUTER_BAND)
    reach = exp_each(row[2:5]) + OUTER_BAND
    block, which = new_block(), np.empty(BLOCK, np.int64)
    count = 0
    for n in range(len(points)):
        dx, dy, dz = points[n, 0] - row[5], points[n, 1] - row[6], points[n, 2] - row[7]
        if (
            abs(row[8] * dx + row[11] * dy + row[14] * dz) < reach[0]
            and abs(row[9] * dx + row[12] * dy + row[15] * dz) < reach[1]
            and abs(row[10] * dx + row[13] * dy + row[16] * dz) < reach[2]
        ):
            block[X + count], block[Y + count], block[Z + count] = points[n, 0], points[n, 1], points[n, 2]
            which[count] = n
            count += 1
        if count == BLOCK or (n == len(points) - 1 and count > 0):
            fill_distances(block, count, row, band)
            for m in range(count):
                out[which[m]] = min(max(block[DISTANCE + m], -band), OUTER_BAND)
            count = 0
    return out


@kernel
def normal_step(row, points, targets, others, found, band, damping, k, max_log_axis, with_exponents):
    """Return the row after one step with the others held fixed, its distances, and the relative gain (0: no step)."""
    # `others` (N,) are distances to the union of the others, `found` (N,) to this one; `damping[k]` is updated.
    padded, b = np.zeros((11, _PADDED)), np.zeros(11)
    block, which, in_order = new_block(), np.empty(BLOCK, np.int64), np.arange(BLOCK)
    weights, residuals = np.empty(BLOCK), np.empty(BLOCK)
    cost = 0.0
    count = 0
    for n in range(len(points)):
        cost += _loss(min(found[n], others[n]) - targets[n])
        if found[n] <= others[n] and -band < found[n] < OUTER_BAND:
            block[X + count], block[Y + count], block[Z + count] = points[n, 0], points[n, 1], points[n, 2]
            which[count] = n
            count += 1
        if count == BLOCK or (n == len(points) - 1 and count > 0):
            fill_distances(block, count, row, band)
            fill_jacobian(block)
            if not with_exponents:
                block[JACOBIAN : JACOBIAN + 2 * BLOCK] = 0.0
            for m in range(count):
                r = found[which[m]] - targets[which[m]]
                weights[m], residuals[m] = 1.0 if r <= _HUBER else _HUBER / r, r
            _add(padded, b, block, in_order, weights, residuals, count)
            count = 0
    a = padded[:, :11].copy()
    for _ in range(4):
        lhs = a.copy()
        for p in range(11):
            lhs[p, p] += damping[k] * a[p, p] + 1e-6 * (a[0, 0] + a[5, 5] + 1.0)
        step = b.copy()
        solve_in_place(lhs, step)
        candidate = _stepped(row, step, max_log_axis)
        again = cut_distances(candidate, points, band)
        new_cost = 0.0
        for n in range(len(points)):
            new_cost += _loss(min(again[n], others[n]) - targets[n])
        if new_cost < cost:
            damping[k] = max(damping[k] * 0.3, 1e-6)
            return candidate, again, (cost - new_cost) / max(cost, 1e-12)
        damping[k] = min(damping[k] * 8.0, 1e6)
    return row, found, 0.0
