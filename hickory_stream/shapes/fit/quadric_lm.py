"""One superquadric fitted to signed distances: Levenberg-Marquardt with analytic Jacobians.

The distance of a point is to a tangent plane near it, exact for spheres and over a box's faces. With the gauge h =
G^(e1/2), ln h is a nested log-sum-exp of the log coordinates; its derivatives are softmax weights and entropies, so
nothing overflows for exponents down to 0.1. Rotations are updated on the manifold.

Residuals follow Marching-Primitives (Liu et al., 2023): truncated distances, and a mixture of a Gaussian and a uniform
distribution for the share that belongs to another primitive. Only missing cover can belong to another primitive.
"""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable
from hickory_stream.geometry.portable_kernels import cos, exp, log, sin, solve_in_place
from hickory_stream.geometry.superquadric import Superquadrics
from hickory_stream.shapes.fit.tangent_planes import (
    BLOCK,
    DISTANCE,
    JACOBIAN,
    X,
    Y,
    Z,
    fill_all_distances,
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
    out = row.copy()
    targets = np.clip(distances, -band, OUTER_BAND)
    workspace = (np.empty(len(points)), np.empty(ROW), *new_workspace(len(points)))
    _fit(out, points, targets, weights, band, iterations, max_log_axis, *workspace)
    return out


def cut_distances(row: NDArray[np.float64], points: NDArray[np.float64], band: float) -> NDArray[np.float64]:
    """Return the (N,) distances to a primitive, truncated at the band; points outside its box are skipped."""
    out = np.empty(len(points))
    _fill_cut_distances(row, points, band, new_block(), out)
    return out


def new_workspace(count: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return a block, and room for the weights and residuals of (N,) points and for the equations of a step."""
    return new_block(), np.empty((2, count)), np.empty((2, 11, _PADDED))


@kernel(error_model="numpy")
def _judge(d, targets, weights, band, sigma2, own):
    # Returns the negative log likelihood of the mixture, up to constants, and its variance by the maximisation step;
    # fills the weights, 0 beyond the band, and residuals.
    cost, total, count = 0.0, 0.0, 0.0
    for n in range(len(d)):
        r = min(max(d[n], -band), OUTER_BAND) - targets[n]
        w = weights[n]
        if r > 0.0:
            gauss = exp(-0.5 * r * r / sigma2)
            cost -= w * 2.0 * sigma2 * log((gauss + OUTLIER) / (1.0 + OUTLIER))
            w *= gauss / (gauss + OUTLIER)
        else:
            cost += w * r * r
        total += w * r * r
        count += w
        own[0, n], own[1, n] = w if -band <= d[n] <= OUTER_BAND else 0.0, r
    # Never below half a cell squared.
    return cost, max(total / max(count, 1e-9), 0.25)


@kernel
def _fill_equations(row, points, own, band, num_held, block, equations):
    # Of the points with a weight; the last column is the right side. Rows are padded to a length that fits registers.
    count = np.int64(0)
    jacobian = equations[1, 0]
    for p in range(11):
        for q in range(_PADDED):
            equations[0, p, q] = 0.0
    first = np.int64(0)
    for n in range(len(points)):
        if own[0, n] != 0.0:
            block[X + count], block[Y + count], block[Z + count] = points[n, 0], points[n, 1], points[n, 2]
            count += 1
        if count == BLOCK or (n == len(points) - 1 and count > 0):
            fill_distances(block, count, row, band)
            fill_jacobian(block)
            m = 0
            while m < count:
                weight, residual = own[0, first], own[1, first]
                first += 1
                if weight == 0.0:
                    continue
                for p in range(11):
                    jacobian[p] = block[JACOBIAN + p * BLOCK + m] if p >= num_held else 0.0
                jacobian[11] = residual
                for p in range(11):
                    share = weight * jacobian[p]
                    for q in range(_PADDED):
                        equations[0, p, q] += share * jacobian[q]
                m += 1
            count = np.int64(0)


@kernel(error_model="numpy")
def _step(row, equations, damping, max_log_axis, out):
    lhs, step = equations[1], np.empty(11)
    for p in range(11):
        for q in range(11):
            lhs[p, q] = equations[0, p, q]
        lhs[p, p] += damping * lhs[p, p] + 1e-6 * (equations[0, 0, 0] + equations[0, 5, 5] + 1.0)
        step[p] = -equations[0, p, 11]
    solve_in_place(lhs, step)
    for p in range(17):
        out[p] = row[p]
    for p in range(2):
        out[p] = min(max(row[p] + min(max(step[p], -0.4), 0.4), 0.1), 2.0)
        # No thinner than half a cell across, no longer than the object.
    for p in range(2, 5):
        out[p] = min(max(row[p] + min(max(step[p], -0.5), 0.5), -1.4), max_log_axis)
    for i in range(3):
        out[5 + i] += row[8 + 3 * i] * step[5] + row[9 + 3 * i] * step[6] + row[10 + 3 * i] * step[7]
    angle = np.sqrt(step[8] * step[8] + step[9] * step[9] + step[10] * step[10])
    if angle > 1e-12:
        x, y, z = step[8] / angle, step[9] / angle, step[10] / angle
        turn = min(angle, 0.5)
        s, c = sin(turn), 1.0 - cos(turn)
        for i in range(3):
            # Rodrigues' formula.
            u, v, w = row[8 + 3 * i], row[9 + 3 * i], row[10 + 3 * i]
            out[8 + 3 * i] = u * (1.0 + c * (-z * z - y * y)) + v * (s * z + c * (x * y)) + w * (c * (x * z) - s * y)
            out[9 + 3 * i] = u * (c * (x * y) - s * z) + v * (1.0 + c * (-z * z - x * x)) + w * (s * x + c * (y * z))
            out[10 + 3 * i] = u * (s * y + c * (x * z)) + v * (c * (y * z) - s * x) + w * (1.0 + c * (-y * y - x * x))


@kernel
def _fit(row, points, targets, weights, band, iterations, max_log_axis, d, candidate, block, own, equations):
    # What `refined` does, in place.
    none_held = np.int64(0)
    fill_all_distances(row, points, band, block, d)
    cost, sigma2 = _judge(d, targets, weights, band, band * band, own)
    cost, better = _judge(d, targets, weights, band, sigma2, own)
    damping = 1e-3
    for _ in range(iterations):
        _fill_equations(row, points, own, band, none_held, block, equations)
        gain = 0.0
        for _ in range(4):
            _step(row, equations, damping, max_log_axis, candidate)
            fill_all_distances(candidate, points, band, block, d)
            new_cost, better = _judge(d, targets, weights, band, sigma2, own)
            if new_cost < cost:
                gain = (cost - new_cost) / max(cost, 1e-12)
                damping = max(damping * 0.3, 1e-6)
                for p in range(17):
                    row[p] = candidate[p]
                break
            damping = min(damping * 8.0, 1e6)
        if gain < 1e-3:
            break
        sigma2 = min(sigma2, better)
        cost, better = _judge(d, targets, weights, band, sigma2, own)


@kernel
def _fill_cut_distances(row, points, band, block, out):
    reach_x, reach_y, reach_z = exp(row[2]) + OUTER_BAND, exp(row[3]) + OUTER_BAND, exp(row[4]) + OUTER_BAND
    which = np.empty(BLOCK, np.int64)
    count = np.int64(0)
    for n in range(len(points)):
        out[n] = OUTER_BAND
        dx, dy, dz = points[n, 0] - row[5], points[n, 1] - row[6], points[n, 2] - row[7]
        if (
            abs(row[8] * dx + row[11] * dy + row[14] * dz) < reach_x
            and abs(row[9] * dx + row[12] * dy + row[15] * dz) < reach_y
            and abs(row[10] * dx + row[13] * dy + row[16] * dz) < reach_z
        ):
            block[X + count], block[Y + count], block[Z + count] = points[n, 0], points[n, 1], points[n, 2]
            which[count] = n
            count += 1
        if count == BLOCK or (n == len(points) - 1 and count > 0):
            fill_distances(block, count, row, band)
            for m in range(count):
                out[which[m]] = min(max(block[DISTANCE + m], -band), OUTER_BAND)
            count = np.int64(0)


@kernel
def _union_cost(found, others, targets):
    total = 0.0
    for n in range(len(found)):
        r = min(found[n], others[n]) - targets[n]
        total += r * r if r <= _HUBER else _HUBER * (2.0 * r - _HUBER)
    return total


@kernel(error_model="numpy")
def normal_step(
    row, points, targets, others, found, band, damping, num_held, max_log_axis, candidate, again, block, own, equations
):
    """Fill the row after one step with the others held fixed, and its distances; return the relative gain and damping.

    Without a gain there is no step. `others` (N,) are distances to the union of the others, `found` (N,) to this one;
    the first `num_held` parameters stay.
    """
    for n in range(len(points)):
        r = found[n] - targets[n]
        is_own = found[n] <= others[n] and -band < found[n] < OUTER_BAND
        own[0, n], own[1, n] = (1.0 if r <= _HUBER else _HUBER / r) if is_own else 0.0, r
    _fill_equations(row, points, own, band, num_held, block, equations)
    cost = _union_cost(found, others, targets)
    for _ in range(4):
        _step(row, equations, damping, max_log_axis, candidate)
        _fill_cut_distances(candidate, points, band, block, again)
        new_cost = _union_cost(again, others, targets)
        if new_cost < cost:
            return (cost - new_cost) / max(cost, 1e-12), max(damping * 0.3, 1e-6)
        damping = min(damping * 8.0, 1e6)
    return 0.0, damping
