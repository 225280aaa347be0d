"""Things flush with a surface: a picture is the wall's plane and what it protrudes, thinner than its depth is certain.

The variance of heights over the plane is that of depth, which the sensor's model knows, and that of the thing's relief.
Without the first, the mean height decides, not the noisiest points. Errors of poses cancel: thing and surface are
measured in the same images.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.depth_sensor import sigma_at

_TURNS, _LEAST_RETURNS, _AGREE_SIGMAS = 3, 24, 3.0

Plane = tuple[float, float, float, float]
"""The unit normal n towards the camera, and the offset d, of the points p with n p = d."""


def flush_heights(
    points: NDArray[Any], weights: NDArray[Any], variances: NDArray[Any], plane: Plane, width_m: float
) -> NDArray[np.float64] | None:
    """Return the (N,) heights of (N, 3) points over a plane without the noise of their depth; None: they are not flush.

    A thing is flush if it is closer to the plane than it is wide, and if its relief is within its noise, or smaller
    than its height: a body that rises from the plane evenly has more.
    """
    is_flush, heights_m = _flushed(points, weights, variances, np.array(plane), float(width_m))
    return np.asarray(heights_m) if is_flush else None


@kernel
def _flushed(points, weights, variances, plane, width):
    heights = np.empty(len(points))
    total, mean, noise, relief = 0.0, 0.0, 0.0, 0.0
    for i in range(len(points)):
        heights[i] = points[i, 0] * plane[0] + points[i, 1] * plane[1] + points[i, 2] * plane[2] - plane[3]
        total, mean, noise = total + weights[i], mean + weights[i] * heights[i], noise + weights[i] * variances[i]
    mean, noise = mean / total, noise / total
    for i in range(len(points)):
        relief += weights[i] * (heights[i] - mean) ** 2 / total
    relief -= noise
    is_flush = -np.sqrt(noise) <= mean <= width and relief <= max(mean * mean / 12, noise)
    relief = max(relief, 0.0)
    for i in range(len(points)):
        heights[i] = max(mean + (heights[i] - mean) * relief / (relief + variances[i]), 0.0)
    return is_flush, heights


@kernel
def plane_beside(depth, beside, u, v, law):
    """Return a x + b y + c z = 1 of the camera's frame for the plane of most returns in `beside` (h, w).

    (3,), zeros without one. `u` (w,) and `v` (h,) are the normalised coordinates of columns and rows. A plane is linear
    in them in inverse depth, of which the noise of triangulation is the same everywhere. Least trimmed squares
    (Rousseeuw 1984): the better half is fitted again.
    """
    rows = np.empty((depth.size, 4))
    count = 0
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            z = np.float64(depth[y, x])
            if beside[y, x] and z > 0.0:
                rows[count, 0], rows[count, 1], rows[count, 2] = u[x], v[y], 1.0 / z
                rows[count, 3] = sigma_at(z, law) / (z * z)
                count += 1
    plane = np.zeros(3)
    if count < _LEAST_RETURNS:
        return plane
    rows = rows[:count]
    kept, errors = np.ones(count, dtype=np.bool_), np.empty(count)
    for turn in range(_TURNS + 1):
        plane = _fitted(rows, kept)
        for i in range(count):
            left = rows[i, 2] - plane[0] * rows[i, 0] - plane[1] * rows[i, 1] - plane[2]
            errors[i] = abs(left) / rows[i, 3]
        gate = np.median(errors) if turn < _TURNS else _AGREE_SIGMAS
        kept = errors <= gate
    return _fitted(rows, kept) if 2 * kept.sum() >= count else np.zeros(3)


@kernel
def _fitted(rows, kept):
    mean, num = np.zeros(3), 0
    for i in range(len(rows)):
        if kept[i]:
            num += 1
            for k in range(3):
                mean[k] += rows[i, k]
    mean /= num
    uu, uv, vv, uw, vw = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(rows)):
        if kept[i]:
            a, b, w = rows[i, 0] - mean[0], rows[i, 1] - mean[1], rows[i, 2] - mean[2]
            uu, uv, vv, uw, vw = uu + a * a, uv + a * b, vv + b * b, uw + a * w, vw + b * w
    plane = np.zeros(3)
    determinant = uu * vv - uv * uv
    if determinant > 1e-12 * uu * vv:
        plane[0], plane[1] = (vv * uw - uv * vw) / determinant, (uu * vw - uv * uw) / determinant
        plane[2] = mean[2] - plane[0] * mean[0] - plane[1] * mean[1]
    return plane
