"""The surfaces of a picture of a map: layers of its objects, walls and floor.

Only wall faces that look at both observed free space and the viewer are drawn, so that near walls hide nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.bounds import bounds_of, extent_of
from hickory_stream.geometry.display import color_of_id
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.superquadric_surface import display_mesh
from hickory_stream.geometry.voxels import cells_of_keys, contains, keys_of_cells, keys_of_points
from hickory_stream.pictures.legend import FIXTURE, with_tint, with_tinted_image
from hickory_stream.pictures.rasterize import Dots
from hickory_stream.pictures.raycast import Surface

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from hickory_stream.geometry.superquadric import Superquadrics
    from hickory_stream.map_folder.saved_map import SavedMap
    from hickory_stream.pictures.viewpoint import Viewpoint
    from hickory_stream.records import Submap, TrackedObject

WALL_COLOR = (214, 218, 226)
# Structure below the first height is drawn as the floor; structure above the second, the ceiling, is not drawn.
LEVEL_M, _CUT_M = 0.15, 2.0
_MIN_WALL_M = 0.6
_STEPS = np.concatenate([np.eye(3, dtype=np.int64), -np.eye(3, dtype=np.int64)])
_AROUND = tuple((i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0))
# What is nearer to one another in the image than this is one for the light, which is computed for every second pixel.
_COARSE_PX = 3.0
# With more cells than so many for each vertex, it is quicker to sort the vertices.
_MOST_CELLS = 8
# Half the side of a point's square, in spacings of the points: they overlap a little.
_COVER = 0.6
# Points of a map are no nearer to one another than about this.
_FINEST_M = 0.004
# So many points tell the spacing of all.
_ENOUGH = 1500
_QUAD = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
_QUAD_FACES = np.array([[0, 1, 2], [0, 2, 3]])


def dots_of(tracked: TrackedObject) -> Dots:
    """Return layer 1: dots about as large as the spacing of the points."""
    points = tracked.points_world
    return Dots(
        points=points, colors=_shown(tracked, tracked.colors), half_m=_COVER * _spacing_m(points), owner=tracked.id
    )


def coarse_squares(dots: Dots, viewpoint: Viewpoint) -> Surface:
    """Return dots as squares that face the viewer, one for dots that are close in the image."""
    points, colors, half_m = dots.points, dots.colors, dots.half_m
    apart_m = _COARSE_PX * viewpoint.pixel_m(points)
    if apart_m > _FINEST_M:
        _, chosen = np.unique(keys_of_points(points, apart_m), return_index=True)
        points, colors, half_m = points[chosen], colors[chosen], max(half_m, _COVER * apart_m)
    return _squares(points, viewpoint.towards_eye(points), half_m, colors, dots.owner)


def mesh_surface(saved: SavedMap, tracked: TrackedObject, texture_px: int) -> Surface:
    """Return layer 2 with generated surface tinted; raises `MapFolderError`.

    Its texture has at most `texture_px` a side; 0 is colours of vertices.
    """
    assert tracked.shape is not None
    mesh, uv, image = saved.mesh(tracked.shape), None, None
    if texture_px:
        from hickory_stream.map_folder.textured_objects import textured_object

        # As it was known earlier, a map may name views that are not kept.
        textured = textured_object(saved.views, tracked, mesh, texture_px, is_past=True)
        mesh, uv, image = textured.mesh, textured.uv, with_tinted_image(textured)
    vertices = apply(tracked.shape.world_from_object, mesh.vertices)
    colors = _shown(tracked, with_tint(mesh.colors, mesh.is_seen))
    image = None if image is None else _shown(tracked, image)
    return Surface(vertices=vertices, faces=mesh.faces, colors=colors, owner=tracked.id, uv=uv, image=image)


def _shown(tracked: TrackedObject, colors: NDArray[np.uint8]) -> NDArray[np.uint8]:
    # Fixtures have a tint.
    return with_tint(colors, np.zeros(colors.shape[:-1], dtype=bool), FIXTURE) if tracked.is_fixture else colors


def coarse(surface: Surface, viewpoint: Viewpoint) -> Surface:
    """Return a surface without triangles too small to affect the light: a large map has millions.

    Vertices are merged by cells (Rossignac and Borrel 1993).
    """
    if not len(surface.faces):
        return surface
    apart_m = _COARSE_PX * viewpoint.pixel_m(surface.vertices)
    while apart_m > _FINEST_M:
        chosen, cell_of = _in_cells(surface.vertices, apart_m)
        faces = _between_cells(surface.faces, cell_of)
        if len(faces):
            vertices, colors = surface.vertices[chosen], surface.colors[chosen]
            return Surface(vertices=vertices, faces=faces, colors=colors, owner=surface.owner)
        # All of it is in a cell or two: still to be seen, by the coarsest cells that leave triangles of it.
        apart_m /= 2
    return surface


def _in_cells(vertices: NDArray[np.float32], side_m: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    # np.unique of the vertices' cell keys: first vertex and inverse; counting is faster than sorting for few cells.
    lowest, highest = np.floor(bounds_of(vertices).astype(np.float64) / side_m)
    shape = highest - lowest + 1
    # In floats, which do not overflow: a mesh may be of any size.
    if shape.prod() > _MOST_CELLS * len(vertices):
        _, chosen, cell_of = np.unique(keys_of_points(vertices, side_m), return_index=True, return_inverse=True)
        return chosen, cell_of
    firsts, places = _counted_cells(vertices, side_m, lowest.astype(np.int64), shape.astype(np.int64))
    return firsts, places


@kernel
def _counted_cells(vertices, side_m, lowest, shape):
    count = len(vertices)
    cell_of = np.empty(count, np.int64)
    first = np.full(shape[0] * shape[1] * shape[2], -1, np.int64)
    for i in range(count):
        cell = np.int64(0)
        for k in range(3):
            cell = cell * shape[k] + np.int64(np.floor(np.float64(vertices[i, k]) / side_m)) - lowest[k]
        cell_of[i] = cell
        if first[cell] < 0:
            first[cell] = i
    chosen = first[first >= 0]
    place_of = np.cumsum(first >= 0) - 1
    for i in range(count):
        cell_of[i] = place_of[cell_of[i]]
    return chosen, cell_of


@kernel
def _between_cells(faces, cell_of):
    """Return the faces (F, 3) between three different cells, of whose places they are made."""
    out = np.empty((len(faces), 3), np.int32)
    count = 0
    for f in range(len(faces)):
        a, b, c = cell_of[faces[f, 0]], cell_of[faces[f, 1]], cell_of[faces[f, 2]]
        if a != b and b != c and c != a:
            out[count, 0], out[count, 1], out[count, 2] = a, b, c
            count += 1
    return out[:count].copy()


def superquadric_surfaces(primitives: Superquadrics, object_id: int, *, is_fixture: bool = False) -> list[Surface]:
    """Return layer 3 or 4 in the object's colour, with every second primitive a little darker."""
    surfaces = []
    for i in range(len(primitives)):
        vertices, faces = display_mesh(primitives, i, 0.004 * float(primitives.semi_axes_m[i].max()))
        color = np.array(color_of_id(object_id, is_fixture=is_fixture)) * (1.0, 0.86, 0.93)[i % 3]
        colors = np.tile(color.astype(np.uint8), (len(vertices), 1))
        surfaces.append(Surface(vertices=vertices, faces=faces, colors=colors, owner=object_id))
    return surfaces


def wall_surface(
    submap: Submap,
    above_m: Callable[[NDArray[np.float64]], NDArray[Any]],
    viewpoint: Viewpoint | None,
    most: int | None = None,
) -> Surface:
    """Return the walls: from above as a floor plan, else their inner faces that face the viewer, or all (None).

    `above_m` is the height of points above the floor; more than `most` faces are drawn as fewer and larger ones.
    """
    space = submap.observed_space
    cells = cells_of_keys(space.structure)
    height_m = above_m(apply(submap.world_from_submap, (cells + 0.5) * space.voxel_m))
    cells = cells[(height_m > LEVEL_M) & (height_m < _CUT_M)]
    if viewpoint is not None and viewpoint.is_orthographic:
        return _floor_plan(cells, submap)
    parts, side_m = [_facing(cells, step, submap, viewpoint) for step in _STEPS], space.voxel_m
    while most is not None and sum(len(center) for center, _ in parts) > most:
        side_m *= 2
        firsts = [np.unique(keys_of_points(center, side_m), return_index=True)[1] for center, _ in parts]
        parts = [(center[first], normal) for first, (center, normal) in zip(firsts, parts, strict=True)]
    centers = np.concatenate([center for center, _ in parts])
    normals = np.concatenate([np.broadcast_to(normal, center.shape) for center, normal in parts])
    return _wall_squares(centers, normals, side_m)


def ground_points(submap: Submap, floor_z_m: float) -> NDArray[np.float64]:
    """Return the points (N, 3) in the world of structure that is level with the floor, or no wall."""
    space = submap.observed_space
    cells = cells_of_keys(space.structure)
    points = apply(submap.world_from_submap, (cells + 0.5) * space.voxel_m)
    off_m = np.abs(points[:, 2] - floor_z_m)
    _, column, counts = np.unique(keys_of_cells(cells * (1, 1, 0)), return_inverse=True, return_counts=True)
    is_ground = (counts[column] * space.voxel_m < _MIN_WALL_M / 2) & (off_m < _CUT_M)
    return np.asarray(points[is_ground | (off_m <= LEVEL_M)])


def _facing(
    cells: NDArray[np.int64], step: NDArray[np.int64], submap: Submap, viewpoint: Viewpoint | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    space = submap.observed_space
    exposed = _in_a_wall(cells[contains(space.free, keys_of_cells(cells + step))], step)
    normal = submap.world_from_submap[:3, :3] @ step
    centers = apply(submap.world_from_submap, (exposed + 0.5 + 0.5 * step) * space.voxel_m)
    return centers if viewpoint is None else centers[viewpoint.towards_eye(centers) @ normal > 0], normal


def _in_a_wall(exposed: NDArray[np.int64], step: NDArray[np.int64]) -> NDArray[np.int64]:
    keys = keys_of_cells(exposed)
    ordered = np.sort(keys)
    # How far a step of a cell is from one key to the next.
    origin, *steps = keys_of_cells(np.stack([np.zeros(3), np.roll(step, 1), np.roll(step, 2), step]))
    across, along, up = (key - origin for key in steps)
    count = np.zeros(len(exposed), dtype=np.int64)
    for i, j in _AROUND:
        beside = keys + (i * across + j * along)
        count += contains(ordered, beside - up) | contains(ordered, beside) | contains(ordered, beside + up)
    return exposed[count >= len(_AROUND) // 2]


def _floor_plan(cells: NDArray[np.int64], submap: Submap) -> Surface:
    voxel_m = submap.observed_space.voxel_m
    columns, counts = np.unique(keys_of_cells(cells * (1, 1, 0)), return_counts=True)
    walls = cells_of_keys(columns[counts * voxel_m >= _MIN_WALL_M])[:, :2]
    centers = np.column_stack([(walls + 0.5) * voxel_m, np.full(len(walls), _CUT_M)])
    up = np.broadcast_to([0.0, 0.0, 1.0], centers.shape)
    return _wall_squares(apply(submap.world_from_submap, centers), up, voxel_m)


def _wall_squares(centers: NDArray[Any], normals: NDArray[Any], voxel_m: float) -> Surface:
    colors = np.tile(np.array(WALL_COLOR, dtype=np.uint8), (len(centers), 1))
    # Larger than a voxel, to close pinholes in the wall.
    return _squares(centers, normals, 0.8 * voxel_m, colors, 0)


def _squares(
    centers: NDArray[Any], normals: NDArray[Any], half_m: float, colors: NDArray[np.uint8], owner: int
) -> Surface:
    """Return a square around each of (N, 3) centres; upright where its normal is horizontal."""
    is_steep = np.abs(normals[:, 2:3]) > 0.999
    across = np.cross(np.where(is_steep, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]), normals)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    along = np.cross(normals, across)
    sides = np.stack([across, along], axis=1) * half_m
    vertices = centers[:, None, :] + np.einsum("qs,nsc->nqc", _QUAD, sides)
    faces = 4 * np.arange(len(centers))[:, None, None] + _QUAD_FACES
    return Surface(
        vertices=vertices.reshape(-1, 3), faces=faces.reshape(-1, 3), colors=np.repeat(colors, 4, axis=0), owner=owner
    )


def _spacing_m(points: NDArray[np.float32]) -> float:
    # A centimetre for few points. Points are in voxel order: a middle part of them is close together.
    if len(points) < 2:
        return 0.01
    start = max(0, (len(points) - _ENOUGH) // 2)
    some = points[start : start + _ENOUGH]
    axis = int(np.argmax(extent_of(some)))
    ordered = some[np.argsort(some[:, axis])].astype(np.float64)
    return float(np.clip(np.median(_nearest_m(ordered, axis)), 0.002, 0.05))


@kernel
def _nearest_m(ordered, axis):
    """Return (N,) how far the nearest other one of (N, 3) points is, which ascend along an axis.

    Of the points of a surface few are as near along the longest axis: no tree is as quick for so few of them.
    """
    count = len(ordered)
    out = np.empty(count)
    for i in range(count):
        least = np.inf
        for step in (-1, 1):
            j = i + step
            while 0 <= j < count:
                along = ordered[j, axis] - ordered[i, axis]
                if along * along >= least:
                    break
                squared = 0.0
                for k in range(3):
                    away = ordered[j, k] - ordered[i, k]
                    squared += away * away
                least = min(least, squared)
                j += step
        out[i] = np.sqrt(least)
    return out
