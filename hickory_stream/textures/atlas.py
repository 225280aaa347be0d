"""The charts of a mesh side by side in one square image, at the resolution that the views have, or what fits.

Charts stand on shelves, the tallest ones first, with a gap between them that keeps filtering from mixing neighbours.
Where two sheets of one chart lie over one another, as in a coil, the second one becomes a chart of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.compiled import numba
from hickory_stream.textures.charts import charts_of, connected, neighbours

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.textures.charts import Charts

_GAP_PX = 2
_LEAST_SIDE_PX = 32
_COARSER = 1.04
# Inside of a face by more than this share a texel's centre belongs to no other one.
_INSIDE = 1e-3


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Atlas:
    """Where the faces of a mesh lie in an image of `side_px`.

    `corners_px` (F, 3, 2) are places of the faces' corners, x right and y down; `owner` (S, S) int32 is the face that
    the centre of each texel lies in, -1 for none; `of_face` (F,) numbers the charts.
    """

    side_px: int
    corners_px: NDArray[np.float64]
    owner: NDArray[np.int32]
    of_face: NDArray[np.int64]


def atlas_of(vertices: NDArray[Any], faces: NDArray[np.int32], texel_m: float, most_px: int) -> Atlas:
    """Return the atlas of a mesh with texels of `texel_m`, or as large as they must be to fit `most_px` squared.

    It is larger than `most_px` only where that has no room for a texel of every chart.
    """
    charts = charts_of(vertices, faces)
    pairs = neighbours(faces, len(vertices))
    of_face = charts.of_face
    while True:
        side, corners = _packed(charts, of_face, texel_m, most_px)
        owner = np.full((side, side), -1, dtype=np.int32)
        is_covered = np.zeros(len(faces), dtype=np.bool_)
        _claim(corners, owner, is_covered, _INSIDE)
        if not is_covered.any():
            break
        # Every round leaves the first face of each part where it is.
        apart = connected(pairs, np.where(is_covered, of_face, -1))
        of_face = np.unique(np.where(is_covered, of_face.max() + 1 + apart, of_face), return_inverse=True)[1]
    return Atlas(side_px=side, corners_px=corners, owner=owner, of_face=of_face)


def _packed(
    charts: Charts, of_face: NDArray[np.int64], texel_m: float, most_px: int
) -> tuple[int, NDArray[np.float64]]:
    """Return the side of the image, a power of two, and the corners of the faces in it."""
    count = int(of_face.max()) + 1
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, of_face, charts.flat_m.min(axis=1))
    np.maximum.at(high, of_face, charts.flat_m.max(axis=1))
    side = min(_LEAST_SIDE_PX, most_px)
    while True:
        sizes = np.ceil((high - low) / texel_m).astype(np.int64) + 1 + _GAP_PX
        places = _shelved(sizes, side)
        if places is not None:
            break
        # Very many charts need more than was asked for, even if each were one texel.
        if 2 * side <= most_px or texel_m > (high - low).max():
            side *= 2
        else:
            texel_m *= _COARSER
    corners = (charts.flat_m - low[of_face][:, None]) / texel_m + places[of_face][:, None] + 0.5
    corners[..., 1] = side - corners[..., 1]
    return side, corners


def _shelved(sizes: NDArray[np.int64], side: int) -> NDArray[np.int64] | None:
    """Return (N, 2) the low corners of rectangles (N, 2) in a square; None where they do not fit."""
    if int(sizes.prod(axis=1).sum()) > side * side or int(sizes.max()) > side:
        return None
    places = np.zeros_like(sizes)
    x = y = shelf = 0
    for i in np.lexsort((sizes[:, 0], -sizes[:, 1])):
        width, height = int(sizes[i, 0]), int(sizes[i, 1])
        if x + width > side:
            x, y, shelf = 0, y + shelf, 0
        if y + height > side:
            return None
        places[i] = x, y
        x, shelf = x + width, max(shelf, height)
    return places


@numba.njit(cache=True, nogil=True)
def _claim(corners, owner, is_covered, inside):  # type: ignore[no-untyped-def] # pragma: no cover
    """Give each texel to a face whose projection has its centre; a face that lies over another one gets none."""
    side = owner.shape[0]
    for f in range(len(corners)):
        ax, ay = corners[f, 0]
        bx, by = corners[f, 1]
        cx, cy = corners[f, 2]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        x0, x1 = max(int(min(ax, bx, cx) - 0.5), 0), min(int(max(ax, bx, cx) + 0.5), side - 1)
        y0, y1 = max(int(min(ay, by, cy) - 0.5), 0), min(int(max(ay, by, cy) + 0.5), side - 1)
        for is_second in (False, True):
            for y in range(y0, y1 + 1):
                for x in range(x0, x1 + 1):
                    px, py = x + 0.5, y + 0.5
                    wb = ((px - ax) * (cy - ay) - (py - ay) * (cx - ax)) / area
                    wc = ((bx - ax) * (py - ay) - (by - ay) * (px - ax)) / area
                    least = min(wb, wc, 1.0 - wb - wc)
                    if not is_second:
                        if least > inside and owner[y, x] >= 0:
                            other = owner[y, x]
                            # Borders of neighbours may share a texel; their insides do not.
                            if _is_inside(corners[other], px, py, inside):
                                is_covered[f] = True
                    elif not is_covered[f] and least >= 0.0 and owner[y, x] < 0:
                        owner[y, x] = f


@numba.njit(cache=True, nogil=True)
def _is_inside(corners, px, py, inside):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return whether a place is inside of a triangle by more than a share."""
    ax, ay = corners[0]
    bx, by = corners[1]
    cx, cy = corners[2]
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    wb = ((px - ax) * (cy - ay) - (py - ay) * (cx - ax)) / area
    wc = ((bx - ax) * (py - ay) - (by - ay) * (px - ax)) / area
    return min(wb, wc, 1.0 - wb - wc) > inside
