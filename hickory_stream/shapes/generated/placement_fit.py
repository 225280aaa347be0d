"""The cost of a placement, and its descent: compiled, since a placement takes ten thousand evaluations.

A pose is rotation (9, by rows), translation (3) and factors of size. The loss of Geman and McClure stops the pull of
generated surface, and of surface that a mask lost.
"""

import numpy as np

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.portable_kernels import cos, exp, log, sin, solve_in_place
from hickory_stream.shapes.generated.distance_field import field_at
from hickory_stream.shapes.generated.placement_evidence import violation_m

_STEP = 1e-4
_RIGID, _STRETCHED = 7, 9
_ROOT_6, _ROOT_2 = 2.449489742783178, 1.4142135623730951


@kernel
def residuals(rotation, shift, factors, model, views, weights, out):
    """Fill `out` (N + M + 1), metres: surface points to the mesh, then the violation of views by samples."""
    # The last one is the lowest sample over the support. `model`: surface (N, 3), samples (M, 3), field, origin, cell;
    # `views`: depth, beside, sizes, intrinsics, poses, cuts, noise, support.
    surface, samples, field, origin, cell = model
    depth, beside, sizes, intrinsics, poses, cuts, noise, support = views
    mean = exp((log(factors[0]) + log(factors[1]) + log(factors[2])) / 3.0)
    n = len(surface)
    for i in range(n):
        x, y, z = surface[i, 0] - shift[0], surface[i, 1] - shift[1], surface[i, 2] - shift[2]
        a = (rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z) / factors[0]
        b = (rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z) / factors[1]
        c = (rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z) / factors[2]
        out[i] = mean * field_at(field, origin, cell, a, b, c)
    point = np.empty(3)
    lowest = np.inf
    for j in range(len(samples)):
        a, b, c = samples[j, 0] * factors[0], samples[j, 1] * factors[1], samples[j, 2] * factors[2]
        for k in range(3):
            point[k] = rotation[k, 0] * a + rotation[k, 1] * b + rotation[k, 2] * c + shift[k]
        worst = 0.0
        for k in range(len(depth)):
            found = violation_m(point, depth[k], beside[k], sizes[k], intrinsics[k], poses[k], cuts[k], noise)
            worst = max(worst, found)
        lowest = min(lowest, point[2])
        if support - point[2] > worst:
            worst = support - point[2]
        out[n + j] = worst
    gap = lowest - support
    out[-1] = abs(gap) if abs(gap) < np.inf else 0.0


@kernel
def cost_of(values, num_surface, tolerance, weights):
    """Return the robust cost of residuals in 0..1 of each kind, summed with `weights` (surface, free, support)."""
    squares = tolerance * tolerance
    near, free = 0.0, 0.0
    for i in range(num_surface):
        near += values[i] * values[i] / (values[i] * values[i] + squares)
    for i in range(num_surface, len(values) - 1):
        free += values[i] * values[i] / (values[i] * values[i] + squares)
    gap = values[-1] * values[-1] / (values[-1] * values[-1] + squares)
    return (
        weights[0] * near / max(num_surface, 1)
        + weights[1] * free / max(len(values) - 1 - num_surface, 1)
        + weights[2] * gap
    )


@kernel
def moved_by(rotation, shift, factors, step, pivot, out):
    """Put a pose after a step (7 or 9) into `out` (rotation, shift, factors): turn about the pivot, shift, sizes."""
    new_rotation, new_shift, new_factors = out
    angle = np.sqrt(step[0] * step[0] + step[1] * step[1] + step[2] * step[2])
    turn = np.eye(3)
    if angle > 1e-12:
        x, y, z = step[0] / angle, step[1] / angle, step[2] / angle
        s, c = sin(angle), cos(angle)
        r = 1.0 - c
        turn[0, 0], turn[0, 1], turn[0, 2] = c + x * x * r, x * y * r - z * s, x * z * r + y * s
        turn[1, 0], turn[1, 1], turn[1, 2] = y * x * r + z * s, c + y * y * r, y * z * r - x * s
        turn[2, 0], turn[2, 1], turn[2, 2] = z * x * r - y * s, z * y * r + x * s, c + z * z * r
    for i in range(3):
        for j in range(3):
            new_rotation[i, j] = turn[i, 0] * rotation[0, j] + turn[i, 1] * rotation[1, j] + turn[i, 2] * rotation[2, j]
    size = exp(step[6])
    new_factors[0], new_factors[1], new_factors[2] = factors[0] * size, factors[1] * size, factors[2] * size
    if len(step) == _STRETCHED:
        new_factors[0] *= exp(2.0 * step[7] / _ROOT_6)
        new_factors[1] *= exp(-step[7] / _ROOT_6 + step[8] / _ROOT_2)
        new_factors[2] *= exp(-step[7] / _ROOT_6 - step[8] / _ROOT_2)
    a, b, c = (shift[0] - pivot[0]) * size, (shift[1] - pivot[1]) * size, (shift[2] - pivot[2]) * size
    for i in range(3):
        new_shift[i] = pivot[i] + turn[i, 0] * a + turn[i, 1] * b + turn[i, 2] * c + step[3 + i]


@kernel
def within(factors, most):
    """Return whether no factor exceeds another by more than `most`."""
    low, high = min(factors[0], factors[1], factors[2]), max(factors[0], factors[1], factors[2])
    return high <= most * low


@kernel
def descend(rotation, shift, factors, model, views, weights, tolerance, size, num, most, rounds):
    """Improve a pose in place by Levenberg-Marquardt on its `num` (7 or 9) numbers; return cost and normal matrix."""
    # Turns are scaled by the object's `size`: all steps are lengths. No factor exceeds another by more than `most`.
    n = len(model[0])
    count = n + len(model[1]) + 1
    here, there = np.empty(count), np.empty(count)
    slopes = np.empty((num, count))
    pivot = np.zeros(3)
    for i in range(n):
        for k in range(3):
            pivot[k] += model[0][i, k] / n
    trial = (np.empty((3, 3)), np.empty(3), np.empty(3))
    residuals(rotation, shift, factors, model, views, weights, here)
    cost = cost_of(here, n, tolerance, weights)
    damping = 1e-2
    normal, right = np.zeros((num, num)), np.zeros(num)
    step = np.zeros(num)
    units = np.ones(num)
    for p in range(num):
        units[p] = 1.0 if 3 <= p < 6 else 1.0 / size
    for _ in range(rounds):
        for p in range(num):
            step[:] = 0.0
            step[p] = _STEP * size * units[p]
            moved_by(rotation, shift, factors, step, pivot, trial)
            residuals(trial[0], trial[1], trial[2], model, views, weights, slopes[p])
            for i in range(count):
                slopes[p, i] = (slopes[p, i] - here[i]) / (_STEP * size)
        normal[:] = 0.0
        right[:] = 0.0
        squares = tolerance * tolerance
        for i in range(count):
            share = weights[0] / max(n, 1) if i < n else weights[1] / max(count - 1 - n, 1)
            if i == count - 1:
                share = weights[2]
            fade = squares / (here[i] * here[i] + squares)
            weight = share * fade * fade / squares
            if weight < 1e-12:
                continue
            for p in range(num):
                if slopes[p, i] == 0.0:
                    continue
                right[p] -= weight * slopes[p, i] * here[i]
                for q in range(num):
                    normal[p, q] += weight * slopes[p, i] * slopes[q, i]
        is_better = False
        for _ in range(4):
            matrix, found = normal.copy(), right.copy()
            for p in range(num):
                matrix[p, p] += damping * (normal[p, p] + 1e-6 / squares)
            solve_in_place(matrix, found)
            largest = 0.0
            for p in range(num):
                largest = max(largest, abs(found[p]))
            if not largest < np.inf:
                damping *= 10.0
                continue
            if largest > 0.3 * size:
                for p in range(num):
                    found[p] *= 0.3 * size / largest
            for p in range(num):
                step[p] = found[p] * units[p]
            moved_by(rotation, shift, factors, step, pivot, trial)
            if within(trial[2], most):
                residuals(trial[0], trial[1], trial[2], model, views, weights, there)
                new = cost_of(there, n, tolerance, weights)
                if new < cost:
                    is_better = True
                    break
            damping *= 10.0
        if not is_better:
            break
        gained = cost - new
        rotation[:], shift[:], factors[:] = trial[0], trial[1], trial[2]
        here[:] = there
        cost = new
        damping = max(damping * 0.1, 1e-6)
        if gained < 1e-4 * cost:
            break
    return cost, normal
