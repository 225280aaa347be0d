"""Contacts between fragments: neighbouring pixels of different labels, and which of these touch in 3D.

Room structure has a label of its own, so that support by the floor is found in the same way as support by a table.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.compiled import numba

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.perception.surface import Surface


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Contacts:
    """Pairs of neighbouring pixels with different labels, `here` left of or above `there`; all arrays (K,).

    `here` and `there` are labels, `here_px` and `there_px` flat pixel indices. `is_below`: `there` is below `here` in
    the image, otherwise right of it. `touches`: they touch in 3D; `nearer`: `there` occludes `here` across a depth
    edge. `cut`, `cut_px`: labels and indices of the pixels on the lower border and the sides of the image.
    """

    here: NDArray[np.int32]
    there: NDArray[np.int32]
    here_px: NDArray[np.int64]
    there_px: NDArray[np.int64]
    is_below: NDArray[np.bool_]
    touches: NDArray[np.bool_]
    nearer: NDArray[np.bool_]
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


@numba.njit(cache=True, nogil=True)
def _contacts(scene, reach):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return (K, 3) int64: flat index, flat index of the next labelled pixel to the right or below, 1 if below."""
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
