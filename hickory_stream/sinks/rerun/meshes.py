"""Meshes for the viewer: layer 2, superquadrics, cells of a floor."""

from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from hickory_stream.base.confined import read_within
from hickory_stream.geometry.codecs.mesh_file import mesh_of_file
from hickory_stream.geometry.display import shaded
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import apply, quaternion_from_rotation
from hickory_stream.geometry.superquadric import Superquadrics, outward_normals
from hickory_stream.geometry.superquadric_surface import display_mesh
from hickory_stream.map_folder.layout import SHAPES, VIEWS
from hickory_stream.pictures.legend import with_tint, with_tinted_image
from hickory_stream.pictures.raycast import Surface
from hickory_stream.records import TrackedObject


def placed_mesh(path: Path, world_from_object: NDArray[np.float64]) -> Any:
    """Return a layer-2 mesh in the world, generated surface tinted, with normals: the viewer draws it flat without."""
    mesh = mesh_of_file(read_within(path.parent, path.name))
    return mesh_of_surface(_placed(mesh, world_from_object), vertex_colors=with_tint(mesh.colors, mesh.is_seen))


def mesh_of_surface(surface: Surface, **look: Any) -> Any:
    """Return a surface as the viewer takes it; `look` are the other arguments of a Mesh3D."""
    return rr.Mesh3D(
        vertex_positions=surface.vertices, triangle_indices=surface.faces, vertex_normals=surface.normals, **look
    )


def textured_layer2(folder: Path, tracked: TrackedObject, texture_px: int) -> Any:
    """Return layer 2 in the world with a texture of at most `texture_px` a side; the object must have a shape.

    Raises `OSError`, `ValueError` or `MapFolderError` if the mesh or a view is missing or damaged.
    """
    from hickory_stream.map_folder.textured_objects import textured_object

    assert tracked.shape is not None
    mesh = mesh_of_file(read_within(folder / SHAPES, tracked.shape.mesh_name))
    textured = textured_object(folder / VIEWS, tracked, mesh, texture_px)
    pose = tracked.shape.world_from_object
    return rr.Mesh3D(
        vertex_positions=_placed(textured.mesh, pose).vertices,
        triangle_indices=textured.mesh.faces,
        # Those of the bare mesh, whose vertices are not apart at the borders of charts.
        vertex_normals=_placed(mesh, pose).normals[textured.source],
        vertex_texcoords=textured.uv,
        albedo_texture=with_tinted_image(textured),
    )


def _placed(mesh: Mesh, world_from_object: NDArray[np.float64]) -> Surface:
    return Surface(vertices=apply(world_from_object, mesh.vertices), faces=mesh.faces, colors=mesh.colors, owner=0)


def superquadric_mesh(
    primitives: Superquadrics, color: tuple[int, int, int], *, alpha: int = 255, is_shaded: bool = True
) -> Any:
    """Return all primitives of an object as one mesh; `is_shaded` alternates their brightness."""
    parts = [display_mesh(primitives, i) for i in range(len(primitives))]
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    vertices = np.concatenate([np.zeros((0, 3), np.float32), *(vertices for vertices, _ in parts)])
    faces = np.concatenate(
        [np.zeros((0, 3), np.int32), *(f + start for (_, f), start in zip(parts, starts[:-1], strict=True))]
    )
    normals = [outward_normals(primitives, i, vertices) for i, (vertices, _) in enumerate(parts)]
    shades = [shaded(color, (1.0, 0.72, 1.6)[i % 3]) for i in range(len(parts))]
    colors = np.repeat(np.array(shades, np.uint8).reshape(-1, 3), np.diff(starts), axis=0)
    return rr.Mesh3D(
        vertex_positions=vertices,
        triangle_indices=faces,
        vertex_normals=np.concatenate([np.zeros((0, 3)), *normals]).astype(np.float32),
        vertex_colors=colors if is_shaded else None,
        albedo_factor=(*((255, 255, 255) if is_shaded else color), alpha),
    )


def wire_box(world_from_box: NDArray[np.float64], half_m: NDArray[np.float64], color: tuple[int, int, int]) -> Any:
    """Return the edges of a box from its pose (4, 4) and half sides (3,)."""
    return rr.Boxes3D(
        centers=[world_from_box[:3, 3]],
        half_sizes=[half_m],
        quaternions=[rr.Quaternion(xyzw=quaternion_from_rotation(world_from_box[:3, :3]))],
        colors=color,
        fill_mode=rr.components.FillMode.MajorWireframe,
    )


def tiles_mesh(rectangles: NDArray[np.float64], z_m: float, color: tuple[int, int, int]) -> Any:
    """Return level rectangles (N, 4), low and high corner, at one height as a mesh."""
    x0, y0, x1, y1 = rectangles.T
    corners = np.stack([x0, y0, x1, y0, x1, y1, x0, y1], axis=1).reshape(-1, 2)
    first = 4 * np.arange(len(rectangles))[:, None, None]
    return rr.Mesh3D(
        vertex_positions=np.column_stack([corners, np.full(len(corners), z_m)]).astype(np.float32),
        triangle_indices=(first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3),
        vertex_normals=np.tile(np.array([0, 0, 1], dtype=np.float32), (len(corners), 1)),
        albedo_factor=color,
    )
