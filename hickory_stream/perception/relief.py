"""What stands off a floor or a wall by less than a pixel's noise: a lamp's foot, the back of a shelf.

One pixel cannot be told from the plane behind it, a few dozen can: the mean of a window has a fraction of the noise.
But a real camera's floors have waves as high as such a foot; those have the colour of the floor around them, a foot has
not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from hickory_stream.compiled import numba
from hickory_stream.geometry import portable
from hickory_stream.ranges import Ranged, number

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hickory_stream.perception.surface import Surface


@dataclass(frozen=True, kw_only=True, slots=True)
class ReliefConfig(Ranged):
    """What counts as a part of a thing that stands off a plane.

    Attributes:
        window_px: side of the window whose mean is looked at.
        least_m, sigmas: the mean must be off the plane by this, and by so many of its standard deviations.
        min_area_px: the fewest pixels of a raised patch.
        color_step: the least distance in CIE Lab between a patch and the plane around it.
        reach_px: how far around a patch the plane's colour is taken.
        min_held: the share of its outline along which a patch on a wall borders things in front: a picture or the frame
            of a door has none. One on the floor needs only `min_touch_px` of it: a foot has a thin leg.
    """

    window_px: int = number(5, 1, 1001, "px")
    least_m: float = number(0.009, 0, 10, "m")
    sigmas: float = number(3.0, 0, 100, "standard deviations")
    min_area_px: int = number(24, 1, 1_000_000, "px")
    color_step: float = number(12.0, 0, 1000, "CIE Lab")
    reach_px: int = number(12, 1, 1000, "px")
    min_held: float = number(0.3, 0, 1, "share")
    min_touch_px: int = number(2, 0, 1_000_000, "px")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class NearPlane:
    """The pixels `near` (h, w) the floor or a wall, and how far each lies on its front, in m (h, w)."""

    distance_m: NDArray[np.float32]
    near: NDArray[np.bool_]
    is_floor: bool


def relief(
    planes: Sequence[NearPlane],
    structure: NDArray[np.bool_],
    surface: Surface,
    config: ReliefConfig,
) -> NDArray[np.bool_]:
    """Return (h, w) which pixels of the `structure` stand off every plane that they are near, and belong to a thing."""
    things = (~structure & np.isfinite(surface.depth_m)).astype(np.uint8)
    off, on = np.zeros(structure.shape, dtype=bool), np.zeros(structure.shape, dtype=bool)
    for plane in planes:
        patches = _raised(plane, things, surface.sigma_m, surface.lab, config)
        off |= patches
        on |= plane.near & ~patches
    return off & ~on


def _raised(
    plane: NearPlane,
    things: NDArray[np.uint8],
    sigma_m: NDArray[np.float32],
    lab: NDArray[np.float32],
    config: ReliefConfig,
) -> NDArray[np.bool_]:
    mask = np.zeros(plane.near.shape, dtype=bool)
    side = (config.window_px, config.window_px)
    values, marks = _marked(plane.distance_m, plane.near)
    total = cv2.blur(values, side, borderType=cv2.BORDER_CONSTANT)
    share = cv2.blur(marks, side, borderType=cv2.BORDER_CONSTANT)
    area, least_m, sigmas = (
        np.float32(x) for x in (config.window_px * config.window_px, config.least_m, config.sigmas)
    )
    high = _is_high(plane.near, total, share, sigma_m, area, least_m, sigmas)
    if np.count_nonzero(high) < config.min_area_px:
        return mask
    # A rim of a few pixels along the foot of a thing tells nothing that the thing does not.
    wide = cv2.morphologyEx(high.astype(np.uint8), cv2.MORPH_OPEN, _WIDE)
    if int(wide.sum()) < config.min_area_px:
        return mask
    _, labels, stats, _ = cv2.connectedComponentsWithStats(wide, connectivity=4)
    ground = plane.near & ~high
    for i in np.flatnonzero(stats[:, cv2.CC_STAT_AREA] >= config.min_area_px).tolist():
        u, v, width, height = (int(x) for x in stats[i, :4])
        y, x = max(0, v - config.reach_px), max(0, u - config.reach_px)
        window = np.s_[y : v + height + config.reach_px, x : u + width + config.reach_px]
        patch = labels[window] == i
        if i == 0 or not _is_held(patch, things[window], is_floor=plane.is_floor, config=config):
            continue
        around = ground[window]
        color = lab[window][around] if int(around.sum()) >= config.min_area_px else lab[ground]
        if len(color) and _color_step(lab[window][patch], color) > config.color_step:
            mask[window] |= patch
    return mask


def _is_held(patch: NDArray[np.bool_], things: NDArray[np.uint8], *, is_floor: bool, config: ReliefConfig) -> bool:
    """Return whether enough of a patch's outline borders on things."""
    outline = (cv2.dilate(patch.astype(np.uint8), _NEXT) > 0) & ~patch
    touch = int(things[outline].sum())
    return touch >= config.min_touch_px if is_floor else touch > config.min_held * int(outline.sum())


@numba.njit(cache=True, nogil=True)
def _marked(values, mask):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return (h, w) the values where a mask is, 0 elsewhere, and the mask as numbers."""
    out, marks = np.zeros(values.shape, dtype=np.float32), np.zeros(values.shape, dtype=np.float32)
    for y in range(values.shape[0]):
        for x in range(values.shape[1]):
            if mask[y, x]:
                out[y, x], marks[y, x] = values[y, x], np.float32(1.0)
    return out, marks


@numba.njit(cache=True, nogil=True)
def _is_high(near, total, share, sigma, area, least, sigmas):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return (h, w) which pixels of a plane lie in windows whose mean is off it by more than its noise.

    `total` and `share` (h, w) are the means over windows of `area` pixels of the distances from the plane, 0 where a
    pixel is not near it, and of the pixels that are.
    """
    out = np.zeros(near.shape, dtype=np.bool_)
    for y in range(near.shape[0]):
        for x in range(near.shape[1]):
            if near[y, x]:
                mean = total[y, x] / max(share[y, x], np.float32(1e-6))
                noise = sigma[y, x] / np.sqrt(max(share[y, x] * area, np.float32(1.0)))
                out[y, x] = mean > max(least, sigmas * noise)
    return out


def _color_step(patch: NDArray[np.float32], plane: NDArray[np.float32]) -> float:
    return portable.norm(np.median(patch, axis=0) - np.median(plane, axis=0))


_NEXT, _WIDE = np.ones((3, 3), dtype=np.uint8), np.ones((5, 5), dtype=np.uint8)
