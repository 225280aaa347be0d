"""Closed parts of one texture, and models: unions of parts, z up, with the origin at the centre of the base."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.worlds.textures import Texture, colors_at

# Vertices carry the colours of the truth meshes, so flat faces are divided to about this size.
_CELL_M = 0.06


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Part:
    """`vertices` (V, 3) float64 in the model's frame; `faces` (F, 3) int32, counter-clockwise seen from outside."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    texture: Texture

    def __post_init__(self) -> None:
        freeze(self, "vertices", np.float64, (None, 3))
        freeze(self, "faces", np.int32, (None, 3))

    def moved(self, by: Sequence[float] | NDArray[Any], rotation: NDArray[Any] | None = None) -> "Part":
        """Return the part rotated by a (3, 3) matrix about the origin, then translated by (x, y, z) metres."""
        turned = self.vertices if rotation is None else self.vertices @ np.asarray(rotation).T
        return Part(vertices=turned + np.asarray(by, dtype=np.float64), faces=self.faces, texture=self.texture)


@dataclass(frozen=True, kw_only=True, slots=True)
class Surface:
    """A level rectangle of a model on which things can stand, in the model's frame."""

    center_m: tuple[float, float, float]
    half_m: tuple[float, float]
    headroom_m: float = 2.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Model:
    """An object of a kind in its own frame."""

    kind: str
    parts: tuple[Part, ...]
    surfaces: tuple[Surface, ...] = ()

    def bounds_m(self) -> NDArray[np.float64]:
        """Return the (2, 3) lower and upper corner of the model in its frame."""
        vertices = np.concatenate([part.vertices for part in self.parts])
        return np.stack([vertices.min(axis=0), vertices.max(axis=0)])


def model_triangles(model: Model) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return the (V, 3) vertices and (F, 3) faces of all parts of a model."""
    offsets = np.cumsum([0] + [len(part.vertices) for part in model.parts])
    faces = np.concatenate([part.faces + at for part, at in zip(model.parts, offsets[:-1], strict=True)])
    return np.concatenate([part.vertices for part in model.parts]).astype(np.float32), faces.astype(np.int32)


def model_mesh(model: Model) -> Mesh:
    """Return the parts of a model as one mesh with the colours of their textures at the vertices."""
    vertices, faces = model_triangles(model)
    return Mesh(
        vertices=vertices,
        faces=faces,
        colors=np.concatenate([colors_at(part.texture, part.vertices) for part in model.parts]),
        is_seen=np.ones(len(vertices), dtype=bool),
    )


def rounded_box(
    size_m: Sequence[float],
    texture: Texture,
    *,
    at: Sequence[float] = (0.0, 0.0, 0.0),
    radius_m: float = 0.006,
    cell_m: float = _CELL_M,
    rotation: NDArray[Any] | None = None,
) -> Part:
    """Return a box of `size_m` (x, y, z) with rounded edges, centred at `at`; the radius shrinks to fit.

    `cell_m` divides flat sides, for the colours of the vertices.
    """
    half = np.asarray(size_m, dtype=np.float64) / 2
    radius = min(radius_m, 0.49 * float(half.min()))
    grids = [_box_coordinates(h, radius, cell_m) for h in half]
    sides = [_box_side(grids, axis, sign) for axis in range(3) for sign in (-1, 1)]
    points = np.concatenate([vertices for vertices, _ in sides])
    offsets = np.cumsum([0] + [len(vertices) for vertices, _ in sides])
    faces = np.concatenate([faces + at_index for (_, faces), at_index in zip(sides, offsets[:-1], strict=True)])
    # The sides share their border vertices: merging them closes the surface.
    points, index = np.unique(points.round(9), axis=0, return_inverse=True)
    inner = np.clip(points, radius - half, half - radius)
    outward = points - inner
    vertices = inner + radius * outward / np.linalg.norm(outward, axis=1, keepdims=True)
    return Part(vertices=vertices, faces=index.reshape(-1)[faces].astype(np.int32), texture=texture).moved(at, rotation)


def _box_coordinates(half: float, radius: float, cell_m: float) -> NDArray[np.float64]:
    # Sorted grid lines along one side: the rounded rims and the flat between them.
    flat = np.linspace(radius - half, half - radius, 1 + max(1, round(2 * (half - radius) / cell_m)))
    rim = radius * np.array([1.0, 0.4142])
    return np.concatenate([-(half - radius) - rim, flat, (half - radius) + rim[::-1]])


def _box_side(grids: list[NDArray[np.float64]], axis: int, sign: int) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    i, j = (axis + 1) % 3, (axis + 2) % 3
    a, b = np.meshgrid(grids[i], grids[j], indexing="ij")
    vertices = np.empty((a.size, 3))
    vertices[:, axis], vertices[:, i], vertices[:, j] = sign * grids[axis][-1], a.ravel(), b.ravel()
    return vertices, _grid_faces(*a.shape, flip=sign < 0)


def _grid_faces(rows: int, columns: int, *, flip: bool) -> NDArray[np.int32]:
    # The (2 (rows-1) (columns-1), 3) triangles of a grid of vertices, or those seen from behind.
    index = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    a, b, c, d = (q.ravel() for q in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return faces[:, ::-1] if flip else faces


def lathe(profile_m: Sequence[tuple[float, float]], texture: Texture, *, segments: int = 32) -> Part:
    """Return the solid of revolution about z of a profile of (radius, height).

    The profile runs from axis to axis, bottom first, the material on its left.
    """
    rings = np.asarray(profile_m[1:-1], dtype=np.float64)
    angle = 2 * np.pi * np.arange(segments) / segments
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    sides = np.empty((len(rings), segments, 3))
    sides[..., :2] = rings[:, None, :1] * circle[None]
    sides[..., 2] = rings[:, 1:]
    poles = np.array([[0.0, 0.0, profile_m[0][1]], [0.0, 0.0, profile_m[-1][1]]])
    vertices = np.concatenate([sides.reshape(-1, 3), poles])
    return Part(vertices=vertices, faces=_ring_faces(len(rings), segments), texture=texture)


def tube(
    path_m: Sequence[Sequence[float] | NDArray[Any]],
    radius_m: float | Sequence[float],
    texture: Texture,
    *,
    segments: int = 10,
) -> Part:
    """Return a round bar along a polyline, closed at both ends; one radius, or one per point of the path."""
    path = np.asarray(path_m, dtype=np.float64)
    radii = np.broadcast_to(np.asarray(radius_m, dtype=np.float64), (len(path),))
    tangents = np.gradient(path, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    # One fixed helper direction keeps the rings from twisting; the paths here stay clear of it.
    spread = np.abs(tangents).sum(axis=0)
    helper = np.eye(3)[int(np.argmin(spread))]
    side = np.cross(tangents, helper)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(tangents, side)
    angle = 2 * np.pi * np.arange(segments) / segments
    rings = path[:, None] + radii[:, None, None] * (
        np.cos(angle)[None, :, None] * side[:, None] + np.sin(angle)[None, :, None] * up[:, None]
    )
    vertices = np.concatenate([rings.reshape(-1, 3), path[:1], path[-1:]])
    return Part(vertices=vertices, faces=_ring_faces(len(path), segments), texture=texture)


def _ring_faces(rings: int, segments: int) -> NDArray[np.int32]:
    # Triangles of stacked rings closed by two poles, which are the last two vertices.
    index = np.arange(rings * segments, dtype=np.int32).reshape(rings, segments)
    following = np.roll(index, -1, axis=1)
    a, b = index[:-1].ravel(), following[:-1].ravel()
    c, d = following[1:].ravel(), index[1:].ravel()
    first, last = rings * segments, rings * segments + 1
    below = np.stack([np.full(segments, first, dtype=np.int32), following[0], index[0]], axis=1)
    above = np.stack([np.full(segments, last, dtype=np.int32), index[-1], following[-1]], axis=1)
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1), below, above])


def ellipsoid(
    semi_axes_m: Sequence[float],
    texture: Texture,
    *,
    at: Sequence[float] = (0.0, 0.0, 0.0),
    rotation: NDArray[Any] | None = None,
) -> Part:
    """Return an ellipsoid centred at `at`."""
    polar = np.linspace(-np.pi / 2, np.pi / 2, 9)
    ball = lathe([(float(np.cos(a)), float(np.sin(a))) for a in polar], texture, segments=14)
    scaled = Part(vertices=ball.vertices * np.asarray(semi_axes_m), faces=ball.faces, texture=texture)
    return scaled.moved(at, rotation)
