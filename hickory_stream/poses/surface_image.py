"""The surface that a keyframe's depth shows, at low resolution: a point, a normal and its noise for every cell.

Planes are linear in inverse depth, in which a triangulating camera has the same noise everywhere: each window of cells
is fitted there, twice, the second time over the inliers of the first. Cells beside an edge have no surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.compiled import numba
from hickory_stream.geometry.arrays import freeze

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.geometry.camera import Camera

_RADIUS = 2
_LEAST_CELLS = 12
_LEAST_COSINE = 0.2
"""A surface that is seen at a flatter angle says little of where it is."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SurfaceImage:
    """Surface elements by cell, in the camera's frame; NaN where there is none.

    `points` and `normals` (h, w, 3) float64, normals face the camera; `sigma_m` (h, w) float64: the standard deviation
    of the point along its normal. `camera` is that of the cells.
    """

    camera: Camera
    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    sigma_m: NDArray[np.float64]

    def __post_init__(self) -> None:
        size = (self.camera.height, self.camera.width)
        freeze(self, "points", np.float64, (*size, 3))
        freeze(self, "normals", np.float64, (*size, 3))
        freeze(self, "sigma_m", np.float64, size)


def surface_image(
    depth_mm: NDArray[np.uint16], camera: Camera, *, spread_per_m: float, max_sigma_m: float
) -> SurfaceImage:
    """Return the surface of depth (h, w) in millimetres, 0 = no return, seen by the `camera` of these cells.

    `spread_per_m` is the standard deviation of inverse depth; returns that are less sure than `max_sigma_m` are left
    out.
    """
    points = np.full((*depth_mm.shape, 3), np.nan)
    normals = np.full((*depth_mm.shape, 3), np.nan)
    sigma_m = np.full(depth_mm.shape, np.nan)
    inverse = np.zeros(depth_mm.shape)
    has = depth_mm > 0
    inverse[has] = 1000.0 / depth_mm[has]
    lens = camera.fx, camera.fy, camera.cx, camera.cy
    _fit(inverse, lens, float(spread_per_m), float(max_sigma_m), points, normals, sigma_m)
    return SurfaceImage(camera=camera, points=points, normals=normals, sigma_m=sigma_m)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _fit(inverse, lens, spread, max_sigma, points, normals, sigma):  # type: ignore[no-untyped-def] # pragma: no cover
    height, width = inverse.shape
    fx, fy, cx, cy = lens
    least = np.sqrt(spread / max_sigma) if max_sigma > 0 else 0.0  # sigma = spread z^2, so that 1/z is at least this
    for y in range(_RADIUS, height - _RADIUS):
        for x in range(_RADIUS, width - _RADIUS):
            own = inverse[y, x]
            if own < least or own <= 0.0:
                continue
            a, b, c, count = 0.0, 0.0, own, 0.0
            is_plane = False
            for step in range(2):
                gate = 0.05 * own if step == 0 else 3.0 * spread + 0.002 * own
                n = su = sv = sd = suu = suv = svv = sud = svd = 0.0
                for dy in range(-_RADIUS, _RADIUS + 1):
                    for dx in range(-_RADIUS, _RADIUS + 1):
                        d = inverse[y + dy, x + dx]
                        if d <= 0.0 or abs(d - (c + a * dx + b * dy)) > gate:
                            continue
                        n += 1.0
                        su += dx
                        sv += dy
                        sd += d
                        suu += dx * dx
                        suv += dx * dy
                        svv += dy * dy
                        sud += dx * d
                        svd += dy * d
                is_plane = False
                if n < _LEAST_CELLS:
                    break
                cuu, cuv, cvv = suu - su * su / n, suv - su * sv / n, svv - sv * sv / n
                cud, cvd = sud - su * sd / n, svd - sv * sd / n
                determinant = cuu * cvv - cuv * cuv
                if determinant < 1e-2 * (cuu + cvv) * (cuu + cvv):
                    break
                a = (cud * cvv - cvd * cuv) / determinant
                b = (cvd * cuu - cud * cuv) / determinant
                c = (sd - a * su - b * sv) / n
                count = n
                is_plane = True
            if not is_plane or c <= 0.0 or abs(c - own) > 4.0 * spread + 0.002 * own:
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
