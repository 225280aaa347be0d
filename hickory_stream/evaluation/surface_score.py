"""Agreement of two meshes: F1 of surface samples, ADD-S, diameter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.distance import pdist

from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.mesh import Mesh, sample_surface
from hickory_stream.pictures.raycast import Scene, Surface

FINE_M = 0.01
SHARE_OF_DIAMETER = 0.05
SAMPLES = 4000


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TrueSurface:
    """A true object in the world: its mesh, and (N, 3) samples of the surface visible from outside."""

    mesh: Mesh
    samples: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze(self, "samples", np.float64, (None, 3))


@dataclass(frozen=True, kw_only=True, slots=True)
class SurfaceScore:
    """`f1_1cm` and `f1_5pct` in 0..1; `add_s_m` the mean distance from the true samples to the mesh."""

    f1_1cm: float
    f1_5pct: float
    add_s_m: float


def surface_score(true: TrueSurface, found: Mesh, rng: np.random.Generator) -> SurfaceScore:
    """Return the agreement of a mesh with a true one, both in the world frame.

    Within a distance threshold, recall is of true samples to the mesh, precision of mesh samples to the true mesh, F1
    their harmonic mean. Distances are to triangles.
    """
    samples, _ = sample_surface(found, SAMPLES, rng)
    to_found = distance_to(found, true.samples)
    to_true = distance_to(true.mesh, samples)
    d = diameter_m(true.mesh.vertices)
    return SurfaceScore(
        f1_1cm=_f1(to_found, to_true, FINE_M),
        f1_5pct=_f1(to_found, to_true, SHARE_OF_DIAMETER * d),
        add_s_m=float(to_found.mean()),
    )


def distance_to(mesh: Mesh, points: NDArray[Any]) -> NDArray[np.float64]:
    """Return the (N,) distances from (N, 3) points to the triangles of a mesh."""
    surface = Surface(vertices=mesh.vertices, faces=mesh.faces, colors=mesh.colors, owner=0)
    return Scene([surface]).nearest(np.asarray(points, dtype=np.float32))[0].astype(np.float64)


def diameter_m(points: NDArray[Any]) -> float:
    """Return the largest distance between two of (N, 3) points."""
    corners = np.asarray(points, dtype=np.float64)
    try:
        corners = corners[ConvexHull(corners).vertices]
    except QhullError:  # Coplanar or too few points: no hull, and all points are compared.
        corners = np.unique(corners, axis=0)
    return float(pdist(corners).max()) if len(corners) > 1 else 0.0


def _f1(to_found: NDArray[np.float64], to_true: NDArray[np.float64], reach_m: float) -> float:
    recall, precision = float((to_found <= reach_m).mean()), float((to_true <= reach_m).mean())
    return 2 * recall * precision / (recall + precision) if recall + precision > 0 else 0.0
