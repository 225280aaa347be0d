"""The charts of a mesh side by side in one square image, at the resolution that the views have, or what fits.

Charts are connected parts whose faces look to one side of the object's box: projected along its axes nothing is
stretched by more than 1.7 times. A sheet that lies over another one in a chart, as in a coil, gets its own chart.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from hickory_stream.base.compiled import kernel

_SIDES = np.concatenate([np.eye(3), -np.eye(3)])
# Axes of the plane that a side looks along, so that u x v = its direction: text is not mirrored.
_U_AXES = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0]], dtype=np.float64)
_V_AXES = np.cross(_SIDES, _U_AXES)
_SMOOTHINGS = 6
# What a neighbour's side is worth against the cosine of the angle to it, and the least cosine.
_NEIGHBOUR, _LEAST = 0.25, 0.25


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Charts:
    """`of_face` (F,) numbers the chart of each face; `flat_m` (F, 3, 2) are its corners in the chart's plane."""

    of_face: NDArray[np.int64]
    flat_m: NDArray[np.float64]


def charts_of(vertices: NDArray[Any], faces: NDArray[np.int32]) -> Charts:
    """Return the charts of a mesh; two parts that lie over one another may still share one."""
    corners = vertices[faces].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    pairs = neighbours(faces, len(vertices))
    facing = normals @ _SIDES.T
    side = facing.argmax(axis=1)
    for _ in range(_SMOOTHINGS):
        around = np.zeros_like(facing)
        np.add.at(around, (pairs[:, 0], side[pairs[:, 1]]), _NEIGHBOUR)
        np.add.at(around, (pairs[:, 1], side[pairs[:, 0]]), _NEIGHBOUR)
        side = np.where(facing > _LEAST, facing + around, -1.0).argmax(axis=1)
    u = np.einsum("fkc,fc->fk", corners, _U_AXES[side])
    v = np.einsum("fkc,fc->fk", corners, _V_AXES[side])
    return Charts(of_face=connected(pairs, side), flat_m=np.stack([u, v], axis=2))


def neighbours(faces: NDArray[np.int32], num_vertices: int) -> NDArray[np.int64]:
    """Return (E, 2) the pairs of faces that share an edge."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64), axis=1)
    keys = edges[:, 0] * num_vertices + edges[:, 1]
    order = np.argsort(keys, kind="stable")
    same = np.flatnonzero(keys[order][1:] == keys[order][:-1])
    return np.stack([order[same], order[same + 1]], axis=1) % len(faces)


def connected(pairs: NDArray[np.int64], labels: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return (F,) the numbers of the connected parts of faces with equal labels."""
    joined = pairs[labels[pairs[:, 0]] == labels[pairs[:, 1]]]
    size = len(labels)
    graph = coo_array((np.ones(len(joined), np.int8), (joined[:, 0], joined[:, 1])), shape=(size, size))
    _, parts = connected_components(graph, directed=False)
    return parts.astype(np.int64)


_GAP_PX = 2
_LEAST_SIDE_PX = 32
_COARSER = 1.04
# Inside of a face by more than this share a texel's centre belongs to no other one.
_INSIDE = 1e-3


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Atlas:
    """Where the faces of a mesh lie in an image of `side_px`."""

    side_px: int
    #: (F, 3, 2) places of the faces' corners, x right and y down
    corners_px: NDArray[np.float64]
    #: (S, S) int32: the face that the centre of each texel lies in, -1 for none
    owner: NDArray[np.int32]
    #: (F,) the number of the chart
    of_face: NDArray[np.int64]


def atlas_of(vertices: NDArray[Any], faces: NDArray[np.int32], texel_m: float, most_px: int) -> Atlas:
    """Return the atlas of a mesh with texels of `texel_m`, or larger ones to fit `most_px` squared.

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


@kernel
def _claim(corners, owner, is_covered, inside):
    # The face whose projection has the texel's centre; a face that lies over another one gets none.
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


@kernel
def _is_inside(corners, px, py, inside):
    ax, ay = corners[0]
    bx, by = corners[1]
    cx, cy = corners[2]
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    wb = ((px - ax) * (cy - ay) - (py - ay) * (cx - ax)) / area
    wc = ((bx - ax) * (py - ay) - (by - ay) * (px - ax)) / area
    return min(wb, wc, 1.0 - wb - wc) > inside
