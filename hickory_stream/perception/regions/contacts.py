"""Contacts between fragments: neighbouring pixels of different labels; and support of regions by one another.

Room structure has a label of its own, so that it supports like a table. Gravity is nearly vertical in the image: the
support surface is searched below the lowest part of a region's outline, the foot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.perception.surface import Surface


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Contacts:
    """Pairs of neighbouring pixels with different labels, `here` left of or above `there`; all arrays (K,)."""

    here: NDArray[np.int32]
    there: NDArray[np.int32]
    #: flat pixel indices, as in `there_px`
    here_px: NDArray[np.int64]
    there_px: NDArray[np.int64]
    #: `there` is below `here` in the image, otherwise right of it
    is_below: NDArray[np.bool_]
    #: they touch in 3D
    touches: NDArray[np.bool_]
    #: `there` occludes `here` across a depth edge
    nearer: NDArray[np.bool_]
    #: labels of the pixels on the lower border and the sides of the image
    cut: NDArray[np.int32]
    cut_px: NDArray[np.int64]


def contacts_of(surface: Surface, scene: NDArray[np.int32], reach_px: int) -> Contacts:
    """Return the contacts in a label image (h, w), across at most `reach_px - 1` unlabelled pixels."""
    pairs = _contacts(scene, reach_px)
    here_px, there_px, is_below = pairs[:, 0], pairs[:, 1], pairs[:, 2] > 0
    depth, points = surface.depth_m.ravel(), surface.points_world.reshape(-1, 3)
    step = np.where(is_below, (there_px - here_px) // scene.shape[1], there_px - here_px)
    delta = points[there_px] - points[here_px]
    distance = np.sqrt((delta * delta).sum(axis=1))
    z = depth[here_px]
    index = np.arange(scene.size).reshape(scene.shape)
    border = np.concatenate([index[-1], index[:-1, 0], index[:-1, -1]])
    border = border[(scene.ravel()[border] > 0) & np.isfinite(depth[border])]
    return Contacts(
        here=scene.ravel()[here_px],
        there=scene.ravel()[there_px],
        here_px=here_px,
        there_px=there_px,
        is_below=is_below,
        # The distance between neighbouring pixels of one slanted surface, plus depth noise.
        touches=distance < 0.015 + (0.006 + 0.006 * step) * z,
        nearer=depth[there_px] < z * 0.98 - 0.01,
        cut=scene.ravel()[border],
        cut_px=border,
    )


@kernel
def _contacts(scene, reach):
    # (K, 3) int64: flat index, flat index of the next labelled pixel to the right or below, 1 if below.
    height, width = scene.shape
    out = np.empty((2 * height * width, 3), dtype=np.int64)
    count = 0
    for y in range(height):
        for x in range(width):
            label = scene[y, x]
            if label == 0:
                continue
            for side in range(2):
                for k in range(1, reach + 1):
                    yy, xx = (y, x + k) if side == 0 else (y + k, x)
                    if yy >= height or xx >= width:
                        break
                    other = scene[yy, xx]
                    if other == 0:
                        continue
                    if other != label:
                        out[count, 0], out[count, 1], out[count, 2] = y * width + x, yy * width + xx, side
                        count += 1
                    break
    return out[:count].copy()


_FOOT_SHARE = 0.35


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SupportContacts:
    """Pixel counts along the lower outline of each region's foot (row = region); the rest is steep or occluded."""

    #: (count,) all pixels, with those on the image border
    outline: NDArray[np.int64]
    #: (count,) unsupported pixels: a farther surface is below
    free: NDArray[np.int64]
    #: (count, count + 1) pixels on a horizontal surface of the column's region (last: room structure)
    on: NDArray[np.int64]


def support_contacts_of(
    contacts: Contacts, pieces: NDArray[np.int64], heights_m: NDArray[np.float32], level: NDArray[np.bool_]
) -> SupportContacts:
    """Return the support contacts of regions; `pieces` (labels,) gives the region of each label.

    The last label is room structure, the highest region. `heights_m` (h, w) count from any origin; `level` (h, w):
    pixels of surfaces that can support something.
    """
    pairs = (contacts.here, contacts.there, contacts.here_px, contacts.there_px)
    marks, edge = (contacts.is_below, contacts.touches, contacts.nearer), (contacts.cut, contacts.cut_px)
    outline, free, on = _counted(pairs, marks, edge, pieces, heights_m.ravel(), level.ravel(), int(pieces[-1]))
    return SupportContacts(outline=outline, free=free, on=on)


@kernel
def _counted(contacts, marks, edge, pieces, heights, level, count):
    # A first pass finds the foot of each region, a second one counts it.
    here_labels, there_labels, here_px, there_px = contacts
    is_below, touches, nearer = marks
    edge_labels, edge_px = edge
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    for i in range(len(here_labels)):
        here = pieces[here_labels[i]]
        if is_below[i] and here != pieces[there_labels[i]] and here < count:
            z = np.float64(heights[here_px[i]])
            low[here], high[here] = min(low[here], z), max(high[here], z)
    for i in range(len(edge_labels)):
        here = pieces[edge_labels[i]]
        if here < count:
            z = np.float64(heights[edge_px[i]])
            low[here], high[here] = min(low[here], z), max(high[here], z)
    foot = np.zeros(count)
    for k in range(count):
        if np.isfinite(low[k]):
            foot[k] = (1 - _FOOT_SHARE) * low[k] + _FOOT_SHARE * high[k]
    outline, free = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
    on = np.zeros((count, count + 1), dtype=np.int64)
    for i in range(len(here_labels)):
        here, there = pieces[here_labels[i]], pieces[there_labels[i]]
        if not (is_below[i] and here != there and here < count):
            continue
        if np.float64(heights[here_px[i]]) <= foot[here]:
            outline[here] += 1
            if touches[i]:
                on[here, there] += level[there_px[i]]
            elif not nearer[i]:
                free[here] += 1
    for i in range(len(edge_labels)):
        here = pieces[edge_labels[i]]
        if here < count and np.float64(heights[edge_px[i]]) <= foot[here]:
            outline[here] += 1
    return outline, free, on
