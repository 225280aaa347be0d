"""How much of each object's surface a log shows, by samples that agree with a frame's exact depth and instance."""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.evaluation.exposed import exposed_samples
from hickory_stream.geometry.camera import Camera, project
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.worlds.object_models import model_mesh
from hickory_stream.worlds.scene import World

_SAMPLES = 1500
_AGREEMENT_M = 0.02


class SeenSurface:
    """Collects which surface samples of which object have been seen, frame by frame."""

    def __init__(self, world: World, min_depth_m: float, max_depth_m: float, rng: np.random.Generator) -> None:
        self._range_m = (min_depth_m, max_depth_m)
        points, normals = [np.empty((0, 3))], [np.empty((0, 3))]
        ids = [np.empty(0, np.int64)]
        for item in world.objects:
            samples, outward = exposed_samples(model_mesh(item.model), _SAMPLES, rng)
            points.append(apply(item.world_from_object, samples.astype(np.float64)))
            normals.append(outward @ item.world_from_object[:3, :3].T)
            ids.append(np.full(len(samples), item.id))
        self._points, self._normals, self._ids = np.concatenate(points), np.concatenate(normals), np.concatenate(ids)
        self._is_seen = np.zeros(len(self._ids), dtype=bool)

    def add(
        self,
        depth_m: NDArray[np.float32],
        instances: NDArray[np.uint16],
        camera: Camera,
        world_from_camera: NDArray[np.float64],
    ) -> None:
        """Mark the samples that a frame (H, W) of exact depth and instances shows."""
        # Of a building, most objects do not show in a frame.
        index = np.flatnonzero(np.isin(self._ids, np.unique(instances)) & ~self._is_seen)
        points = self._points[index]
        points_camera = apply(invert(world_from_camera), points)
        z = points_camera[:, 2]
        toward = world_from_camera[:3, 3] - points
        candidate = (z > self._range_m[0]) & (z < self._range_m[1])
        candidate &= np.einsum("ij,ij->i", toward, self._normals[index]) > 0
        index, points_camera = index[candidate], points_camera[candidate]
        uv = np.round(project(points_camera, camera)).astype(np.int64)
        inside = (uv >= 0).all(axis=1) & (uv < (camera.width, camera.height)).all(axis=1)
        index, (x, y) = index[inside], uv[inside].T
        agrees = np.abs(depth_m[y, x] - points_camera[inside, 2]) < _AGREEMENT_M
        self._is_seen[index[agrees & (instances[y, x] == self._ids[index])]] = True

    def include(self, other: "SeenSurface") -> None:
        """Mark what another log of the same world shows; both must have drawn their samples alike."""
        if not np.array_equal(self._points, other._points):
            raise ValueError("the samples of two worlds cannot be compared")
        self._is_seen |= other._is_seen

    def fraction(self, object_id: int) -> float:
        """Return the share of the object's samples seen so far."""
        return float(self._is_seen[self._ids == object_id].mean())
