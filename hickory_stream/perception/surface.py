"""The visible surface of a frame: cleaned depth at working resolution, points and normals in the world.

Planes are linear in inverse depth, where stereo cameras have uniform noise: normals come from a least-squares plane in
it, then from one over the inliers of the first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.base.ranges import Ranged, check_order, check_ranges, number
from hickory_stream.geometry import portable
from hickory_stream.geometry.camera import Camera, backproject
from hickory_stream.geometry.rigid import apply, compose, invert
from hickory_stream.records import Frame

# Half the side of the window of a normal.
_NORMAL_RADIUS_PX = 3


@dataclass(frozen=True, kw_only=True, slots=True)
class SurfaceConfig(Ranged):
    """How the surface is computed from depth."""

    #: Width at which frames are segmented; larger frames are reduced by a whole factor.
    width_px: int = number(320, 32, 8192, "px")
    #: Farther returns are ignored.
    max_depth_m: float = number(6.0, 0.1, 1000, "m")
    #: Nearer returns are ignored.
    min_depth_m: float = number(0.2, 0, 100, "m")

    def __post_init__(self) -> None:
        check_ranges(self)
        check_order(self, "min_depth_m", "max_depth_m")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Surface:
    """The surface at working resolution (h, w); NaN where there is none."""

    #: frame pixels per working pixel, along each side
    factor: int
    camera: Camera
    depth_m: NDArray[np.float32]
    points_world: NDArray[np.float32]
    #: (h, w, 3) unit, looking at the camera
    normals_world: NDArray[np.float32]
    #: (h, w, 3) CIE Lab
    lab: NDArray[np.float32]
    #: (h, w) standard deviation of depth
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
    normals_camera = _normals(depth, u, v, _NORMAL_RADIUS_PX, np.float32(frame.sensor.spread_per_m))
    return Surface(
        factor=factor,
        camera=camera,
        depth_m=depth,
        points_world=apply(frame.world_from_camera, backproject(depth, camera)),
        normals_world=portable.moved(normals_camera, frame.world_from_camera[:3, :3], np.zeros(3)),
        lab=lab_of(rgb),
        sigma_m=frame.sensor.sigma_m(depth),
        world_from_camera=frame.world_from_camera,
    )


def lab_of(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return (h, w, 3) CIE Lab, in which Euclidean distance is perceived difference; lightness in 0..100."""
    return np.asarray(cv2.cvtColor(rgb.astype(np.float32) / np.float32(255), cv2.COLOR_RGB2LAB))


def moved_surface(surface: Surface, world_from_camera: NDArray[np.float64]) -> Surface:
    """Return the surface of a frame at another pose (4, 4)."""
    turn = compose(world_from_camera, invert(surface.world_from_camera))[:3, :3]
    return replace(
        surface,
        points_world=apply(world_from_camera, backproject(surface.depth_m, surface.camera)),
        normals_world=portable.moved(surface.normals_world, turn, np.zeros(3)),
        world_from_camera=world_from_camera,
    )


def _reduce_depth(
    depth: NDArray[np.float32], factor: int, height: int, width: int, nearest_m: float, farthest_m: float
) -> NDArray[np.float32]:
    # The lower median of valid depths of a block is a measured depth, and thin objects survive.
    out: NDArray[np.float32]
    if factor == 2:
        out = _median_of_four(depth, height, width, nearest_m, farthest_m)
    else:
        out = _median_of_blocks(depth, factor, height, width, nearest_m, farthest_m)
    return out


@kernel
def _median_of_blocks(depth, factor, height, width, nearest, farthest):
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


@kernel
def _median_of_four(depth, height, width, nearest, farthest):
    # The same as `_median_of_blocks` for the usual blocks of 2 x 2, without branches: vectorised.
    out = np.empty((height, width), dtype=np.float32)
    none = np.float32(np.inf)
    for y in range(height):
        for x in range(width):
            a, b = depth[2 * y, 2 * x], depth[2 * y, 2 * x + 1]
            c, d = depth[2 * y + 1, 2 * x], depth[2 * y + 1, 2 * x + 1]
            has_a, has_b = (nearest <= a) & (a <= farthest), (nearest <= b) & (b <= farthest)
            has_c, has_d = (nearest <= c) & (c <= farthest), (nearest <= d) & (d <= farthest)
            a, b, c, d = a if has_a else none, b if has_b else none, c if has_c else none, d if has_d else none
            count = np.int32(has_a) + np.int32(has_b) + np.int32(has_c) + np.int32(has_d)
            least = min(min(a, b), min(c, d))
            second = min(max(min(a, b), min(c, d)), min(max(a, b), max(c, d)))
            z = second if count > 2 else least
            out[y, x] = z if count > 0 else np.float32(np.nan)
    return out


@kernel
def _without_flying_pixels(depth):
    # Flying pixels, between two surfaces, have fewer than three of their eight neighbours within 4 % of their depth. A
    # pixel without a nearer neighbour may be a thin object and needs two. A row at a time: vectorised.
    height, width = depth.shape
    padded = np.full((height + 2, width + 2), np.float32(np.nan), dtype=np.float32)
    padded[1 : height + 1, 1 : width + 1] = depth
    out = np.empty((height, width), dtype=np.float32)
    agreeing, nearer = np.empty(width, dtype=np.int32), np.empty(width, dtype=np.int32)
    for y in range(height):
        agreeing[:], nearer[:] = 0, 0
        for side in range(9):
            row = padded[y + side // 3, side % 3 : side % 3 + width]
            for x in range(width):
                z = depth[y, x]
                agrees = abs(row[x] - z) < 0.04 * z
                agreeing[x] += agrees
                nearer[x] += (row[x] < z) & (not agrees)
        for x in range(width):
            # The pixel itself is counted, too.
            is_flying = (agreeing[x] < 4) & ((nearer[x] > 0) | (agreeing[x] < 3))
            out[y, x] = np.float32(np.nan) if is_flying else depth[y, x]
    return out


@kernel(error_model="numpy")
def _normals(depth, u, v, radius, noise):
    # Fit 1/z = a du + b dv + c over each window; (a, b, c) gives the plane's normal in the camera frame. Two fits: to
    # all pixels within 3 % of the depth, then within 3 sigma of the first plane. The sums of a row are accumulated
    # offset by offset, vectorised. Inverse depths relative to the centre fit single precision.
    height, width = depth.shape
    out = np.full((height, width, 3), np.nan, dtype=np.float32)
    padded_width = width + 2 * radius
    # Pixels without a return, or beyond the image, get an inverse depth outside of every gate.
    inverses = np.full((height + 2 * radius, padded_width), np.float32(-1e6), dtype=np.float32)
    for y in range(height):
        for x in range(width):
            if not np.isnan(depth[y, x]):
                inverses[y + radius, x + radius] = np.float32(1.0) / depth[y, x]
    step_u, step_v = u[1] - u[0], v[1] - v[0]
    planes = np.empty((3, width), dtype=np.float32)
    sums = np.empty((9, width), dtype=np.float32)
    gates, has_plane = np.empty(width, dtype=np.float32), np.empty(width, dtype=np.bool_)
    for y in range(height):
        own = inverses[y + radius, radius : radius + width]
        planes[:] = np.float32(0.0)
        for step in range(2):
            share = np.float32(0.03 if step == 0 else 0.003)
            floor = np.float32(0.0) if step == 0 else np.float32(3.0) * noise
            for x in range(width):
                gates[x] = floor + share * own[x]
            _sum_windows(inverses, y, own, gates, planes, sums, radius, step_u, step_v)
            _solve_planes(sums, planes, has_plane, step == 0)
        for x in range(width):
            # The plane in absolute (u, v): 1/z = a U + b V + (c - a u - b v); negated, its normal faces the camera.
            nx, ny = planes[0, x], planes[1, x]
            nz = own[x] + planes[2, x] - nx * u[x] - ny * v[y]
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            has_normal = has_plane[x] & (own[x] >= np.float32(0.0)) & (length > np.float32(0.0))
            length = length if has_normal else np.float32(np.nan)
            out[y, x, 0], out[y, x, 1], out[y, x, 2] = -nx / length, -ny / length, -nz / length
    return out


@kernel
def _sum_windows(inverses, y, own, gates, planes, sums, radius, step_u, step_v):
    # n, u, v, d, uu, uv, vv, ud, vd over the pixels within the gate.
    width, one, none = len(own), np.float32(1.0), np.float32(0.0)
    sums[:] = np.float32(0.0)
    for dy in range(-radius, radius + 1):
        dv = np.float32(dy) * step_v
        for dx in range(-radius, radius + 1):
            du = np.float32(dx) * step_u
            row = inverses[y + radius + dy, radius + dx : radius + dx + width]
            uu, uv, vv = du * du, du * dv, dv * dv
            for x in range(width):
                d = row[x] - own[x]
                off = abs(d - (planes[2, x] + planes[0, x] * du + planes[1, x] * dv))
                is_in = off <= gates[x]
                sums[0, x] += one if is_in else none
                sums[1, x] += du if is_in else none
                sums[2, x] += dv if is_in else none
                sums[3, x] += d if is_in else none
                sums[4, x] += uu if is_in else none
                sums[5, x] += uv if is_in else none
                sums[6, x] += vv if is_in else none
                sums[7, x] += d * du if is_in else none
                sums[8, x] += d * dv if is_in else none


@kernel(error_model="numpy")
def _solve_planes(sums, planes, has_plane, is_first):
    # Without branches: vectorised. The plane stays the first fit's if the second has no solution.
    for x in range(sums.shape[1]):
        n, su, sv, sd = sums[0, x], sums[1, x], sums[2, x], sums[3, x]
        cuu, cuv, cvv = sums[4, x] - su * su / n, sums[5, x] - su * sv / n, sums[6, x] - sv * sv / n
        cud, cvd = sums[7, x] - su * sd / n, sums[8, x] - sv * sd / n
        determinant = cuu * cvv - cuv * cuv
        is_solved = (n >= np.float32(6.0)) & (determinant >= np.float32(1e-3) * ((cuu + cvv) * (cuu + cvv)))
        a = (cud * cvv - cvd * cuv) / determinant
        b = (cvd * cuu - cud * cuv) / determinant
        c = (sd - a * su - b * sv) / n
        if is_first:
            has_plane[x] = is_solved
        planes[0, x] = a if is_solved else planes[0, x]
        planes[1, x] = b if is_solved else planes[1, x]
        planes[2, x] = c if is_solved else planes[2, x]
