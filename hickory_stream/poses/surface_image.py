"""The surface of a keyframe's depth at low resolution: a point, a normal and its noise for every cell.

Planes are linear in inverse depth, where a triangulating camera has uniform noise: each window of cells is fitted there
twice, the second time over the inliers. Cells beside an edge have no surface.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.arrays import freeze_all
from hickory_stream.geometry.camera import Camera

_RADIUS = 2
_LEAST_CELLS = 12
# A surface seen at a flatter angle has an uncertain place.
_LEAST_COSINE = 0.2


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SurfaceImage:
    """Surface elements by cell, in the camera's frame; NaN if there is none."""

    #: the camera of the cells
    camera: Camera
    points: NDArray[np.float64]
    #: (h, w, 3) float64, facing the camera
    normals: NDArray[np.float64]
    #: (h, w) standard deviation of the point along its normal
    sigma_m: NDArray[np.float64]

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        freeze_all(self, np.float64, points=(*size, 3), normals=(*size, 3), sigma_m=size)


def surface_image(
    depth_mm: NDArray[np.uint16], camera: Camera, *, spread_per_m: float, max_sigma_m: float
) -> SurfaceImage:
    """Return the surface of depth (h, w) in millimetres, 0 = no return, from the `camera` of these cells.

    `spread_per_m`: standard deviation of inverse depth; returns with a sigma above `max_sigma_m` are left out.
    """
    points, normals = (np.full((*depth_mm.shape, 3), np.nan) for _ in range(2))
    sigma_m, inverse = np.full(depth_mm.shape, np.nan), np.zeros(depth_mm.shape)
    has = depth_mm > 0
    inverse[has] = 1000.0 / depth_mm[has]
    lens = camera.fx, camera.fy, camera.cx, camera.cy
    _fit(inverse, lens, float(spread_per_m), float(max_sigma_m), points, normals, sigma_m)
    return SurfaceImage(camera=camera, points=points, normals=normals, sigma_m=sigma_m)


@kernel(error_model="numpy")
def _fit(inverse, lens, spread, max_sigma, points, normals, sigma):
    # The sums of a row's windows are added cell by cell, vectorised.
    height, width = inverse.shape
    fx, fy, cx, cy = lens
    least = np.sqrt(spread / max_sigma) if max_sigma > 0 else 0.0  # sigma = spread z^2, so that 1/z is at least this
    inner = max(width - 2 * _RADIUS, 0)
    sums, planes = np.empty((9, inner)), np.empty((3, inner))
    gates, counts = np.empty(inner), np.empty(inner)
    for y in range(_RADIUS, height - _RADIUS):
        own_row = inverse[y, _RADIUS : _RADIUS + inner]
        for i in range(inner):
            own = own_row[i]
            planes[0, i], planes[1, i], planes[2, i] = 0.0, 0.0, own
            gates[i], counts[i] = 0.05 * own, 1.0
        _sum_windows(inverse, y, planes, gates, sums)
        _solve(sums, planes, counts)
        for i in range(inner):
            gates[i] = 3.0 * spread + 0.002 * own_row[i]
        _sum_windows(inverse, y, planes, gates, sums)
        _solve(sums, planes, counts)
        for i in range(inner):
            x, own = i + _RADIUS, own_row[i]
            a, b, c, count = planes[0, i], planes[1, i], planes[2, i], counts[i]
            if own < least or own <= 0.0 or count == 0.0 or c <= 0.0 or abs(c - own) > 4.0 * spread + 0.002 * own:
                continue
            # 1/z = a' U + b' V + c' in coordinates of the image plane; (a', b', c') is along the plane's normal.
            u, v = (x - cx) / fx, (y - cy) / fy
            nx, ny = a * fx, b * fy
            nz = c - nx * u - ny * v
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            z = 1.0 / c
            along = c / length  # the normal's share of a step in depth: n . (u, v, 1)
            if along / np.sqrt(1.0 + u * u + v * v) < _LEAST_COSINE:
                continue
            points[y, x, 0], points[y, x, 1], points[y, x, 2] = u * z, v * z, z
            normals[y, x, 0], normals[y, x, 1], normals[y, x, 2] = -nx / length, -ny / length, -nz / length
            sigma[y, x] = spread * z * z * along / np.sqrt(0.5 * count)


@kernel(error_model="numpy")
def _sum_windows(inverse, y, planes, gates, sums):
    # n, u, v, d, uu, uv, vv, ud, vd over the cells within the gates.
    sums[:] = 0.0
    inner = sums.shape[1]
    for dy in range(-_RADIUS, _RADIUS + 1):
        for dx in range(-_RADIUS, _RADIUS + 1):
            du, dv = float(dx), float(dy)
            row = inverse[y + dy, _RADIUS + dx : _RADIUS + dx + inner]
            for i in range(inner):
                d = row[i]
                off = abs(d - (planes[2, i] + planes[0, i] * du + planes[1, i] * dv))
                is_in = (d > 0.0) & (off <= gates[i])
                sums[0, i] += 1.0 if is_in else 0.0
                sums[1, i] += du if is_in else 0.0
                sums[2, i] += dv if is_in else 0.0
                sums[3, i] += d if is_in else 0.0
                sums[4, i] += du * du if is_in else 0.0
                sums[5, i] += du * dv if is_in else 0.0
                sums[6, i] += dv * dv if is_in else 0.0
                sums[7, i] += du * d if is_in else 0.0
                sums[8, i] += dv * d if is_in else 0.0


@kernel(error_model="numpy")
def _solve(sums, planes, counts):
    # `counts` becomes 0 without a plane, now or in the fit before.
    for i in range(sums.shape[1]):
        n, su, sv, sd = sums[0, i], sums[1, i], sums[2, i], sums[3, i]
        cuu, cuv, cvv = sums[4, i] - su * su / n, sums[5, i] - su * sv / n, sums[6, i] - sv * sv / n
        cud, cvd = sums[7, i] - su * sd / n, sums[8, i] - sv * sd / n
        determinant = cuu * cvv - cuv * cuv
        has_plane = (n >= _LEAST_CELLS) & (determinant >= 1e-2 * (cuu + cvv) * (cuu + cvv))
        a = (cud * cvv - cvd * cuv) / determinant
        b = (cvd * cuu - cud * cuv) / determinant
        planes[0, i], planes[1, i], planes[2, i] = a, b, (sd - a * su - b * sv) / n
        counts[i] = n if has_plane and counts[i] > 0.0 else 0.0
