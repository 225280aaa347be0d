"""Contacts between fragments: neighbouring pixels of different labels; and support of regions by one another.

Room structure has a label of its own, so that it supports like a table. Gravity is nearly vertical in the image: the
support surface is searched below the lowest part of a region's outline, the foot.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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


def _contacts(scene: NDArray[np.int32], reach: int) -> NDArray[np.int64]:
    # (K, 3): flat index, flat index of the next labelled pixel to the right or below, 1 if below.
    height, width = scene.shape
    # The distance to a pixel of another label, 0 for none, by pixel and direction.
    found = np.zeros((height, width, 2), dtype=np.int8)
    for side in range(2):
        waits = scene > 0
        for step in range(1, reach + 1):
            here, there = (np.s_[:, :-step], np.s_[:, step:]) if side == 0 else (np.s_[:-step], np.s_[step:])
            is_end = waits[here] & (scene[there] > 0)
            found[..., side][here][is_end & (scene[there] != scene[here])] = step
            waits[here] &= ~is_end
    places = np.flatnonzero(found)
    here_px, is_below = places // 2, places % 2
    return np.stack([here_px, here_px + found.ravel()[places] * np.where(is_below, width, 1), is_below], axis=1)


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
    count, heights = int(pieces[-1]), heights_m.ravel()
    here, there, edge = pieces[contacts.here], pieces[contacts.there], pieces[contacts.cut]
    below = np.flatnonzero(contacts.is_below & (here != there) & (here < count))
    regions = np.concatenate([here[below], edge[edge < count]])
    z_m = heights[np.concatenate([contacts.here_px[below], contacts.cut_px[edge < count]])].astype(np.float64)
    low_m, high_m = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(low_m, regions, z_m)
    np.maximum.at(high_m, regions, z_m)
    is_foot = z_m <= (1 - _FOOT_SHARE) * low_m[regions] + _FOOT_SHARE * high_m[regions]
    below = below[is_foot[: len(below)]]
    touches = contacts.touches[below]
    resting, falling = below[touches], below[~touches & ~contacts.nearer[below]]
    resting = resting[level.ravel()[contacts.there_px[resting]]]
    on = np.bincount(here[resting] * (count + 1) + there[resting], minlength=count * (count + 1))
    return SupportContacts(
        outline=np.bincount(regions[is_foot], minlength=count),
        free=np.bincount(here[falling], minlength=count),
        on=on.reshape(count, count + 1),
    )
