"""Validation and clean-up of meshes from any reconstructor: unused vertices and triangles of one point go.

One such vertex a hundred metres away would make the certified object that large. A triangle that is a line stays.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.mesh import Mesh


def usable(mesh: Mesh) -> Mesh:
    """Return the mesh without vertices that no triangle uses and triangles that are one point.

    Raises:
        ValueError: no triangle has an extent, or they use vertices that do not exist or are not finite.
    """
    if len(mesh.faces) == 0:
        raise ValueError("an empty mesh: it has no triangles; a shape needs at least one")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise ValueError(f"the mesh has faces with vertex indices out of range ({len(mesh.vertices)}); repair it first")
    is_used, faces = used_surface(mesh.vertices, mesh.faces)
    vertices = mesh.vertices[is_used]
    bad = int((~np.isfinite(vertices)).any(axis=1).sum())
    if bad:
        raise ValueError(f"{bad} of {len(vertices)} vertices are not finite; remove them first")
    if len(faces) == 0:
        raise ValueError("all triangles of the mesh are one point; a shape needs an extent")
    if is_used.all() and len(faces) == len(mesh.faces):
        return mesh
    return replace(mesh, vertices=vertices, faces=faces, colors=mesh.colors[is_used], is_seen=mesh.is_seen[is_used])


def used_surface(vertices: NDArray[Any], faces: NDArray[np.int32]) -> tuple[NDArray[np.bool_], NDArray[np.int32]]:
    """Return (V,) which vertices belong to triangles with an extent, and these triangles with their new indices."""
    is_point = np.ones(len(faces), bool)
    for along in vertices.T:
        a, b, c = (along[faces[:, corner]] for corner in range(3))
        # NaN is not equal to anything: triangles with NaN are kept, and reported by the caller.
        is_point &= (a == b) & (b == c)
    kept = faces[~is_point]
    is_used = np.zeros(len(vertices), bool)
    is_used[kept.ravel()] = True
    places = np.cumsum(is_used) - 1
    return is_used, places[kept].astype(np.int32)
