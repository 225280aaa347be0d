"""Patches raised off a floor or wall plane by less than the depth noise of a pixel: a lamp's foot, a shelf's back.

The mean depth over a window has a fraction of the noise. Depth cameras also have low-frequency errors as high as such a
patch, so a patch must differ in colour, too, from the plane around it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry import portable
from hickory_stream.perception.surface import Surface

# Side of the averaging window.
_WINDOW_PX = 5
# Minimum offset of the window's mean from the plane, in m and in its standard deviations.
_MIN_OFFSET_M = 0.009
_MIN_OFFSET_SIGMAS = 3.0
# Minimum area of a raised patch.
_MIN_AREA_PX = 24
# Minimum CIE Lab distance between the patch and the plane around it.
_COLOR_STEP = 12.0
# Width of the ring around a patch in which the plane's colour is sampled.
_RING_PX = 12
# On a wall, the minimum share of the patch's outline that borders objects: a picture or a door frame borders none.
_MIN_BORDER_SHARE = 0.3
# On the floor, the minimum number of outline pixels that border objects: legs are thin.
_MIN_BORDER_PX = 2


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class NearPlane:
    """A floor or wall plane: the pixels `near` it (h, w), and the signed distance of each to its front (h, w)."""

    distance_m: NDArray[np.float32]
    near: NDArray[np.bool_]
    is_floor: bool


def raised_patches(planes: Sequence[NearPlane], structure: NDArray[np.bool_], surface: Surface) -> NDArray[np.bool_]:
    """Return (h, w) the pixels of `structure` that belong to objects: they are raised off every plane near them."""
    things = (~structure & np.isfinite(surface.depth_m)).astype(np.uint8)
    off, on = np.zeros(structure.shape, dtype=bool), np.zeros(structure.shape, dtype=bool)
    for plane in planes:
        patches = _raised(plane, things, surface.sigma_m, surface.lab)
        off |= patches
        on |= plane.near & ~patches
    return off & ~on


def _raised(
    plane: NearPlane,
    things: NDArray[np.uint8],
    sigma_m: NDArray[np.float32],
    lab: NDArray[np.float32],
) -> NDArray[np.bool_]:
    mask = np.zeros(plane.near.shape, dtype=bool)
    side = (_WINDOW_PX, _WINDOW_PX)
    values = cv2.copyTo(plane.distance_m, plane.near.view(np.uint8))
    # Means over a window of the distance to the plane, 0 beyond, and of the mask of pixels near it.
    total = cv2.blur(values, side, borderType=cv2.BORDER_CONSTANT)
    share = cv2.blur(plane.near.astype(np.float32), side, borderType=cv2.BORDER_CONSTANT)
    noise = sigma_m / np.sqrt(np.maximum(share * np.float32(_WINDOW_PX * _WINDOW_PX), np.float32(1)))
    limit = np.maximum(np.float32(_MIN_OFFSET_M), np.float32(_MIN_OFFSET_SIGMAS) * noise)
    high = plane.near & (total / np.maximum(share, np.float32(1e-6)) > limit)
    if np.count_nonzero(high) < _MIN_AREA_PX:
        return mask
    # Opening removes rims of a few pixels along the foot of an object.
    wide = cv2.morphologyEx(high.astype(np.uint8), cv2.MORPH_OPEN, _WIDE)
    if int(wide.sum()) < _MIN_AREA_PX:
        return mask
    _, labels, stats, _ = cv2.connectedComponentsWithStats(wide, connectivity=4)
    ground = plane.near & ~high
    for i in np.flatnonzero(stats[:, cv2.CC_STAT_AREA] >= _MIN_AREA_PX).tolist():
        u, v, width, height = (int(x) for x in stats[i, :4])
        y, x = max(0, v - _RING_PX), max(0, u - _RING_PX)
        window = np.s_[y : v + height + _RING_PX, x : u + width + _RING_PX]
        patch = labels[window] == i
        if i == 0 or not _borders_objects(patch, things[window], is_floor=plane.is_floor):
            continue
        around = ground[window]
        color = lab[window][around] if int(around.sum()) >= _MIN_AREA_PX else lab[ground]
        colors = (lab[window][patch], color)
        if len(color) and portable.norm(np.subtract(*(np.median(c, axis=0) for c in colors))) > _COLOR_STEP:
            mask[window] |= patch
    return mask


def _borders_objects(patch: NDArray[np.bool_], things: NDArray[np.uint8], *, is_floor: bool) -> bool:
    outline = (cv2.dilate(patch.astype(np.uint8), _NEXT) > 0) & ~patch
    touch = int(things[outline].sum())
    return touch >= _MIN_BORDER_PX if is_floor else touch > _MIN_BORDER_SHARE * int(outline.sum())


_NEXT, _WIDE = np.ones((3, 3), dtype=np.uint8), np.ones((5, 5), dtype=np.uint8)
