"""Ray casting of coloured surfaces without a screen."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.pictures.open3d_import import import_open3d
from hickory_stream.pictures.ray_caster import RayCaster, ray_caster

# A face that differs by more than this angle from its smoothed normal is at a sharp edge, and keeps its own normal.
CREASE_COSINE = 0.82


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """Coloured triangles: `vertices` (V, 3) float32, `faces` (F, 3) int32, `colors` (V, 3) uint8, and their owner.

    An `image` (H, W, 3) uint8 replaces the vertex colours by its own at `uv` (V, 2), v down.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    colors: NDArray[np.uint8]
    owner: int
    uv: NDArray[np.float32] | None = None
    image: NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        freeze(self, "vertices", np.float32, (None, 3))
        freeze(self, "faces", np.int32, (None, 3))
        freeze(self, "colors", np.uint8, (len(self.vertices), 3))
        if self.image is not None:
            freeze(self, "uv", np.float32, (len(self.vertices), 2))
            freeze(self, "image", np.uint8, (None, None, 3))

    @cached_property
    def normals(self) -> NDArray[np.float32]:
        """Unit normals (V, 3) of the vertices from all adjacent faces, shared by every view."""
        normals = vertex_normals(self.vertices, self.faces)
        normals.flags.writeable = False
        return normals


def surface_of_mesh(mesh: Mesh, owner: int = 0) -> Surface:
    """Return the surface of a mesh in its own colours."""
    return Surface(vertices=mesh.vertices, faces=mesh.faces, colors=mesh.colors, owner=owner)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Hits:
    """The first hits of N rays.

    `distance_m` (N,) float32, inf without a hit; `normals` (N, 3) float32, unit, towards the ray's origin, smoothed
    except at sharp edges; `colors` (N, 3) float32 in 0..1; `owners` (N,) int32, -1 without a hit.
    """

    distance_m: NDArray[np.float32]
    normals: NDArray[np.float32]
    colors: NDArray[np.float32]
    owners: NDArray[np.int32]

    def part(self, chosen: NDArray[np.int64]) -> "Hits":
        """Return the hits of some of the rays."""
        return Hits(
            distance_m=self.distance_m[chosen],
            normals=self.normals[chosen],
            colors=self.colors[chosen],
            owners=self.owners[chosen],
        )


class Scene:
    """Surfaces to cast rays at."""

    def __init__(self, surfaces: Sequence[Surface]) -> None:
        vertices, faces, colors, owners = _joined(surfaces)
        self._vertices, self._faces, self._owners = vertices, faces, owners
        self._colors = colors.astype(np.float32) / np.float32(255)
        self._surfaces = surfaces
        self._first_faces = np.cumsum([0, *(len(surface.faces) for surface in surfaces)])
        self._distances: Any = None

    @cached_property
    def _normals(self) -> NDArray[np.float32]:
        return vertex_normals(self._vertices, self._faces)

    @cached_property
    def _caster(self) -> RayCaster | None:
        if not len(self._faces):
            return None
        caster = ray_caster()
        caster.add(self._vertices, self._faces)
        return caster

    def cast(self, origins: NDArray[Any], directions: NDArray[Any]) -> Hits:
        """Return the first hits of rays with (N, 3) origins and (N, 3) unit directions."""
        count = len(origins)
        normals, colors = np.zeros((2, count, 3), dtype=np.float32)
        if self._caster is None:
            nothing = np.full(count, np.inf, dtype=np.float32)
            return Hits(distance_m=nothing, normals=normals, colors=colors, owners=np.full(count, -1, dtype=np.int32))
        found = self._caster.cast(_rays(origins, directions))
        owners = np.full(count, -1, dtype=np.int32)
        hit = np.isfinite(found.t)
        triangles = found.triangle[hit]
        corners = self._faces[triangles]
        uv = found.uv[hit]
        weights = np.stack([1 - uv.sum(axis=1), uv[:, 0], uv[:, 1]], axis=1).astype(np.float32)
        colors[hit] = np.einsum("nk,nkc->nc", weights, self._colors[corners])
        colors[hit] = self._with_textures(colors[hit], triangles.astype(np.int64), weights)
        smooth = np.einsum("nk,nkc->nc", weights, self._normals[corners])
        normals[hit] = _towards(_smoothed(found.normals[hit], smooth), directions[hit])
        owners[hit] = self._owners[triangles]
        return Hits(distance_m=found.t, normals=normals, colors=colors, owners=owners)

    def distances_m(self, origins: NDArray[Any], directions: NDArray[Any]) -> NDArray[np.float32]:
        """Return (N,) distances to the first hits, inf without one; twice as fast as `cast`."""
        if self._caster is None:
            return np.full(len(origins), np.inf, dtype=np.float32)
        return self._caster.cast(_rays(origins, directions)).t

    def _with_textures(
        self, colors: NDArray[np.float32], triangles: NDArray[np.int64], weights: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        of_hit = np.searchsorted(self._first_faces, triangles, side="right") - 1
        for i in np.unique(of_hit):
            surface = self._surfaces[i]
            if surface.image is None or surface.uv is None:
                continue
            here = np.flatnonzero(of_hit == i)
            corners = surface.faces[triangles[here] - self._first_faces[i]]
            places = np.einsum("nk,nkc->nc", weights[here], surface.uv[corners])
            colors[here] = image_colors(surface.image, places)
        return colors

    def is_occluded(self, origins: NDArray[Any], directions: NDArray[Any], reach_m: float) -> NDArray[np.bool_]:
        """Return (N,) whether each ray hits a surface within `reach_m`."""
        if self._caster is None:
            return np.zeros(len(origins), dtype=bool)
        return self._caster.is_occluded(_rays(origins, directions), reach_m)

    def nearest(self, points: NDArray[Any]) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """Return the distances (N,) of (N, 3) points to the nearest surface, and its owners (inf, -1 without one).

        Raises `InputError` without Open3D.
        """
        if len(self._faces) == 0:
            return np.full(len(points), np.inf, dtype=np.float32), np.full(len(points), -1, dtype=np.int32)
        open3d = import_open3d()
        if self._distances is None:
            self._distances = open3d.t.geometry.RaycastingScene()
            triangles = open3d.core.Tensor(self._faces.astype(np.uint32))
            self._distances.add_triangles(open3d.core.Tensor(self._vertices), triangles)
        query = np.ascontiguousarray(points, dtype=np.float32)
        answer = self._distances.compute_closest_points(open3d.core.Tensor(query))
        distance_m = np.linalg.norm(answer["points"].numpy() - query, axis=1)
        return distance_m, self._owners[answer["primitive_ids"].numpy()]


def image_colors(image: NDArray[np.uint8], uv: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return (N, 3) bilinear colours in 0..1 of an image at places (N, 2)."""
    height, width = image.shape[:2]
    x, y = np.clip(uv[:, 0] * width - 0.5, 0, width - 1), np.clip(uv[:, 1] * height - 0.5, 0, height - 1)
    column, row = np.minimum(x.astype(np.int64), width - 2), np.minimum(y.astype(np.int64), height - 2)
    right, down = (x - column)[:, None], (y - row)[:, None]
    above = image[row, column] * (1 - right) + image[row, column + 1] * right
    below = image[row + 1, column] * (1 - right) + image[row + 1, column + 1] * right
    return np.asarray((above * (1 - down) + below * down) / 255, dtype=np.float32)


def _rays(origins: NDArray[Any], directions: NDArray[Any]) -> NDArray[np.float32]:
    return np.concatenate([origins, directions], axis=1).astype(np.float32)


def _joined(
    surfaces: Sequence[Surface],
) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.uint8], NDArray[np.int32]]:
    starts = np.cumsum([0, *(len(surface.vertices) for surface in surfaces)])
    return (
        np.concatenate([np.empty((0, 3), np.float32), *(surface.vertices for surface in surfaces)]),
        np.concatenate(
            [
                np.empty((0, 3), np.int32),
                *(surface.faces + np.int32(start) for surface, start in zip(surfaces, starts[:-1], strict=True)),
            ]
        ),
        np.concatenate([np.empty((0, 3), np.uint8), *(surface.colors for surface in surfaces)]),
        np.repeat(
            np.array([surface.owner for surface in surfaces], dtype=np.int32),
            [len(surface.faces) for surface in surfaces],
        ),
    )


def vertex_normals(vertices: NDArray[np.float32], faces: NDArray[np.int32]) -> NDArray[np.float32]:
    """Return (V, 3) unit normals, the mean of the faces around each vertex weighted by area."""
    normals: NDArray[np.float32] = _normals_of_vertices(vertices, faces)
    return normals


@kernel
def _normals_of_vertices(vertices, faces):
    sums = np.zeros((len(vertices), 3))
    for f in range(len(faces)):
        a, b, c = faces[f]
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        for corner in (a, b, c):
            sums[corner, 0] += nx
            sums[corner, 1] += ny
            sums[corner, 2] += nz
    normals = np.empty((len(vertices), 3), np.float32)
    for i in range(len(vertices)):
        length = np.sqrt(sums[i, 0] * sums[i, 0] + sums[i, 1] * sums[i, 1] + sums[i, 2] * sums[i, 2])
        for k in range(3):
            normals[i, k] = sums[i, k] / max(length, 1e-12)
    return normals


def _smoothed(flat: NDArray[np.float32], smooth: NDArray[np.float32]) -> NDArray[np.float32]:
    smooth = _unit(smooth)
    is_gentle = np.abs(np.einsum("nc,nc->n", flat, smooth)) > CREASE_COSINE
    return np.where(is_gentle[:, None], smooth, flat)


def _towards(normals: NDArray[np.float32], directions: NDArray[Any]) -> NDArray[np.float32]:
    looks_away = np.einsum("nc,nc->n", normals, directions) > 0
    return np.where(looks_away[:, None], -normals, normals)


def _unit(vectors: NDArray[Any]) -> NDArray[Any]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
