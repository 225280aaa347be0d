"""Overlap of mapped objects with true surfaces: which true object each lies on, and how much of it they cover."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from hickory_stream.evaluation.match import STRUCTURE, SURFACE_REACH_M, shares_on, structure_surfaces
from hickory_stream.evaluation.truth import Truth, mesh_of, moved_mesh
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.mesh import sample_surface
from hickory_stream.pictures.raycast import Scene, surface_of_mesh
from hickory_stream.records import MapSnapshot, Phase, TrackedObject

_MAX_POINTS = 3000
_SAMPLES = 600
_LEAST_SEEN = 1e-3
_MIN_HALF_EXTENT_M = 0.005


@dataclass(frozen=True, kw_only=True, slots=True)
class LiesOn:
    """Shares of an object's points by the surface they lie on: that of each true object, structure, or none known."""

    things: dict[int, float]
    structure: float
    nothing: float

    def largest(self) -> tuple[int, float] | None:
        """Return the true object that most points lie on, and their share; None if they lie on no true object."""
        if not self.things:
            return None
        truth_id = min(self.things, key=lambda i: (-self.things[i], i))
        return truth_id, self.things[truth_id]


class Overlap:
    """Overlap of confirmed mapped objects with true objects: `lies_on` by object, `true_boxes` by true object.

    Raises `RecordingError` for a mesh of the truth, `InputError` without Open3D.
    """

    def __init__(self, snapshot: MapSnapshot, truth: Truth) -> None:
        self._objects = [tracked for tracked in snapshot.objects if tracked.phase is not Phase.TENTATIVE]
        self._meshes = {item.id: moved_mesh(mesh_of(truth, item), item.world_from_object) for item in truth.objects}
        self._seen = {item.id: max(item.seen_fraction, _LEAST_SEEN) for item in truth.objects}
        surfaces = [surface_of_mesh(mesh, truth_id) for truth_id, mesh in self._meshes.items()]
        self._scene = Scene([*surfaces, *structure_surfaces(truth)])
        self._covered: dict[int, dict[int, float]] = {}
        self.lies_on = {tracked.id: _lies_on(tracked, self._scene) for tracked in self._objects}
        self.true_boxes = {i: gravity_aligned_box(m.vertices, _MIN_HALF_EXTENT_M) for i, m in self._meshes.items()}

    def covered(self, truth_id: int) -> dict[int, float]:
        """Return the share of a true object's visible surface that each mapped object covers, if any.

        Covered: within 3 cm of points of the mapped object that are nearest to this true surface.
        """
        known = self._covered.get(truth_id)
        if known is None:
            known = self._covered[truth_id] = self._cover(truth_id)
        return known

    def _cover(self, truth_id: int) -> dict[int, float]:
        samples, _ = sample_surface(self._meshes[truth_id], _SAMPLES, np.random.default_rng(truth_id))
        low, high = samples.min(axis=0) - SURFACE_REACH_M, samples.max(axis=0) + SURFACE_REACH_M
        found = {}
        for tracked in self._objects:
            points = tracked.points_world[((tracked.points_world >= low) & (tracked.points_world <= high)).all(axis=1)]
            points = points[:: max(1, len(points) // _MAX_POINTS)]
            if len(points):
                distance_m, owners = self._scene.nearest(points)
                points = points[(owners == truth_id) & (distance_m <= SURFACE_REACH_M)]
            if len(points):
                distance_m, _ = cKDTree(points).query(samples, distance_upper_bound=SURFACE_REACH_M)
                found[tracked.id] = min(1.0, float(np.isfinite(distance_m).mean()) / self._seen[truth_id])
        return found


def _lies_on(tracked: TrackedObject, scene: Scene) -> LiesOn:
    shares = shares_on(tracked, scene)
    structure = shares.pop(STRUCTURE, 0.0)
    return LiesOn(things=shares, structure=structure, nothing=max(0.0, 1.0 - structure - sum(shares.values())))
