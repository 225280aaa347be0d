"""What the kept views show of points on a surface: the colour of each point in each view, and what that is worth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from hickory_stream.geometry.camera import project
from hickory_stream.geometry.rigid import apply, invert

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hickory_stream.ports import Crop

_HOLE_PX = 3.0
_LEAST_COSINE = 0.12
# Over so many pixels the colours of a view fade in from the border of what it shows of the object.
_RIM_PX = 1.0
_FADE_PX = 5.0
_SIGMAS = 3.0
_SAMPLES_A_ROW = 1024


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Sightings:
    """Of V views and N points: `colors` (V, N, 3) float32; `detail` (V, N) pixels a metre; `trust` (V, N) in 0..1.

    Trust is 0 where a view does not show the point, and falls towards the border of what it shows.
    """

    colors: NDArray[np.float32]
    detail: NDArray[np.float32]
    trust: NDArray[np.float32]


def sightings(
    points: NDArray[np.float64], normals: NDArray[np.float64], crops: Sequence[Crop], reach_m: float
) -> Sightings:
    """Return what views show of (N, 3) points in the world with unit normals.

    A view shows a point where it measured a surface within `reach_m` of it, or within what its depth is worth, and
    within the object's mask.
    """
    count = len(points)
    colors = np.zeros((len(crops), count, 3), np.float32)
    detail, trust = np.zeros((2, len(crops), count), np.float32)
    for i, crop in enumerate(crops):
        _see(crop, points, normals, reach_m, colors[i], detail[i], trust[i])
    return Sightings(colors=colors, detail=detail, trust=trust)


def _see(
    crop: Crop,
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    reach_m: float,
    colors: NDArray[np.float32],
    detail: NDArray[np.float32],
    trust: NDArray[np.float32],
) -> None:
    """Fill what one view shows of the points."""
    camera = crop.camera
    towards = crop.world_from_camera[:3, 3] - points
    slant = (normals * towards).sum(axis=1)
    facing = np.flatnonzero(slant > _LEAST_COSINE * np.linalg.norm(towards, axis=1))
    local = apply(invert(crop.world_from_camera), points[facing])
    pixels = project(local, camera)
    in_image = np.isfinite(pixels).all(axis=1)
    in_image &= ((pixels >= 0) & (pixels <= (camera.width - 1, camera.height - 1))).all(axis=1)
    here, local, pixels = facing[in_image], local[in_image], pixels[in_image]
    if len(here) == 0:
        return
    places = pixels.astype(np.float32)
    column, row = np.rint(places).astype(np.int64).T
    depth = _without_holes(crop)[row, column]
    tolerance = np.maximum(reach_m, _SIGMAS * crop.sensor.sigma_m(depth))
    shown = crop.mask[row, column] & (np.abs(depth - local[:, 2]) <= tolerance)
    here, local, places, column, row = here[shown], local[shown], places[shown], column[shown], row[shown]
    if len(here) == 0:
        return
    colors[here] = _sampled(crop.rgb, places)
    cosine = slant[here] / np.linalg.norm(towards[here], axis=1)
    detail[here] = cosine * camera.fx / local[:, 2]
    within = ndimage.distance_transform_edt(np.pad(crop.mask, 1))[1:-1, 1:-1]
    trust[here] = np.clip((within[row, column] - _RIM_PX) / _FADE_PX, 0.01, 1.0)


def _sampled(image: NDArray[np.uint8], places: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return (N, 3) the colours at places (N, 2) between pixels."""
    import cv2

    # OpenCV takes no image of more than 32767 rows or columns.
    rows = -(-len(places) // _SAMPLES_A_ROW)
    grid = np.zeros((rows * _SAMPLES_A_ROW, 2), np.float32)
    grid[: len(places)] = places
    x, y = np.moveaxis(grid.reshape(rows, _SAMPLES_A_ROW, 2), 2, 0)
    sampled = cv2.remap(image, x, y, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
    return np.asarray(sampled.reshape(-1, 3)[: len(places)])


def _without_holes(crop: Crop) -> NDArray[np.float32]:
    """Return the depth, where it has small holes that of the nearest pixel."""
    is_missing = np.isnan(crop.depth_m)
    if is_missing.all():
        return crop.depth_m
    away, nearest = ndimage.distance_transform_edt(is_missing, return_indices=True)
    return np.where(away <= _HOLE_PX, crop.depth_m[tuple(nearest)], np.float32(np.nan))
