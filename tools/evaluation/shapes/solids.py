"""What shapes are compared with: occupancy and distances by ray casting, independent of the code that is measured."""

from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hickory_stream.geometry.superquadric import Superquadrics, log_implicit_value, volumes_m3
from hickory_stream.geometry.superquadric_surface import display_mesh
from hickory_stream.pictures.open3d_import import import_open3d
from hickory_stream.shapes.sdf import distance_grid

_SAMPLES = 8000
_SAMPLES_OF_PART = 2000


class Solid:
    """A mesh as a solid: the union of its parts, each by the parity of rays; a mesh with holes by winding numbers."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self.mesh = mesh
        parts = mesh.split(only_watertight=False) if len(mesh.faces) < 20_000 else [mesh]
        closed = [part for part in parts if part.is_watertight]
        self._parts = [_scene(part) for part in closed] if len(closed) == len(parts) else []
        self._whole = _scene(mesh)

    def contains(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return (N,) whether (N, 3) points are inside."""
        if not self._parts:
            return self._by_winding(points)
        return np.asarray(np.any([_scene_holds(part, points) for part in self._parts], axis=0))

    def volume_m3(self) -> float:
        """Return the volume of the union of the closed parts; what several of them hold is estimated from samples."""
        parts = self.mesh.split(only_watertight=True)
        total = 0.0
        for part in parts:
            inside = np.ones(1)
            if len(parts) > 1:
                points = part.bounding_box_oriented.sample_volume(_SAMPLES_OF_PART, seed=5)
                points = points[_scene_holds(_scene(part), points)]
                inside = sum(_scene_holds(other, points).astype(float) for other in self._parts)
            total += abs(float(part.volume)) * float(np.mean(1 / np.maximum(inside, 1))) if len(inside) else 0.0
        return total

    def distances(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (N,) unsigned distances of (N, 3) points to the triangles."""
        return _distances(self._whole, points)

    def surface_samples(self) -> NDArray[np.float64]:
        """Return points spread evenly over the surface, without what lies within another part."""
        points, faces = trimesh.sample.sample_surface(self.mesh, _SAMPLES, seed=1)
        step = 1e-4 * float(np.linalg.norm(np.ptp(self.mesh.vertices, axis=0)))
        is_outer = ~self.contains(points + step * self.mesh.face_normals[faces])
        return np.asarray(points[is_outer] if is_outer.any() else points)

    def _by_winding(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        grid = distance_grid(
            np.asarray(self.mesh.vertices, float), self.mesh.faces.astype(np.int32), cells=128, band_cells=1.0
        )
        cells = np.round((points - grid.origin) / grid.step_m).astype(np.int64)
        is_within = ((cells >= 0) & (cells < grid.values.shape)).all(axis=1)
        inside = np.zeros(len(points), bool)
        inside[is_within] = grid.values[tuple(cells[is_within].T)] < 0
        return inside


def is_inside(primitives: Superquadrics, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return (N,) whether (N, 3) points lie in any primitive."""
    inside = np.zeros(len(points), bool)
    for i in range(len(primitives)):
        inside |= log_implicit_value(primitives, i, points) <= 0
    return inside


def grid_points(low: NDArray[np.float64], high: NDArray[np.float64], cells: int) -> NDArray[np.float64]:
    """Return the (N, 3) centres of cubes that fill a box, `cells` along its longest side."""
    step = float((high - low).max()) / cells
    axes = [np.arange(a + step / 2, b + step / 2, step) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def volumetric_iou(solid: Solid, primitives: Superquadrics) -> float:
    """Return the intersection over union of the solids on a grid of 64 cells along the longest side of the mesh."""
    low, high = np.asarray(solid.mesh.bounds)
    room = 0.04 * (high - low).max()
    points = grid_points(low - room, high + room, 69)
    truth, found = solid.contains(points), is_inside(primitives, points)
    return float((truth & found).sum() / max((truth | found).sum(), 1))


def sampled_iou(solid: Solid, primitives: Superquadrics, samples: int = 20_000) -> float:
    """Return the intersection over union of the solids from points in the primitives, however thin these are."""
    # Points are drawn by seed; the mesh is closed.
    rng = np.random.default_rng(4)
    volumes = volumes_m3(primitives)
    counts = np.ceil(samples * volumes / volumes.sum()).astype(int)
    found = both = 0.0
    for i, count in enumerate(counts):
        points = _points_within(primitives, i, int(count), rng)
        shared = sum((log_implicit_value(primitives, k, points) <= 0).astype(float) for k in range(len(primitives)))
        # Of what several primitives hold, each has its share.
        weights = volumes[i] / len(points) / np.maximum(shared, 1)
        found += float(weights.sum())
        both += float(weights[solid.contains(points)].sum())
    return both / (solid.volume_m3() + found - both)


def surface_distance_pct(solid: Solid, primitives: Superquadrics) -> float:
    """Return the mean of both directed mean distances between the outer surfaces, in percent of the diagonal."""
    surfaces, samples = [], []
    diagonal = float(np.linalg.norm(np.ptp(solid.mesh.vertices, axis=0)))
    meshes = [_fine_mesh(primitives, i, diagonal / 50) for i in range(len(primitives))]
    area = sum(mesh.area for mesh in meshes)
    for i, mesh in enumerate(meshes):
        others = np.delete(np.arange(len(meshes)), i)
        buried = _within(primitives, others, mesh.triangles_center)
        surfaces.append(trimesh.Trimesh(mesh.vertices, mesh.faces[~buried], process=False))
        count = max(int(_SAMPLES * mesh.area / area), 20)
        points, _ = trimesh.sample.sample_surface(mesh, count, seed=2)
        samples.append(points[~_within(primitives, others, points)])
    union = _scene(trimesh.util.concatenate(surfaces))
    there = _distances(union, solid.surface_samples()).mean()
    back = solid.distances(np.concatenate(samples)).mean()
    return float(50 * (there + back) / diagonal)


def grown_volume_ratio(solid: Solid, inflated: Superquadrics, margin_m: float, cells: int = 96) -> float:
    """Return the volume of the union of inflated primitives over the volume of the solid grown by the margin."""
    # Both are counted in `cells` along the longest side.
    low, high = np.asarray(solid.mesh.bounds)
    points = grid_points(low - 2 * margin_m, high + 2 * margin_m, cells)
    grown = solid.contains(points)
    # Exact distances are dear, and needed only where the nearest sample of the surface leaves a doubt.
    samples, _ = trimesh.sample.sample_surface(solid.mesh, _SAMPLES, seed=3)
    gap = 4 * float(np.sqrt(solid.mesh.area / _SAMPLES))
    rough, _ = cKDTree(samples).query(points[~grown], distance_upper_bound=margin_m + gap)
    open_cells = np.flatnonzero(~grown)
    grown[open_cells[rough <= margin_m]] = True
    unsure = open_cells[(rough > margin_m) & np.isfinite(rough)]
    grown[unsure] = solid.distances(points[unsure]) <= margin_m
    return float(is_inside(inflated, points).sum() / max(grown.sum(), 1))


def _points_within(primitives: Superquadrics, index: int, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    pose, found = primitives.world_from_local[index], np.empty((0, 3))
    while len(found) < count:
        local = rng.uniform(-1, 1, (2 * count, 3)) * primitives.semi_axes_m[index]
        points = local @ pose[:3, :3].T + pose[:3, 3]
        found = np.concatenate([found, points[log_implicit_value(primitives, index, points) <= 0]])
    return found[:count]


def _fine_mesh(primitives: Superquadrics, index: int, edge_m: float) -> trimesh.Trimesh:
    vertices, faces = display_mesh(primitives, index, 2e-4 * float(primitives.semi_axes_m[index].max()))
    return trimesh.Trimesh(*trimesh.remesh.subdivide_to_size(vertices, faces, edge_m, max_iter=30), process=False)


def _within(primitives: Superquadrics, indices: NDArray[np.int64], points: NDArray[np.float64]) -> NDArray[np.bool_]:
    inside = np.zeros(len(points), bool)
    for i in indices:
        inside |= log_implicit_value(primitives, int(i), points) < 0
    return inside


def _scene(mesh: trimesh.Trimesh) -> Any:
    scene = import_open3d().t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(np.asarray(mesh.vertices, dtype=np.float32), np.asarray(mesh.faces, dtype=np.uint32))
    return scene


def _scene_holds(part: Any, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    query = import_open3d().core.Tensor(np.ascontiguousarray(points, dtype=np.float32))
    return np.asarray(part.compute_occupancy(query, nsamples=3).numpy() > 0.5)


def _distances(scene: Any, points: NDArray[np.float64]) -> NDArray[np.float64]:
    query = import_open3d().core.Tensor(np.ascontiguousarray(points, dtype=np.float32))
    return np.asarray(scene.compute_distance(query).numpy(), dtype=np.float64)
