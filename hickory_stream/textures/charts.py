"""Charts of a mesh: connected parts whose faces all look to one side of its box, and so lie flat seen from there.

Meshes of layer 2 stand in a box of their own, along which most of their faces lie; projected along its axes nothing is
stretched by more than 1.7 times, and whatever is seen from one side shares a chart.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

if TYPE_CHECKING:
    from numpy.typing import NDArray

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
