"""Samples of the surface of an object that is visible from outside.

Parts of a true object may overlap; surface of one part inside another is left out.
"""

import itertools

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.mesh import Mesh, sample_surface
from hickory_stream.pictures.ray_caster import ray_caster

_DIRECTIONS = 48
# Directions to try before the remaining ones.
_AT_ONCE = (2, 6, 16)


def exposed_samples(
    mesh: Mesh, count: int, rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Return (N, 3) surface samples, N <= count, visible from some direction outside, and their (N, 3) normals."""
    points, faces = sample_surface(mesh, count, rng)
    a, b, c = (mesh.vertices[mesh.faces[faces, i]].astype(np.float64) for i in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    directions = rng.standard_normal((_DIRECTIONS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    side = np.sign(normals @ directions.T)
    start = points + 1e-4 * normals
    caster = ray_caster()
    caster.add(mesh.vertices, mesh.faces)
    is_exposed = np.zeros(len(points), dtype=bool)
    # Most of a surface is open to the first few directions.
    for first, last in itertools.pairwise((0, *_AT_ONCE, _DIRECTIONS)):
        hidden = np.flatnonzero(~is_exposed)
        if len(hidden) == 0:
            break
        towards = directions[first:last] * side[hidden, first:last, None]
        rays = np.concatenate([np.broadcast_to(start[hidden, None], towards.shape), towards], axis=2)
        is_hit = caster.is_occluded(rays.astype(np.float32).reshape(-1, 6)).reshape(towards.shape[:2])
        is_exposed[hidden] = ~is_hit.all(axis=1)
    return points[is_exposed], normals[is_exposed]
