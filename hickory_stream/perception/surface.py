"""The visible surface of a frame: cleaned depth at working resolution, points and normals in the world.

Planes are linear in inverse depth, and a stereo or structured-light camera has the same noise everywhere in it: normals
come from a least-squares plane in inverse depth, twice, the second time over the inliers of the first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numba
import numpy as np

from hickory_stream.geometry.camera import Camera, backproject
from hickory_stream.geometry.rigid import apply

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.records import Frame


@dataclass(frozen=True, kw_only=True, slots=True)
class SurfaceConfig:
    """How the surface is taken from depth.

    Attributes:
        width_px: width at which frames are segmented; larger frames are reduced by a whole factor.
        max_depth_m: returns beyond are ignored.
        min_depth_m: returns nearer are ignored.
        depth_noise_per_m: sigma_z = depth_noise_per_m * z^2 (m per m^2), with a floor of 1 mm.
        normal_radius_px: half the side of the window of a normal.
    """

    width_px: int = 320
    max_depth_m: float = 6.0
    min_depth_m: float = 0.2
    depth_noise_per_m: float = 0.0025
    normal_radius_px: int = 3


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Surface:
    """The surface at working resolution (h, w); NaN where there is none.

    `depth_m` (h, w), `points_world` and `normals_world` (h, w, 3; normals look at the camera), `rgb` (h, w, 3) uint8,
    `sigma_m` (h, w): the standard deviation of depth. `factor` frame pixels make one working pixel.
    """

    factor: int
    camera: Camera
    depth_m: NDArray[np.float32]
    points_world: NDArray[np.float32]
    normals_world: NDArray[np.float32]
    rgb: NDArray[np.uint8]
    sigma_m: NDArray[np.float32]
    world_from_camera: NDArray[np.float64]


def surface_of(frame: Frame, config: SurfaceConfig) -> Surface:
    """Return the surface of a frame at working resolution."""
    factor = max(1, round(frame.camera.width / config.width_px))
    height, width = frame.camera.height // factor, frame.camera.width // factor
    camera = Camera(
        width=width,
        height=height,
        fx=frame.camera.fx / factor,
        fy=frame.camera.fy / factor,
        cx=(frame.camera.cx + 0.5) / factor - 0.5,
        cy=(frame.camera.cy + 0.5) / factor - 0.5,
    )
    depth = _reduce_depth(frame.depth_m, factor, height, width, config.min_depth_m, config.max_depth_m)
    depth = _without_flying_pixels(depth)
    rgb = frame.rgb[: height * factor, : width * factor]
    if factor > 1:
        rgb = cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA)
    u = ((np.arange(width) - camera.cx) / camera.fx).astype(np.float32)
    v = ((np.arange(height) - camera.cy) / camera.fy).astype(np.float32)
    normals_camera = _normals(depth, u, v, config.normal_radius_px, np.float32(config.depth_noise_per_m))
    return Surface(
        factor=factor,
        camera=camera,
        depth_m=depth,
        points_world=apply(frame.world_from_camera, backproject(depth, camera)),
        normals_world=normals_camera @ frame.world_from_camera[:3, :3].T.astype(np.float32),
        rgb=rgb,
        sigma_m=np.maximum(config.depth_noise_per_m * depth * depth, np.float32(1e-3)).astype(np.float32),
        world_from_camera=frame.world_from_camera,
    )


@numba.njit(cache=True, nogil=True)
def _reduce_depth(depth, factor, height, width, nearest, farthest):  # type: ignore[no-untyped-def] # pragma: no cover
    """Take the lower median of the valid depths of each block: no depth is invented, and what is thin survives."""
    out = np.full((height, width), np.nan, dtype=np.float32)
    block = np.empty(factor * factor, dtype=np.float32)
    for y in range(height):
        for x in range(width):
            count = 0
            for dy in range(factor):
                for dx in range(factor):
                    z = depth[y * factor + dy, x * factor + dx]
                    if nearest <= z <= farthest:
                        i = count
                        while i > 0 and block[i - 1] > z:
                            block[i] = block[i - 1]
                            i -= 1
                        block[i] = z
                        count += 1
            if count > 0:
                out[y, x] = block[(count - 1) // 2]
    return out


@numba.njit(cache=True, nogil=True)
def _without_flying_pixels(depth):  # type: ignore[no-untyped-def] # pragma: no cover
    """Remove pixels that fewer than three of their eight neighbours agree with, to 4 % of the depth.

    Flying pixels lie between two surfaces; a pixel that nothing is before may be part of a thin thing, and two suffice.
    """
    height, width = depth.shape
    out = depth.copy()
    for y in range(height):
        for x in range(width):
            z = depth[y, x]
            if np.isnan(z):
                continue
            agreeing, nearer = 0, 0
            for yy in range(max(0, y - 1), min(height, y + 2)):
                for xx in range(max(0, x - 1), min(width, x + 2)):
                    if abs(depth[yy, xx] - z) < 0.04 * z:
                        agreeing += 1
                    elif depth[yy, xx] < z:
                        nearer += 1
            if agreeing < 4 and (nearer > 0 or agreeing < 3):  # it agrees with itself
                out[y, x] = np.nan
    return out


@numba.njit(cache=True, nogil=True)
def _normals(depth, u, v, radius, noise):  # type: ignore[no-untyped-def] # pragma: no cover
    """Fit 1/z = a u + b v + c over each window; (a, b, c) is the plane's normal in the camera frame."""
    height, width = depth.shape
    out = np.full((height, width, 3), np.nan, dtype=np.float32)
    inverses = np.float32(1.0) / depth
    for y in range(height):
        for x in range(width):
            inverse = inverses[y, x]
            if np.isnan(inverse):
                continue
            a, b, c = 0.0, 0.0, inverse
            solved = False
            for step in range(2):
                # First everything within 3 % of the depth, then what lies within 3 sigma of the first plane.
                gate = 0.03 * inverse if step == 0 else 3.0 * noise + 0.003 * inverse
                n = 0
                suu = suv = svv = su = sv = sud = svd = sd = 0.0
                for yy in range(max(0, y - radius), min(height, y + radius + 1)):
                    for xx in range(max(0, x - radius), min(width, x + radius + 1)):
                        du, dv = u[xx] - u[x], v[yy] - v[y]
                        d = inverses[yy, xx]
                        if not abs(d - (c + a * du + b * dv)) <= gate:  # NaN fails too
                            continue
                        n += 1
                        su += du
                        sv += dv
                        sd += d
                        suu += du * du
                        suv += du * dv
                        svv += dv * dv
                        sud += du * d
                        svd += dv * d
                if n < 6:
                    break
                cuu, cuv, cvv = suu - su * su / n, suv - su * sv / n, svv - sv * sv / n
                cud, cvd = sud - su * sd / n, svd - sv * sd / n
                determinant = cuu * cvv - cuv * cuv
                if determinant < 1e-3 * (cuu + cvv) ** 2:
                    break
                a = (cud * cvv - cvd * cuv) / determinant
                b = (cvd * cuu - cud * cuv) / determinant
                c = (sd - a * su - b * sv) / n
                solved = True
            if not solved:
                continue
            # The plane in absolute (u, v): 1/z = a U + b V + (c - a u - b v); it looks at the camera with a minus sign.
            nx, ny, nz = a, b, c - a * u[x] - b * v[y]
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            if length > 0.0:
                out[y, x, 0], out[y, x, 1], out[y, x, 2] = -nx / length, -ny / length, -nz / length
    return out
