"""Agreement of two meshes: F1 of surface samples, ADD-S, diameter, invented volume; and generated surface."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.distance import pdist

from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.mesh import Mesh, face_areas_m2, sample_surface
from hickory_stream.pictures.raycast import Scene, surface_of_mesh

FINE_M = 0.01
SHARE_OF_DIAMETER = 0.05
SAMPLES = 4000
INVENTED_M = 0.05
_CELLS, _LEAST_CELL_M = 48, 0.005
# More than half a cell: no step between two cells passes a surface that lies on neither.
_HALF_CELL, _BLOCK = 0.51, 4


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
    return Scene([surface_of_mesh(mesh)]).nearest(np.asarray(points, dtype=np.float32))[0].astype(np.float64)


def diameter_m(points: NDArray[Any]) -> float:
    """Return the largest distance between two of (N, 3) points."""
    corners = np.asarray(points, dtype=np.float64)
    try:
        corners = corners[ConvexHull(corners).vertices]
    except QhullError:  # Coplanar or too few points: no hull, and all points are compared.
        corners = np.unique(corners, axis=0)
    return float(pdist(corners).max()) if len(corners) > 1 else 0.0


def area_m2(mesh: Mesh) -> float:
    """Return the area of the surface."""
    return float(face_areas_m2(mesh).sum())


def generated_m2(mesh: Mesh) -> float:
    """Return the area of the surface that is generated: of each face, the share of its vertices."""
    return float((face_areas_m2(mesh) * (1.0 - mesh.is_seen[mesh.faces].mean(axis=1))).sum())


class Filled:
    """A mesh as a solid on a grid: the cells that air from outside its bounds does not reach.

    True meshes may have double walls, or lack the side on the floor or a wall. Air passes neither the mesh nor
    `walls`. Cells on the outer surface count half.
    """

    def __init__(self, mesh: Mesh, walls: Scene | None = None) -> None:
        low, high = mesh.vertices.min(axis=0).astype(np.float64), mesh.vertices.max(axis=0)
        self._cell_m = max(float((high - low).max()) / _CELLS, _LEAST_CELL_M)
        self._low = low - 2 * self._cell_m
        shape = tuple(int(cells) + 5 for cells in np.ceil((high - low) / self._cell_m))
        is_surface = self._is_near(Scene([surface_of_mesh(mesh)]), shape)
        is_wall = np.zeros(shape, dtype=bool) if walls is None else self._is_near(walls, shape)
        pockets, _ = ndimage.label(~(is_surface | is_wall))
        ends = [np.take(pockets, end, axis=axis).ravel() for axis in range(3) for end in (0, -1)]
        self._is_air = np.isin(pockets, np.unique(np.concatenate(ends))) & ~(is_surface | is_wall)
        is_outside = ~is_surface & (self._is_air | is_wall)
        volumes = np.where(is_outside, 0.0, self._cell_m**3)
        volumes[is_surface & ndimage.binary_dilation(is_outside, iterations=2)] /= 2
        self.centers, self.volumes_m3 = self._low + self._cell_m * np.argwhere(volumes), volumes[volumes > 0]

    def _is_near(self, scene: Scene, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        # Blocks of cells that no surface comes near are left out first.
        blocks = tuple(-(-cells // _BLOCK) for cells in shape)
        middles = self._low + self._cell_m * (_BLOCK * np.indices(blocks).reshape(3, -1).T + (_BLOCK - 1) / 2)
        reach_m = self._cell_m * (_HALF_CELL + np.sqrt(3) * (_BLOCK - 1) / 2)
        is_near = (scene.nearest(middles)[0] <= reach_m).reshape(blocks).repeat(_BLOCK, 0).repeat(_BLOCK, 1)
        is_near = is_near.repeat(_BLOCK, 2)[tuple(slice(count) for count in shape)]
        centers = self._low + self._cell_m * np.argwhere(is_near)
        is_near[is_near] = scene.nearest(centers)[0] <= _HALF_CELL * self._cell_m
        return np.asarray(is_near)

    def is_air(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which of (N, 3) points are outside, and not on walls."""
        places = np.round((points - self._low) / self._cell_m).astype(np.int64)
        is_within = ((places >= 0) & (places < self._is_air.shape)).all(axis=1)
        places[~is_within] = 0
        return np.asarray(~is_within | self._is_air[tuple(places.T)])


def invented_m3(found: Mesh, true: Mesh, walls: Scene | None = None) -> tuple[float, float]:
    """Return the volume of a mesh farther than 5 cm outside the true one, and the true volume; both in the world."""
    ours, thing = Filled(found), Filled(true, walls)
    beyond = thing.is_air(ours.centers)
    beyond[beyond] = distance_to(true, ours.centers[beyond]) > INVENTED_M
    return float(ours.volumes_m3[beyond].sum()), float(thing.volumes_m3.sum())


def _f1(to_found: NDArray[np.float64], to_true: NDArray[np.float64], reach_m: float) -> float:
    recall, precision = float((to_found <= reach_m).mean()), float((to_true <= reach_m).mean())
    return 2 * recall * precision / (recall + precision) if recall + precision > 0 else 0.0
