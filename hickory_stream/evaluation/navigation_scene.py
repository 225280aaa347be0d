"""Scenes to plan in: from a truth folder, and from a saved map as boxes, meshes or layer 4."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.evaluation.evaluate import placed_mesh, true_mesh_world
from hickory_stream.evaluation.match import meshes_of
from hickory_stream.evaluation.navigation_methods import Obstacles, triangles
from hickory_stream.evaluation.navigation_table import MethodScore, TrueScene, table_of, true_scene
from hickory_stream.evaluation.truth import structure_meshes
from hickory_stream.navigation.free_space import layer_four_of, obstacles_of
from hickory_stream.navigation.observed import Band, seen_columns, unknown_hulls
from hickory_stream.navigation.occupancy import frame_around
from hickory_stream.storeys import floor_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from hickory_stream.evaluation.truth import Truth
    from hickory_stream.geometry.mesh import Mesh
    from hickory_stream.geometry.superquadric import Superquadrics
    from hickory_stream.map_folder.saved_map import SavedMap
    from hickory_stream.navigation.free_space import UnknownSpace
    from hickory_stream.navigation.robot import Robot

R_SAFE_M = 0.02


def first_posture(robot: Robot) -> Robot:
    """Return a robot restricted to the first of its postures."""
    return replace(robot, postures=robot.postures[:1])


def truth_of(truth: Truth, robot: Robot, *, cell_m: float, floor_z_m: float, r_safe_m: float = R_SAFE_M) -> TrueScene:
    """Return the true scene on a grid that spans its structure, or its objects if it has no structure."""
    structure = [triangles(mesh) for mesh in structure_meshes(truth)]
    objects = {item.id: triangles(true_mesh_world(truth, item)) for item in truth.objects}
    corners = np.concatenate([hulls.reshape(-1, 3) for hulls in (structure or list(objects.values()))])
    frame = frame_around(corners.min(axis=0), corners.max(axis=0), cell_m)
    return true_scene(objects, structure, robot, frame, floor_z_m=floor_z_m, r_safe_m=r_safe_m)


def true_obstacles(truth: Truth, inflated: Mapping[int, Superquadrics]) -> Obstacles:
    """Return the true objects as obstacles, with a layer 4 made of their true meshes; walls are the true ones."""
    walls = [np.empty((0, 3, 3)), *(triangles(mesh) for mesh in structure_meshes(truth))]
    return Obstacles(
        load=lambda: {item.id: true_mesh_world(truth, item) for item in truth.objects},
        inflated=inflated,
        walls=np.concatenate(walls),
        unknown=np.empty((0, 8, 3)),
    )


def score_saved_map(
    saved: SavedMap,
    truth: Truth,
    robot: Robot,
    *,
    cell_m: float,
    unknown: UnknownSpace,
    trials: int,
    seeds: Sequence[int],
) -> list[MethodScore]:
    """Return the table of a map that the pipeline made; all methods are given its observed walls and unknown space.

    The map must be in the frame of the truth, as it is if its log was played with true poses.
    """
    robot = first_posture(robot)
    snapshot = saved.snapshot
    floor = floor_of(snapshot)
    margins = [tracked.shape.containment.margin_m for tracked in snapshot.objects if tracked.shape is not None]
    r_safe = float(np.median(margins)) if margins else R_SAFE_M
    scene = truth_of(truth, robot, cell_m=cell_m, floor_z_m=floor, r_safe_m=r_safe)
    frame = scene.space.frame
    parts = [part for headings in scene.space.parts for parts in headings for part in parts]
    band = Band(
        low_m=min(part.low_m - part.ball_m for part in parts), high_m=max(part.high_m + part.ball_m for part in parts)
    )
    seen = seen_columns(snapshot.submaps, frame, band, floor)
    obstacles = Obstacles(
        load=lambda: _placed_meshes(saved),
        inflated={tracked.id: layer_four_of(tracked) for tracked in obstacles_of(snapshot)},
        walls=seen.walls,
        unknown=unknown_hulls(seen.is_known, frame, band) if unknown == "blocked" else np.empty((0, 8, 3)),
    )
    return table_of(obstacles, scene, robot, r_safe_m=r_safe, trials=trials, seeds=seeds)


def _placed_meshes(saved: SavedMap) -> dict[int, Mesh]:
    meshes = meshes_of(saved)
    placed = ((tracked.id, placed_mesh(tracked, meshes)) for tracked in obstacles_of(saved.snapshot))
    return {object_id: mesh for object_id, mesh in placed if mesh is not None}
