"""The certificate of a stored layer 4, checked again from the mesh and the primitives."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.rigid import apply
from hickory_stream.shapes.certify import certify, inside_of
from hickory_stream.shapes.usable import used_surface

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.geometry.mesh import Mesh
    from hickory_stream.records import ObjectShape
    from hickory_stream.shapes.certify import Certificate

# Collision checks treat a primitive as solid up to this value of G.
_G = 1.0


def proven_anew(shape: ObjectShape, mesh: Mesh, points_world: NDArray[np.floating]) -> Certificate:
    """Return whether the inflated primitives contain mesh, points (N, 3) and interior with the recorded margin.

    Raises:
        ValueError: the margin is negative or not finite, or the mesh has no surface.
    """
    margin_m = shape.containment.margin_m
    if not 0 <= margin_m < np.inf:
        raise ValueError(f"a margin of {margin_m} m")
    vertices = apply(shape.world_from_object, mesh.vertices.astype(np.float64))
    is_used, faces = used_surface(vertices, mesh.faces)
    if len(faces) == 0:
        raise ValueError("a mesh without a surface")
    vertices = vertices[is_used]
    inside = inside_of(vertices, faces, r_safe_m=margin_m)
    points = np.ascontiguousarray(points_world, dtype=np.float64)
    return certify(shape.inflated, vertices, faces, points, inside, r_safe_m=margin_m, g=_G)
