"""Masks lifted to 3D: the filtered points of each instance in the world, its box, and the cheap factors of S."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numba
import numpy as np
from scipy.ndimage import find_objects

from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.camera import Camera, backproject
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.voxels import in_company, keys_of_points
from hickory_stream.records import Observation, RejectedMask

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.records import Frame, Segmentation


@dataclass(frozen=True, kw_only=True, slots=True)
class ObserveConfig:
    """How masks are lifted.

    Attributes:
        min_depth_m, max_depth_m: returns outside are unreliable.
        erode_px: pixels taken off a mask's rim before lifting, where depth mixes two surfaces; thin parts keep theirs.
        voxel_m: points are averaged over the cells of this lattice.
        min_neighbors: a point is kept if its 27 cells of three voxels hold at least this many points.
        min_points: observations with fewer points are rejected.
        max_box_m: a box with a longer side is no object.
    """

    min_depth_m: float = 0.2
    max_depth_m: float = 5.0
    erode_px: int = 2
    voxel_m: float = 0.01
    min_neighbors: int = 4
    min_points: int = 30
    max_box_m: float = 3.0


def observe(
    frame: Frame, segmentation: Segmentation, config: ObserveConfig
) -> tuple[tuple[Observation, ...], tuple[RejectedMask, ...]]:
    """Return the observations of a frame in the order of their labels, and the masks that gave none, with reasons."""
    observations: list[Observation] = []
    rejected: list[RejectedMask] = list(segmentation.rejected)
    for box_px, mask in _masks(segmentation.instances):
        lifted = _lift(frame, box_px, mask, config)
        if isinstance(lifted, str):
            rejected.append(RejectedMask(box_px=box_px, reason=lifted, mask=mask))
            continue
        points, colors, valid_share = lifted
        observations.append(
            Observation(
                index=len(observations),
                box_px=box_px,
                mask=mask,
                points_world=points,
                colors=colors,
                box=gravity_aligned_box(points[in_company(points)], config.voxel_m),
                r_area=float(mask.sum()) / mask_area_of(frame.camera),
                r_depth=valid_share,
                is_cut=_touches_border(box_px, frame.camera),
            )
        )
    return tuple(observations), tuple(rejected)


def mask_area_of(camera: Camera) -> float:
    """Return H x W, the denominator of R_area."""
    return float(camera.width * camera.height)


def _masks(instances: NDArray[np.int32]) -> list[tuple[tuple[int, int, int, int], NDArray[np.bool_]]]:
    """Return the box (x0, y0, x1, y1) and the mask within it of each instance, in the order of their labels."""
    masks = []
    for i, place in enumerate(find_objects(instances)):
        if place is not None:
            rows, columns = place
            masks.append(((columns.start, rows.start, columns.stop, rows.stop), instances[place] == i + 1))
    return masks


def _lift(
    frame: Frame, box_px: tuple[int, int, int, int], mask: NDArray[np.bool_], config: ObserveConfig
) -> tuple[NDArray[np.float32], NDArray[np.uint8], float] | str:
    """Return (points, colours, R_depth), or why there are none; R_depth is the share of the mask with depth."""
    x0, y0, x1, y1 = box_px
    depth = frame.depth_m[y0:y1, x0:x1]
    reliable = mask & (depth >= config.min_depth_m) & (depth <= config.max_depth_m)
    kept = reliable & _eroded(mask, config.erode_px)
    if not kept.any():
        return "no reliable depth in the mask"
    camera = frame.camera.cropped(x0, y0, x1, y1)
    points = apply(frame.world_from_camera, backproject(depth, camera)[kept])
    points, colors, counts = voxel_means(points, frame.rgb[y0:y1, x0:x1][kept], config.voxel_m)
    dense = _is_dense(points, counts, config)
    points, colors = points[dense], colors[dense]
    if len(points) < config.min_points:
        return f"{len(points)} points after filtering, fewer than {config.min_points}"
    size = np.ptp(points[in_company(points)], axis=0)
    if float(size.max()) > config.max_box_m:
        return f"{float(size.max()):.1f} m long: no object"
    return points, colors, float(reliable.sum() / mask.sum())


def voxel_means(
    points: NDArray[np.float32], colors: NDArray[np.uint8], voxel_m: float
) -> tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.int64]]:
    """Return the mean point and colour of every occupied voxel, in the order of the keys, and the points in each."""
    keys = keys_of_points(points, voxel_m)
    order = np.argsort(keys, kind="stable")
    means: tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.int64]]
    means = _means_of_runs(keys[order], order, points, colors)
    return means


@numba.njit(cache=True, nogil=True)
def _means_of_runs(keys, order, points, colors):  # type: ignore[no-untyped-def] # pragma: no cover
    """Average what has the same key; `keys` are sorted, `order` says which point each is of."""
    num = 1
    for i in range(1, len(keys)):
        num += keys[i] != keys[i - 1]
    means, shades = np.zeros((num, 3), dtype=np.float32), np.zeros((num, 3), dtype=np.uint8)
    counts = np.zeros(num, dtype=np.int64)
    first, run = 0, 0
    while first < len(keys):
        last = first + 1
        while last < len(keys) and keys[last] == keys[first]:
            last += 1
        count = last - first
        for axis in range(3):
            mean, shade = 0.0, 0.0
            for i in range(first, last):
                mean += points[order[i], axis]
                shade += colors[order[i], axis]
            means[run, axis], shades[run, axis] = mean / count, np.uint8(np.rint(shade / count))
        counts[run] = count
        first, run = last, run + 1
    return means, shades, counts


def _eroded(mask: NDArray[np.bool_], erode_px: int) -> NDArray[np.bool_]:
    """Return the mask without its rim; what is too thin to have an inside (a leg, a pole, a handle) stays whole."""
    if erode_px == 0:
        return mask
    padded = np.pad(mask.astype(np.uint8), erode_px)
    kernel = np.ones((2 * erode_px + 1, 2 * erode_px + 1), dtype=np.uint8)
    inner = cv2.erode(padded, kernel)
    # Twice as far back as it went: a corner that the erosion took off is no thin part.
    near = cv2.dilate(inner, kernel, iterations=2)
    kept = (inner > 0) | ((padded > 0) & (near == 0))
    return kept[erode_px : erode_px + mask.shape[0], erode_px : erode_px + mask.shape[1]]


def _is_dense(points: NDArray[np.float32], counts: NDArray[np.int64], config: ObserveConfig) -> NDArray[np.bool_]:
    """Return which voxels have company: the coarse cell of three voxels around them holds enough points."""
    _, inverse = np.unique(keys_of_points(points, 3 * config.voxel_m), return_inverse=True)
    return np.asarray(np.bincount(inverse, weights=counts)[inverse] >= config.min_neighbors)


def _touches_border(box_px: tuple[int, int, int, int], camera: Camera) -> bool:
    x0, y0, x1, y1 = box_px
    return x0 <= 1 or y0 <= 1 or x1 >= camera.width - 1 or y1 >= camera.height - 1
