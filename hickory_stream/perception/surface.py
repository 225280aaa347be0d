"""The visible surface of a frame: cleaned depth at working resolution, points and normals in the world.

Planes are linear in inverse depth, where stereo cameras have uniform noise: normals come from a least-squares plane in
it, then from one over the inliers of the first.
"""

from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.base.ranges import Ranged, number
from hickory_stream.geometry import portable
from hickory_stream.geometry.arrays import read_only
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
    depth = _without_flying_pixels(_reduce_depth(frame.depth_m, factor, height, width))
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
    return np.asarray(cv2.cvtColor(np.divide(rgb, 255, dtype=np.float32), cv2.COLOR_RGB2LAB))


def moved_surface(surface: Surface, world_from_camera: NDArray[np.float64]) -> Surface:
    """Return the surface of a frame at another pose (4, 4)."""
    turn = compose(world_from_camera, invert(surface.world_from_camera))[:3, :3]
    return replace(
        surface,
        points_world=apply(world_from_camera, backproject(surface.depth_m, surface.camera)),
        normals_world=portable.moved(surface.normals_world, turn, np.zeros(3)),
        world_from_camera=world_from_camera,
    )


def _reduce_depth(depth: NDArray[np.float32], factor: int, height: int, width: int) -> NDArray[np.float32]:
    # The lower median of valid depths of a block is a measured depth, and thin objects survive.
    out = np.empty((height, width), np.float32)
    _reduce(read_only(depth), factor, _sorting_network(factor * factor), out)
    return out


@kernel
def _reduce(depth, factor, pairs, out):
    # `pairs` (N, 2) in turn put the depths of a block in order; loops over a row are vectorised.
    width, count = out.shape[1], factor * factor
    ranked = np.empty((count, width), np.float32)
    for y in range(len(out)):
        for i in range(count):
            row = depth[y * factor + i // factor]
            for x in range(width):
                value = row[x * factor + i % factor]
                ranked[i, x] = value if value > 0 else np.float32(np.inf)
        for pair in pairs:
            low, high = ranked[pair[0]], ranked[pair[1]]
            for x in range(width):
                a, b = low[x], high[x]
                low[x], high[x] = min(a, b), max(a, b)
        for i in range((count + 1) // 2):
            chosen, full = ranked[i], ranked[2 * i]
            for x in range(width):
                if i == 0 or full[x] < np.float32(np.inf):
                    out[y, x] = chosen[x] if chosen[x] < np.float32(np.inf) else np.float32(np.nan)


@cache
def _sorting_network(count: int) -> NDArray[np.int64]:
    # The pairs to put in order, one after the other, which sorts so many values (Batcher 1968).
    pairs = list[tuple[int, int]]()
    spans = [1 << i for i in range((count - 1).bit_length())]
    for span in spans:
        for apart in spans[span.bit_length() - 1 :: -1]:
            for first in range(apart % span, count - apart, 2 * apart):
                steps = range(first, min(first + apart, count - apart))
                pairs += [(i, i + apart) for i in steps if i // (2 * span) == (i + apart) // (2 * span)]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def _without_flying_pixels(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    # Flying pixels, between two surfaces, have fewer than three of their eight neighbours within 4 % of their depth. A
    # pixel without a nearer neighbour may be a thin object and needs two.
    return np.asarray(_without_flying(np.pad(depth, 1, constant_values=np.nan)))


@kernel
def _without_flying(padded):
    height, width = padded.shape[0] - 2, padded.shape[1] - 2
    out = np.empty((height, width), np.float32)
    agreeing, has_nearer = np.empty(width, np.int8), np.empty(width, np.bool_)
    for y in range(height):
        own = padded[y + 1, 1 : 1 + width]
        agreeing[:] = 0
        has_nearer[:] = False
        for side in range(9):
            first = side % 3
            other = padded[y + side // 3, first : first + width]
            for x in range(width):
                agrees = np.float64(abs(other[x] - own[x])) < 0.04 * np.float64(own[x])
                agreeing[x] += np.int8(agrees)
                has_nearer[x] |= (other[x] < own[x]) & ~agrees
        for x in range(width):
            # The pixel itself is counted, too.
            is_flying = (agreeing[x] < 4) & (has_nearer[x] | (agreeing[x] < 3))
            out[y, x] = np.float32(np.nan) if is_flying else own[x]
    return out


def _normals(
    depth: NDArray[np.float32], u: NDArray[np.float32], v: NDArray[np.float32], radius: int, noise: np.float32
) -> NDArray[np.float32]:
    # Fit 1/z = a du + b dv + c over each window; (a, b, c) gives the plane's normal in the camera frame. Two fits: to
    # all pixels within 3 % of the depth, then within 3 sigma of the first plane. Inverse depths relative to the centre
    # fit single precision.
    height, width = depth.shape
    # Pixels without a return, or beyond the image, get an inverse depth outside of every gate.
    inverses = np.full((height + 2 * radius, width + 2 * radius), np.float32(-1e6))
    np.divide(np.float32(1), depth, out=inverses[radius : radius + height, radius : radius + width], where=depth > 0)
    step_u, step_v = (np.diff(side[:2]).sum() for side in (u, v))  # 0 of a single pixel
    return np.asarray(_fitted(inverses, u, v, radius, step_u, step_v, noise))


@kernel(error_model="numpy")
def _fitted(inverses, u, v, radius, step_u, step_v, noise):
    # Row by row and run by run of returns: half of a frame outdoors has none.
    height, width = len(v), len(u)
    out = np.full((height, width, 3), np.float32(np.nan), np.float32)
    room, has_plane, is_solved = np.empty(13 * width, np.float32), np.empty(width, np.bool_), np.empty(width, np.bool_)
    for y in range(height):
        stop = 0
        while True:
            start, stop = _next_run(inverses[y + radius, radius : radius + width], stop)
            if start == stop:
                break
            # Contiguous, so that loops over a run are vectorised.
            count = stop - start
            sums, plane = room[: 9 * count].reshape(9, count), room[9 * count : 12 * count].reshape(3, count)
            own, gate = inverses[y + radius, radius + start : radius + stop], room[12 * count : 13 * count]
            plane[:] = np.float32(0.0)
            for x in range(count):
                gate[x] = np.float32(0.03) * own[x]
            _sum_windows(inverses, y, start, plane, gate, sums, radius, step_u, step_v)
            _solve_planes(sums, plane, has_plane)
            for x in range(count):
                gate[x] = np.float32(3.0) * noise + np.float32(0.003) * own[x]
            _sum_windows(inverses, y, start, plane, gate, sums, radius, step_u, step_v)
            _solve_planes(sums, plane, is_solved)
            _face(own, plane, has_plane, u[start:stop], v[y], out[y, start:stop])
    return out


@kernel
def _next_run(own, start):
    # The next columns with returns, from `start` on: gaps of less than a vector are part of a run.
    while start < len(own) and own[start] < np.float32(0.0):
        start += 1
    stop = last = start
    while last < len(own) and last - stop < 32:
        last += 1
        if own[last - 1] >= np.float32(0.0):
            stop = last
    return start, stop


@kernel(error_model="numpy")
def _face(own, plane, has_plane, u, v, out):
    # The plane in absolute (u, v): 1/z = a U + b V + (c - a u - b v); negated, its normal faces the camera.
    for x in range(len(own)):
        a, b = plane[0, x], plane[1, x]
        c = own[x] + plane[2, x] - a * u[x] - b * v
        length = np.sqrt(a * a + b * b + c * c)
        if has_plane[x] and own[x] >= np.float32(0.0) and length > np.float32(0.0):
            out[x, 0], out[x, 1], out[x, 2] = a / -length, b / -length, c / -length


@kernel
def _sum_windows(inverses, y, start, plane, gate, total, radius, step_u, step_v):
    # n, u, v, d, uu, uv, vv, ud, vd over the pixels within the gates. The sums of a run are accumulated offset by
    # offset, vectorised.
    one, none = np.float32(1.0), np.float32(0.0)
    first, count = radius + start, len(gate)
    own = inverses[y + radius, first : first + count]
    total[:] = none
    for dy in range(-radius, radius + 1):
        dv = np.float32(dy) * step_v
        for dx in range(-radius, radius + 1):
            du = np.float32(dx) * step_u
            row = inverses[y + radius + dy, first + dx : first + dx + count]
            uu, uv, vv = du * du, du * dv, dv * dv
            for x in range(count):
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
def _solve_planes(sums, plane, has_plane):
    # Without branches: vectorised. Without a solution the plane stays as it is.
    for x in range(sums.shape[1]):
        n, su, sv, sd = sums[0, x], sums[1, x], sums[2, x], sums[3, x]
        cuu, cuv, cvv = sums[4, x] - su * su / n, sums[5, x] - su * sv / n, sums[6, x] - sv * sv / n
        cud, cvd = sums[7, x] - su * sd / n, sums[8, x] - sv * sd / n
        determinant = cuu * cvv - cuv * cuv
        is_solved = (n >= np.float32(6.0)) & (determinant >= np.float32(1e-3) * ((cuu + cvv) * (cuu + cvv)))
        a = (cud * cvv - cvd * cuv) / determinant
        b = (cvd * cuu - cud * cuv) / determinant
        c = (sd - a * su - b * sv) / n
        has_plane[x] = is_solved
        plane[0, x] = a if is_solved else plane[0, x]
        plane[1, x] = b if is_solved else plane[1, x]
        plane[2, x] = c if is_solved else plane[2, x]
