"""Lifting of masks to 3D: filtered world points of each instance, its box, and R_area and R_depth of its S-score."""

import zlib
from dataclasses import dataclass
from math import isqrt

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.camera import Camera, whole_reduction
from hickory_stream.geometry.depth_sensor import Law, information, sigma_at
from hickory_stream.geometry.flush import Plane, flush_heights, plane_beside
from hickory_stream.geometry.lattice import STEPS_PER_M, Lattice, on_steps
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.voxels import groups_of, keys_of_points, without_outliers
from hickory_stream.perception.fragments.color_split import COLOR_STEP, LAB_WEIGHTS
from hickory_stream.perception.masks import label_boxes
from hickory_stream.perception.surface import lab_of
from hickory_stream.records import Frame, Observation, RejectedMask, Returns, Segmentation

# Players convert the cameras' millimetres to metres by this factor.
MILLIMETRE, MOST_MM = np.float32(0.001), 65535

# Near the rim of a mask a return counts only within this many sigmas of depth of its neighbour further inside.
_AGREE_SIGMAS = 3.0
# A return needs at least this many of its 24 neighbours within those sigmas of its depth.
_MIN_NEIGHBORS = 5
# A mask with fewer returns is rejected, and so is one whose returns lie in fewer cells.
_MIN_RETURNS = 24
_MIN_POINTS = 12
# The rim of a mask lies this far outside. A mask as wide as this is looked at at half resolution.
_RIM_PX, _WIDE_PX = 3, 48
# About so many pixels around a mask and in it are looked at for the surface that it is flush with.
_BESIDE_PX = 600


def observe(
    frame: Frame, segmentation: Segmentation, lattice: Lattice
) -> tuple[tuple[Observation, ...], tuple[RejectedMask, ...]]:
    """Return the observations of a frame in the order of their labels, and the rejected masks with reasons."""
    observations: list[Observation] = []
    rejected: list[RejectedMask] = list(segmentation.rejected)
    alone = segmentation.alone
    for box_px, mask in _masks(segmentation.instances):
        lifted = _lift(frame, box_px, mask, lattice.object_m)
        if isinstance(lifted, str):
            rejected.append(RejectedMask(box_px=box_px, reason=lifted, mask=mask))
            continue
        observations.append(
            Observation(
                index=len(observations),
                box_px=box_px,
                mask=mask,
                points_world=lifted.points,
                colors=lifted.colors,
                box=gravity_aligned_box(lifted.inliers, lattice.object_m),
                r_area=float(np.count_nonzero(mask)) / mask_area_of(frame.camera),
                r_depth=lifted.valid_share,
                is_cut=_touches_border(box_px, frame.camera),
                group=0 if alone is None else _group(alone, box_px, mask),
                returns=lifted.returns,
                behind=_behind(frame, box_px, mask, lifted.points),
                drawn=_drawn(frame, box_px, mask),
            )
        )
    return tuple(observations), tuple(rejected)


def mask_area_of(camera: Camera) -> float:
    """Return H x W, the denominator of R_area."""
    return float(camera.width * camera.height)


def _masks(instances: NDArray[np.int32]) -> list[tuple[tuple[int, int, int, int], NDArray[np.bool_]]]:
    boxes = label_boxes(instances, int(instances.max(initial=0)) + 1).tolist()
    places = [(i, (x0, y0, x1, y1)) for i, (x0, y0, x1, y1) in enumerate(boxes) if y1 > 0]
    return [((x0, y0, x1, y1), instances[y0:y1, x0:x1] == i) for i, (x0, y0, x1, y1) in places]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Lifted:
    # A mask in 3D; `returns` None: their depth is not in whole millimetres.
    points: NDArray[np.float32]
    colors: NDArray[np.uint8]
    inliers: NDArray[np.float32]
    valid_share: float
    returns: Returns | None


def _lift(frame: Frame, box_px: tuple[int, int, int, int], mask: NDArray[np.bool_], voxel_m: float) -> _Lifted | str:
    # A text is the reason why the mask cannot be lifted.
    x0, y0, x1, y1 = box_px
    camera, sensor, step = frame.camera, frame.sensor, whole_reduction(frame.camera.width)
    few = slice(y0, y1, step), slice(x0, x1, step)
    depth, rgb = frame.depth_m[few], frame.rgb[few]
    mask = np.ascontiguousarray(mask[::step, ::step])
    inner = _agreeing(depth, mask, sensor.law, sensor.edge_px(camera.fx / step))
    inner = _with_support(depth, inner, sensor.law, _AGREE_SIGMAS, _MIN_NEIGHBORS)
    points, colors, depth_mm, is_whole, num_reliable = _returns(
        depth, rgb, mask, inner, *rays_of(camera.cropped(*box_px), step)
    )
    if len(points) == 0:
        return "no reliable depth in the mask"
    if len(points) < _MIN_RETURNS:
        return f"{len(points)} sure returns, fewer than {_MIN_RETURNS}"
    points, colors = _means_in_world(points, colors, frame.world_from_camera, voxel_m)
    if len(points) < _MIN_POINTS:
        return f"{len(points)} points, fewer than {_MIN_POINTS}"
    inliers = points[without_outliers(points)]
    checksum = checksum_of(points, frame.world_from_camera)
    returns = Returns(depth_mm=depth_mm, voxel_m=voxel_m, checksum=checksum, step_px=step) if is_whole else None
    share = float(num_reliable / np.count_nonzero(mask))
    return _Lifted(points=points, colors=colors, inliers=inliers, valid_share=share, returns=returns)


def _behind(
    frame: Frame, box_px: tuple[int, int, int, int], mask: NDArray[np.bool_], points: NDArray[np.float32]
) -> Plane | None:
    # The plane of the returns around the mask, an area like its own, if its points are flush with that.
    (x0, y0, x1, y1), camera, law, view = box_px, frame.camera, frame.sensor.law, frame.world_from_camera
    edge_px = frame.sensor.edge_px(camera.fx)
    reach = edge_px + max(4, min(x1 - x0, y1 - y0) // 4)
    left, top, right, bottom = x0 - min(reach, x0), y0 - min(reach, y0), x1 + reach, y1 + reach
    depth = frame.depth_m[top:bottom, left:right]
    rim = np.zeros(depth.shape, np.uint8)
    rim[y0 - top : y1 - top, x0 - left : x1 - left] = mask
    beside = cv2.dilate(rim, np.ones((2 * edge_px + 1, 2 * edge_px + 1), np.uint8)) == 0
    step = max(1, isqrt(rim.size // _BESIDE_PX))
    u, v = rays_of(camera.cropped(left, top, left + depth.shape[1], top + depth.shape[0]))
    plane = plane_beside(depth[::step, ::step], beside[::step, ::step], u[::step], v[::step], law)
    length = portable.norm(plane)
    if length == 0:
        return None
    # n p = d in the camera, with the camera on the side of n.
    normal = portable.matmul(view[:3, :3], -plane[:, None] / length)[:, 0]
    behind = (*normal.tolist(), float(portable.dot(normal, view[:3, 3]) - 1 / length))
    weights = information(points, view, law)
    depth_m = portable.dot(points.mean(axis=0, dtype=np.float64) - view[:3, 3], view[:3, 2])
    width = min((x1 - x0) / camera.fx, (y1 - y0) / camera.fy) * depth_m
    return None if flush_heights(points, weights, 1 / weights, behind, width) is None else behind


def _drawn(frame: Frame, box_px: tuple[int, int, int, int], mask: NDArray[np.bool_]) -> float:
    # The share of the rim with returns beside it or, where they are missing, with a step in colour.
    (x0, y0, x1, y1), (height, width) = box_px, frame.depth_m.shape
    step = whole_reduction(width)
    step *= 1 + (min(mask.shape) >= step * _WIDE_PX)
    reach = step * _RIM_PX
    left, top, right, bottom = max(0, x0 - reach), max(0, y0 - reach), min(width, x1 + reach), min(height, y1 + reach)
    around = (slice(top, bottom, step), slice(left, right, step))
    inside = np.zeros((bottom - top, right - left), np.uint8)
    inside[y0 - top : y1 - top, x0 - left : x1 - left] = mask
    inside = np.ascontiguousarray(inside[::step, ::step])
    near, far = (cv2.dilate(inside, np.ones((2 * px + 1, 2 * px + 1), np.uint8)) for px in (_RIM_PX - 1, _RIM_PX))
    rim = far > near
    # Single lines without returns are artefacts of a sensor.
    unseen = rim & (cv2.dilate((frame.depth_m[around] > 0).astype(np.uint8), np.ones((3, 3), np.uint8)) == 0)
    if not unseen.any():
        return 1.0
    side, rows, columns = (4 * _RIM_PX + 1, 4 * _RIM_PX + 1), unseen.any(axis=1), unseen.any(axis=0)
    # Within the windows around these pixels.
    y, x = (slice(max(0, own.argmax() - side[0]), len(own) - own[::-1].argmax() + side[0]) for own in (rows, columns))
    inside, unseen, lab = inside[y, x].copy(), unseen[y, x], lab_of(frame.rgb[around][y, x]) * LAB_WEIGHTS
    weights = cv2.blur(inside.astype(np.float32), side, borderType=cv2.BORDER_CONSTANT)
    means = cv2.blur(cv2.copyTo(lab, inside), side, borderType=cv2.BORDER_CONSTANT)
    beside = cv2.blur(lab, (3, 3))
    steps = beside[unseen] - means[unseen] / np.maximum(weights[unseen], np.float32(1e-6))[:, None]
    missing = int(np.count_nonzero((steps * steps).sum(axis=1) < COLOR_STEP * COLOR_STEP))
    return 1 - missing / int(np.count_nonzero(rim))


def rays_of(camera: Camera, step_px: int = 1) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the normalised image coordinates of every `step_px`-th column (w,) and row (h,), at a depth of 1."""
    u = ((np.arange(0, camera.width, step_px) - camera.cx) / camera.fx).astype(np.float32)
    return u, ((np.arange(0, camera.height, step_px) - camera.cy) / camera.fy).astype(np.float32)


def _means_in_world(
    points_camera: NDArray[np.float32],
    colors: NDArray[np.uint8],
    world_from_camera: NDArray[np.float64],
    voxel_m: float,
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    # Journals hold returns instead of points (`Returns`): this must give the same points, to the bit.
    points_world = on_steps(apply(world_from_camera, points_camera))
    return voxel_means(points_world, colors, voxel_m)[:2]


def points_of_returns(
    returns: Returns, box_px: tuple[int, int, int, int], camera: Camera, world_from_camera: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return the points (N, 3) of an observation from its returns in the frame's camera and pose."""
    (u, v), (y, x) = rays_of(camera.cropped(*box_px), returns.step_px), np.nonzero(returns.depth_mm)
    z = returns.depth_mm[y, x].astype(np.float32) * MILLIMETRE
    points = np.stack([z * u[x], z * v[y], z], axis=1)
    return _means_in_world(points, np.zeros(points.shape, np.uint8), world_from_camera, returns.voxel_m)[0]


def checksum_of(points: NDArray[np.float32], world_from_camera: NDArray[np.float64]) -> int:
    """Return the checksum of (N, 3) points of an observation and its camera pose (4, 4)."""
    return zlib.crc32(world_from_camera.astype("<f8").tobytes(), zlib.crc32(points.astype("<f4", copy=False).tobytes()))


@kernel
def _returns(depth, rgb, mask, inner, u, v):
    # (N, 3) camera-frame points and colours of reliable depth in `inner`; (h, w) depth in millimetres, 0 elsewhere;
    # whether all is in whole ones; the number in `mask`. `u` (w,) and `v` (h,): `rays_of`.
    height, width = mask.shape
    points, colors = np.empty((height * width, 3), dtype=np.float32), np.empty((height * width, 3), dtype=np.uint8)
    depth_mm, is_whole = np.zeros((height, width), dtype=np.uint16), True
    count, num_reliable = 0, 0
    for y in range(height):
        for x in range(width):
            z = depth[y, x]
            if mask[y, x] and z > 0:
                num_reliable += 1
                if inner[y, x]:
                    points[count, 0], points[count, 1], points[count, 2] = z * u[x], z * v[y], z
                    whole = np.rint(z * np.float32(1000.0))
                    if 0 < whole <= MOST_MM and np.float32(whole) * MILLIMETRE == z:
                        depth_mm[y, x] = np.uint16(whole)
                    else:
                        is_whole = False
                    for k in range(3):
                        colors[count, k] = rgb[y, x, k]
                    count += 1
    return points[:count], colors[:count], depth_mm, is_whole, num_reliable


def voxel_means(
    points: NDArray[np.float32], colors: NDArray[np.uint8], voxel_m: float
) -> tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.int64]]:
    """Return the mean point (on lattice steps) and colour of every voxel, in the order of the keys, and its points."""
    groups, keys = groups_of(keys_of_points(points, voxel_m))
    means: tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.int64]]
    means = _means_of_groups(groups, np.argsort(keys, kind="quicksort"), points, colors)  # no ties
    return means


@kernel
def _means_of_groups(groups, order, points, colors):
    # Summed in the order of points; `order` is the order of groups.
    sums, counts = np.zeros((len(order), 6)), np.zeros(len(order), dtype=np.int64)
    for i in range(len(groups)):
        group = groups[i]
        counts[group] += 1
        for axis in range(3):
            sums[group, axis] += points[i, axis]
            sums[group, 3 + axis] += colors[i, axis]
    means, shades = np.empty((len(order), 3), dtype=np.float32), np.empty((len(order), 3), dtype=np.uint8)
    for run in range(len(order)):
        group = order[run]
        count = counts[group]
        for axis in range(3):
            # Between points at multiples of the step in one voxel there is a mean at one, in the same voxel.
            means[run, axis] = (np.rint(sums[group, axis] / count * STEPS_PER_M) + 0.0) / STEPS_PER_M
            shades[run, axis] = np.uint8(np.rint(sums[group, 3 + axis] / count))
    return means, shades, counts[order]


def _eroded(mask: NDArray[np.bool_], erode_px: int) -> NDArray[np.bool_]:
    # Parts too thin for the erosion (a leg, a pole, a handle) are kept whole.
    if erode_px == 0:
        return mask
    padded = np.zeros((mask.shape[0] + 2 * erode_px, mask.shape[1] + 2 * erode_px), np.uint8)
    padded[erode_px : erode_px + mask.shape[0], erode_px : erode_px + mask.shape[1]] = mask
    kernel = np.ones((2 * erode_px + 1, 2 * erode_px + 1), dtype=np.uint8)
    inner = cv2.erode(padded, kernel)
    # Dilated twice as far as eroded, so that corners do not count as thin parts.
    near = cv2.dilate(inner, kernel, iterations=2)
    kept = (inner > 0) | ((padded > 0) & (near == 0))
    return kept[erode_px : erode_px + mask.shape[0], erode_px : erode_px + mask.shape[1]]


def _agreeing(depth: NDArray[np.float32], mask: NDArray[np.bool_], law: Law, edge_px: int) -> NDArray[np.bool_]:
    # Without rim pixels that belong to another surface or mix two surfaces (flying pixels).
    inner = _eroded(mask, edge_px)
    for _ in range(edge_px):
        inner = _with_agreeing(depth, mask, inner, law, _AGREE_SIGMAS)
    return inner


@kernel
def _with_agreeing(depth, mask, inner, law, sigmas):
    height, width = mask.shape
    out = inner.copy()
    for y in range(height):
        for x in range(width):
            z = np.float64(depth[y, x])
            if not mask[y, x] or inner[y, x] or not z > 0.0:
                continue
            gate = sigmas * sigma_at(z, law)
            for yy in range(max(0, y - 1), min(height, y + 2)):
                for xx in range(max(0, x - 1), min(width, x + 2)):
                    if inner[yy, xx] and abs(depth[yy, xx] - z) <= gate:
                        out[y, x] = True
    return out


@kernel
def _with_support(depth, inner, law, sigmas, least):
    height, width = inner.shape
    out = np.zeros((height, width), dtype=np.bool_)
    for y in range(height):
        for x in range(width):
            z = np.float64(depth[y, x])
            if not inner[y, x] or not z > 0.0:
                continue
            gate = sigmas * sigma_at(z, law)
            out[y, x] = _has_company(depth, inner, y, x, gate, least)
    return out


@kernel
def _has_company(depth, inner, y, x, gate, least):
    count = -1  # the loop also counts the pixel itself
    for yy in range(max(0, y - 2), min(depth.shape[0], y + 3)):
        for xx in range(max(0, x - 2), min(depth.shape[1], x + 3)):
            count += inner[yy, xx] & (abs(depth[yy, xx] - np.float64(depth[y, x])) <= gate)
            if count >= least:
                return True
    return False


def _group(alone: NDArray[np.int32], box_px: tuple[int, int, int, int], mask: NDArray[np.bool_]) -> int:
    # The instance without the map prior at the mask's first pixel, which contains the mask.
    x0, y0, _, _ = box_px
    y, x = np.unravel_index(int(mask.argmax()), mask.shape)
    return int(alone[y0 + y, x0 + x])


def _touches_border(box_px: tuple[int, int, int, int], camera: Camera) -> bool:
    x0, y0, x1, y1 = box_px
    return x0 <= 1 or y0 <= 1 or x1 >= camera.width - 1 or y1 >= camera.height - 1
