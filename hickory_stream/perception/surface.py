"""The visible surface of a frame: cleaned depth at working resolution, points and normals in the world.

Planes are linear in inverse depth, where stereo cameras have uniform noise: normals come from a least-squares plane in
it, then from one over the inliers of the first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.base.ranges import Ranged, number
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
    #: Nearer returns are ignored.
    min_depth_m: float = number(0.2, 0, 100, "m")


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
    depth = _reduce_depth(frame.depth_m, factor, height, width, config.min_depth_m)
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
    depth: NDArray[np.float32], factor: int, height: int, width: int, nearest_m: float
) -> NDArray[np.float32]:
    # The lower median of valid depths of a block is a measured depth, and thin objects survive.
    depth = depth[: height * factor, : width * factor]
    depth = np.where(depth >= np.float64(nearest_m), depth, np.float32(np.inf))
    ranked = [depth[i // factor :: factor, i % factor :: factor] for i in range(factor * factor)]
    for i, j in _sorting_network(len(ranked)):
        ranked[i], ranked[j] = np.minimum(ranked[i], ranked[j]), np.maximum(ranked[i], ranked[j])
    out = ranked[0]
    for i in range(1, (len(ranked) + 1) // 2):
        out = np.where(np.isfinite(ranked[2 * i]), ranked[i], out)
    out[np.isinf(out)] = np.nan
    return out


@cache
def _sorting_network(count: int) -> tuple[tuple[int, int], ...]:
    # The pairs to put in order, one after the other, which sorts so many values (Batcher 1968).
    pairs = list[tuple[int, int]]()
    spans = [1 << i for i in range((count - 1).bit_length())]
    for span in spans:
        for apart in spans[span.bit_length() - 1 :: -1]:
            for first in range(apart % span, count - apart, 2 * apart):
                steps = range(first, min(first + apart, count - apart))
                pairs += [(i, i + apart) for i in steps if i // (2 * span) == (i + apart) // (2 * span)]
    return tuple(pairs)


def _without_flying_pixels(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    # Flying pixels, between two surfaces, have fewer than three of their eight neighbours within 4 % of their depth. A
    # pixel without a nearer neighbour may be a thin object and needs two.
    height, width = depth.shape
    padded, gate = np.pad(depth, 1, constant_values=np.nan), np.float64(0.04) * depth
    agreeing, has_nearer = np.zeros(depth.shape, dtype=np.int8), np.zeros(depth.shape, dtype=bool)
    for y, x in np.ndindex(3, 3):
        other = padded[y : y + height, x : x + width]
        agrees = np.abs(other - depth) < gate
        agreeing += agrees
        has_nearer |= (other < depth) & ~agrees
    # The pixel itself is counted, too.
    is_flying = (agreeing < 4) & (has_nearer | (agreeing < 3))
    return np.where(is_flying, np.float32(np.nan), depth)


def _normals(
    depth: NDArray[np.float32], u: NDArray[np.float32], v: NDArray[np.float32], radius: int, noise: np.float32
) -> NDArray[np.float32]:
    # Fit 1/z = a du + b dv + c over each window; (a, b, c) gives the plane's normal in the camera frame. Two fits: to
    # all pixels within 3 % of the depth, then within 3 sigma of the first plane. Inverse depths relative to the centre
    # fit single precision.
    height, width = depth.shape
    # Pixels without a return, or beyond the image, get an inverse depth outside of every gate.
    inverses = np.full((height + 2 * radius, width + 2 * radius), np.float32(-1e6))
    own = inverses[radius : radius + height, radius : radius + width]
    planes, sums = np.zeros((height, 3, width), np.float32), np.empty((height, 9, width), np.float32)
    has_plane, is_solved = np.empty((2, height, width), bool)
    steps = [np.diff(side[:2]).sum() for side in (u, v)]  # 0 of a single pixel
    with np.errstate(divide="ignore", invalid="ignore"):
        np.divide(np.float32(1), depth, out=own, where=~np.isnan(depth))
        _sum_windows(inverses, planes, np.float32(0.03) * own, sums, radius, *steps)
        _solve_planes(sums, planes, has_plane)
        gates = np.float32(3) * noise + np.float32(0.003) * own
        _sum_windows(inverses, planes, gates, sums, radius, *steps)
        _solve_planes(sums, planes, is_solved)
        # The plane in absolute (u, v): 1/z = a U + b V + (c - a u - b v); negated, its normal faces the camera.
        a, b, c = planes.swapaxes(0, 1)
        c = own + c - a * u - b * v[:, None]
        length = np.sqrt(a * a + b * b + c * c)
        has_normal = has_plane & (own >= 0) & (length > 0)
        length = np.where(has_normal, -length, np.float32(np.nan))
        return np.stack([a / length, b / length, c / length], axis=2)


@kernel
def _sum_windows(inverses, planes, gates, sums, radius, step_u, step_v):
    # n, u, v, d, uu, uv, vv, ud, vd over the pixels within the gates. The sums of a row are accumulated offset by
    # offset, vectorised.
    height, width = gates.shape
    one, none = np.float32(1.0), np.float32(0.0)
    for y in range(height):
        own, plane, gate, total = inverses[y + radius, radius : radius + width], planes[y], gates[y], sums[y]
        total[:] = none
        for dy in range(-radius, radius + 1):
            dv = np.float32(dy) * step_v
            for dx in range(-radius, radius + 1):
                du = np.float32(dx) * step_u
                row = inverses[y + radius + dy, radius + dx : radius + dx + width]
                uu, uv, vv = du * du, du * dv, dv * dv
                for x in range(width):
                    d = row[x] - own[x]
                    off = abs(d - (plane[2, x] + plane[0, x] * du + plane[1, x] * dv))
                    is_in = off <= gate[x]
                    total[0, x] += one if is_in else none
                    total[1, x] += du if is_in else none
                    total[2, x] += dv if is_in else none
                    total[3, x] += d if is_in else none
                    total[4, x] += uu if is_in else none
                    total[5, x] += uv if is_in else none
                    total[6, x] += vv if is_in else none
                    total[7, x] += d * du if is_in else none
                    total[8, x] += d * dv if is_in else none


@kernel(error_model="numpy")
def _solve_planes(sums, planes, has_plane):
    # Without branches: vectorised. Without a solution the plane stays as it is.
    for y in range(len(sums)):
        own, plane = sums[y], planes[y]
        for x in range(own.shape[1]):
            n, su, sv, sd = own[0, x], own[1, x], own[2, x], own[3, x]
            cuu, cuv, cvv = own[4, x] - su * su / n, own[5, x] - su * sv / n, own[6, x] - sv * sv / n
            cud, cvd = own[7, x] - su * sd / n, own[8, x] - sv * sd / n
            determinant = cuu * cvv - cuv * cuv
            is_solved = (n >= np.float32(6.0)) & (determinant >= np.float32(1e-3) * ((cuu + cvv) * (cuu + cvv)))
            a = (cud * cvv - cvd * cuv) / determinant
            b = (cvd * cuu - cud * cuv) / determinant
            c = (sd - a * su - b * sv) / n
            has_plane[y, x] = is_solved
            plane[0, x] = a if is_solved else plane[0, x]
            plane[1, x] = b if is_solved else plane[1, x]
            plane[2, x] = c if is_solved else plane[2, x]
