"""Thin things as thin superquadrics: carpets, rods, panels, curved sheets, of which a grid sees little or nothing.

The triangles are grouped: first by closed body, then the group is halved whose halves, each in a box along its own
principal axes, save most volume. Each group gets the least box, cylinder or fitted superquadric around it, in the frame
of its own normals. The thickness is the mesh's own: a body of volume V and area A is about 2 V / A thick if it is a
sheet, so that a bent sheet's panels are as thick as the sheet, not as the bend.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.geometry.superquadric import Superquadrics, joined, moved, volumes_m3
from hickory_stream.shapes.around import around_all
from hickory_stream.shapes.frame import object_axes

if TYPE_CHECKING:
    from numpy.typing import NDArray

# A sheet is this many times wider than thick; its panel may be so much thicker before it is called bent.
_SHEET = 4.0
_BENT = 1.3
# Where a group may be cut, in shares of its triangles, and the share of all boxes' volume that halves must save.
_CUTS = (0.25, 0.5, 0.75)
_LEAST_GAIN = 0.03


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Panels:
    """Primitives around all of a mesh, but for the bends of sheets.

    `volume_m3` is theirs before bent ones were made thin, so that they contain the mesh, and `share` the part of it
    that the mesh fills: its intersection over union with them where they do not overlap; 0 where it is not closed.
    """

    primitives: Superquadrics
    volume_m3: float
    share: float


def panels(vertices: NDArray[np.float64], faces: NDArray[np.int32], *, most: int, min_size_m: float) -> Panels:
    """Return up to `most` primitives around (V, 3) vertices with (F, 3) faces, none thinner than `min_size_m`."""
    body_of_face, volumes, areas = _bodies(vertices, faces)
    groups = [np.flatnonzero(body_of_face == body) for body in range(len(volumes))]
    if len(groups) > most:
        groups = [np.arange(len(faces))]
        body_of_face, volumes, areas = (
            np.zeros(len(faces), np.int64),
            volumes.sum(keepdims=True),
            areas.sum(keepdims=True),
        )
    thicknesses = np.maximum(2 * volumes / np.maximum(areas, 1e-300), min_size_m)
    corners = vertices[faces]
    parts = [_Part.of(group, corners, float(thicknesses[body_of_face[group[0]]])) for group in groups]
    while len(parts) < most:
        gains = [part.gain for part in parts]
        at = int(np.argmax(gains))
        if gains[at] <= _LEAST_GAIN * sum(part.volume for part in parts):
            break
        part = parts.pop(at)
        parts += [_Part.of(half, corners, part.thickness) for half in part.halves]
    around = [_around(vertices, faces[part.items], part.thickness) for part in parts]
    volume = float(sum(volumes_m3(one).sum() for one in around))
    thinned = [_thinned(one, corners[part.items], part.thickness) for one, part in zip(around, parts, strict=True)]
    return Panels(primitives=joined(thinned), volume_m3=volume, share=min(float(volumes.sum()) / volume, 1.0))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Part:
    """The indices (N,) of triangles, the thickness of their body, the volume of their box, and what halves save."""

    items: NDArray[np.int64]
    thickness: float
    volume: float
    halves: tuple[NDArray[np.int64], ...]
    gain: float

    @classmethod
    def of(cls, items: NDArray[np.int64], corners: NDArray[np.float64], thickness: float) -> _Part:
        points = corners[items]
        volume, axes = _box_volume(points, thickness)
        middles = portable.matmul(points.mean(axis=1), axes)
        halves: tuple[NDArray[np.int64], ...] = ()
        least = np.inf
        for along in middles[:, 1:].T if len(items) > 1 else ():
            for share in _CUTS:
                is_first = along < np.quantile(along, share)
                if is_first.any() and not is_first.all():
                    both = _box_volume(points[is_first], thickness)[0] + _box_volume(points[~is_first], thickness)[0]
                    if both < least:
                        halves, least = (items[is_first], items[~is_first]), both
        return cls(items=items, thickness=thickness, volume=volume, halves=halves, gain=volume - least)


def _box_volume(corners: NDArray[np.float64], thickness: float) -> tuple[float, NDArray[np.float64]]:
    """Return the volume of the box along the principal axes of (N, 3, 3) triangles, and these, the longest one last.

    The box is larger by the thickness, so that the two sides of a panel are not worth a box each.
    """
    points = corners.reshape(-1, 3)
    off = points - points.mean(axis=0)
    _, axes = portable.eigh(portable.matmul(off.T, off))
    return float((np.ptp(portable.matmul(off, axes), axis=0) + thickness).prod()), axes


def _bodies(
    vertices: NDArray[np.float64], faces: NDArray[np.int32]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the body (F,) of each face, and the volume and area (B,) of each body; an open body has no volume."""
    found = _joined(vertices, faces)
    if (found[1] > 0).all():
        return found
    # Vertices may be apart for the sake of normals or texture.
    places, welded = np.unique(vertices, axis=0, return_inverse=True)
    return _joined(places, welded.ravel()[faces])


def _joined(
    places: NDArray[np.float64], faces: NDArray[np.integer]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the same of faces that are joined where they share a vertex."""
    first, second = faces.ravel(), faces[:, [1, 2, 0]].ravel()
    links = coo_array((np.ones(len(first), bool), (first, second)), shape=(len(places), len(places)))
    _, label = connected_components(links, directed=False)
    _, body = np.unique(label[faces[:, 0]], return_inverse=True)
    # In a closed body each edge is as often passed one way as the other.
    both = first * len(places) + second
    back = second * len(places) + first
    values, index = np.unique(np.concatenate([both, back]), return_inverse=True)
    balance = np.bincount(index[: len(both)], minlength=len(values)) - np.bincount(
        index[len(both) :], minlength=len(values)
    )
    is_open = np.zeros(body.max() + 1, bool)
    is_open[np.repeat(body, 3)[balance[index[: len(both)]] != 0]] = True
    a, b, c = (places[faces[:, corner]] for corner in range(3))
    doubled = np.cross(b - a, c - a)
    volumes = np.abs(np.bincount(body, (a * doubled).sum(axis=1))) / 6
    return body, np.where(is_open, 0.0, volumes), np.bincount(body, np.linalg.norm(doubled, axis=1)) / 2


def _around(vertices: NDArray[np.float64], faces: NDArray[np.int32], min_size_m: float) -> Superquadrics:
    """Return the least primitive around the triangles, in the frame of their normals."""
    used, own = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used], own.reshape(-1, 3).astype(np.int32)
    axes = object_axes(vertices, faces)
    one = around_all(portable.matmul(vertices, axes), faces, min_size_m)
    return moved(one, from_rotation_translation(axes, np.zeros(3)))


def _thinned(one: Superquadrics, corners: NDArray[np.float64], thickness: float) -> Superquadrics:
    """Return a primitive around a bent sheet as thick as the sheet, through the mean of its (N, 3, 3) triangles."""
    order = np.argsort(one.semi_axes_m[0], kind="stable")
    thinnest, middle = 2 * one.semi_axes_m[0, order[0]], 2 * one.semi_axes_m[0, order[1]]
    if thinnest <= _BENT * thickness or middle < _SHEET * thickness:
        return one
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    mean = portable.matmul(areas, corners.mean(axis=1)) / max(float(areas.sum()), 1e-300)
    axis = one.world_from_local[0, :3, order[0]]
    pose, semi_axes = one.world_from_local.copy(), one.semi_axes_m.copy()
    pose[0, :3, 3] += axis * float(((mean - pose[0, :3, 3]) * axis).sum())
    semi_axes[0, order[0]] = thickness / 2
    return Superquadrics(exponents=one.exponents, semi_axes_m=semi_axes, world_from_local=pose)
