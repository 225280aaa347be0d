"""The surfaces of a picture of a map: layers of its objects, walls and floor.

Walls are drawn from the inside only: of a structure voxel, those faces are drawn that face both observed free space and
the viewer. The near walls of a room, seen from outside, are therefore not drawn.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import cKDTree

from hickory_stream.evaluation.rasterize import Dots
from hickory_stream.evaluation.raycast import Surface
from hickory_stream.geometry.palette import color_of_id
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.superquadric_surface import display_mesh
from hickory_stream.geometry.voxels import cells_of_keys, contains, keys_of_cells, keys_of_points

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.engine.saved_map import SavedMap
    from hickory_stream.evaluation.viewpoint import Viewpoint
    from hickory_stream.geometry.superquadric import Superquadrics
    from hickory_stream.records import Submap, TrackedObject

WALL_COLOR = (214, 218, 226)
# Structure below the first height is drawn as the floor; structure above the second, the ceiling, is not drawn.
_FLOOR_REACH_M, _CUT_M = 0.15, 2.0
_MIN_WALL_M = 0.6
_STEPS = np.concatenate([np.eye(3, dtype=np.int64), -np.eye(3, dtype=np.int64)])
_AROUND = tuple((i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0))
# What is nearer to one another in the image than this is one for the light, which is computed for every second pixel.
_COARSE_PX = 3.0
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
    return Dots(points=points, colors=tracked.colors, half_m=_COVER * _spacing_m(points), owner=tracked.id)


def coarse_squares(dots: Dots, viewpoint: Viewpoint) -> Surface:
    """Return dots as squares that face the viewer, with one of those that are near one another in the image."""
    points, colors, half_m = dots.points, dots.colors, dots.half_m
    apart_m = _COARSE_PX * viewpoint.pixel_m(points)
    if apart_m > _FINEST_M:
        _, chosen = np.unique(keys_of_points(points, apart_m), return_index=True)
        points, colors, half_m = points[chosen], colors[chosen], max(half_m, _COVER * apart_m)
    return _squares(points, viewpoint.towards_eye(points), half_m, colors, dots.owner)


def mesh_surface(saved: SavedMap, tracked: TrackedObject, texture_px: int) -> Surface:
    """Return layer 2, with a texture of at most so many pixels on a side unless that is 0; there must be a shape.

    Raises:
        MapFolderError: the mesh or a view cannot be read.
    """
    assert tracked.shape is not None
    mesh, uv, image = saved.mesh(tracked.shape), None, None
    if texture_px:
        from hickory_stream.engine.textured_objects import textured_object

        # As it was known earlier, a map may name views that are not kept.
        textured = textured_object(saved.views, tracked, mesh, texture_px, is_past=True)
        mesh, uv, image = textured.mesh, textured.uv, textured.image
    vertices = apply(tracked.shape.world_from_object, mesh.vertices)
    return Surface(vertices=vertices, faces=mesh.faces, colors=mesh.colors, owner=tracked.id, uv=uv, image=image)


def coarse(surface: Surface, viewpoint: Viewpoint) -> Surface:
    """Return a surface without the triangles that are too small to matter to the light: a large map has millions.

    Vertices in one cell of that size become one of them (Rossignac and Borrel 1993).
    """
    apart_m = _COARSE_PX * viewpoint.pixel_m(surface.vertices)
    while apart_m > _FINEST_M:
        _, chosen, cell_of = np.unique(
            keys_of_points(surface.vertices, apart_m), return_index=True, return_inverse=True
        )
        faces = cell_of.astype(np.int32)[surface.faces]
        a, b, c = faces.T
        faces = faces[(a != b) & (b != c) & (c != a)]
        if len(faces):
            vertices, colors = surface.vertices[chosen], surface.colors[chosen]
            return Surface(vertices=vertices, faces=faces, colors=colors, owner=surface.owner)
        # All of it is in a cell or two: still to be seen, by the coarsest cells that leave triangles of it.
        apart_m /= 2
    return surface


def superquadric_surfaces(primitives: Superquadrics, object_id: int) -> list[Surface]:
    """Return layer 3 or 4 in the object's colour, with every second primitive a little darker."""
    surfaces = []
    for i in range(len(primitives)):
        vertices, faces = display_mesh(primitives, i, 0.004 * float(primitives.semi_axes_m[i].max()))
        color = np.array(color_of_id(object_id)) * (1.0, 0.86, 0.93)[i % 3]
        colors = np.tile(color.astype(np.uint8), (len(vertices), 1))
        surfaces.append(Surface(vertices=vertices, faces=faces, colors=colors, owner=object_id))
    return surfaces


def wall_surface(submap: Submap, floor_z_m: float, viewpoint: Viewpoint) -> Surface:
    """Return the walls: from above as a floor plan, else their inner faces that face the viewer."""
    space = submap.observed_space
    cells = cells_of_keys(space.structure)
    height_m = apply(submap.world_from_submap, (cells + 0.5) * space.voxel_m)[:, 2] - floor_z_m
    cells = cells[(height_m > _FLOOR_REACH_M) & (height_m < _CUT_M)]
    if viewpoint.is_orthographic:
        return _floor_plan(cells, submap)
    parts = [_facing(cells, step, submap, viewpoint) for step in _STEPS]
    centers = np.concatenate([center for center, _ in parts])
    normals = np.concatenate([np.broadcast_to(normal, center.shape) for center, normal in parts])
    return _wall_squares(centers, normals, space.voxel_m)


def floor_cells(submap: Submap, floor_z_m: float) -> NDArray[np.float64]:
    """Return the points (N, 2) in the world where structure was seen at the height of the floor."""
    space = submap.observed_space
    centers = apply(submap.world_from_submap, (cells_of_keys(space.structure) + 0.5) * space.voxel_m)
    return np.asarray(centers[np.abs(centers[:, 2] - floor_z_m) <= _FLOOR_REACH_M, :2])


def _facing(
    cells: NDArray[np.int64], step: NDArray[np.int64], submap: Submap, viewpoint: Viewpoint
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the centres, in the world, of the faces on one side of the cells that face free space and the viewer."""
    space = submap.observed_space
    exposed = _in_a_wall(cells[contains(space.free, keys_of_cells(cells + step))], step)
    normal = submap.world_from_submap[:3, :3] @ step
    centers = apply(submap.world_from_submap, (exposed + 0.5 + 0.5 * step) * space.voxel_m)
    return centers[viewpoint.towards_eye(centers) @ normal > 0], normal


def _in_a_wall(exposed: NDArray[np.int64], step: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the cells with at least half of their eight neighbours across `step`, to within one cell along `step`."""
    keys = np.sort(keys_of_cells(exposed))
    across, along = np.roll(step, 1), np.roll(step, 2)
    count = np.zeros(len(exposed), dtype=np.int64)
    for i, j in _AROUND:
        beside = exposed + i * across + j * along
        count += np.any([contains(keys, keys_of_cells(beside + up * step)) for up in (-1, 0, 1)], axis=0)
    return exposed[count >= len(_AROUND) // 2]


def _floor_plan(cells: NDArray[np.int64], submap: Submap) -> Surface:
    """Return a square for each column of cells of at least the height of a wall."""
    voxel_m = submap.observed_space.voxel_m
    columns, counts = np.unique(cells[:, :2], axis=0, return_counts=True)
    walls = columns[counts * voxel_m >= _MIN_WALL_M]
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
    """Return the median distance between neighbouring points; a centimetre if there are too few points.

    Points of a map are in the order of the voxels that they lie in: those in the middle of it are together in a part.
    """
    if len(points) < 2:
        return 0.01
    start = max(0, (len(points) - _ENOUGH) // 2)
    some = points[start : start + _ENOUGH]
    distances, _ = cKDTree(some).query(some, k=2)
    return float(np.clip(np.median(distances[:, 1]), 0.002, 0.05))
