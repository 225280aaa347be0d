"""Occupancy of one scene by three obstacle models, boxes, meshes and layer 4, and the time to build each."""
# Mesh-OBB is the convex hull of each object's gravity-aligned box, Mesh-Full all triangles of all meshes, none left
# out. Both keep the margin that layer 4 has built in. All are rasterised by the same kernel, exactly over the height
# band and in whole cells, so that the methods differ in the shapes only. All are given the same walls, which belong to
# no object.

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.superquadric import Superquadrics
from hickory_stream.navigation.free_space import FreeSpace
from hickory_stream.navigation.occupancy import GridFrame
from hickory_stream.navigation.robot import Robot

MethodName = Literal["mesh-obb", "mesh-full", "layer-4"]
METHOD_NAMES: tuple[MethodName, ...] = ("mesh-obb", "mesh-full", "layer-4")
_MIN_HALF_EXTENT_M = 0.001


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Obstacles:
    """The obstacles of a scene: `meshes` in the world and `inflated`, both by object; walls, and unobserved space."""

    # `load` reads the meshes and is part of the measured time, since a map has them on disk.
    load: Callable[[], Mapping[int, Mesh]]
    inflated: Mapping[int, Superquadrics]
    walls: NDArray[np.float64]
    unknown: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Built:
    """The free space of one method; CPU seconds for reading meshes and for stamping what stands in it."""

    name: MethodName
    space: FreeSpace
    load_s: float
    build_s: float


def built(
    name: MethodName, obstacles: Obstacles, robot: Robot, frame: GridFrame, *, floor_z_m: float, r_safe_m: float
) -> Built:
    """Return the free space according to one method; `r_safe_m` is the margin that layer 4 was inflated by."""
    started = time.process_time()
    meshes = {} if name == "layer-4" else obstacles.load()
    loaded = time.process_time()
    # Hulls, and walls too, get the safety margin here; layer 4 has it built in.
    space = FreeSpace(robot, frame, floor_z_m, hull_margin_m=r_safe_m)
    if name == "layer-4":
        for object_id, inflated in obstacles.inflated.items():
            space.put(object_id, inflated)
    for object_id, mesh in meshes.items():
        if name == "mesh-full":
            space.put_hulls(object_id, triangles(mesh))
        else:
            box = gravity_aligned_box(mesh.vertices, _MIN_HALF_EXTENT_M)
            space.put_hulls(object_id, box.corners_world()[None])
    ended = time.process_time()
    space.observe(obstacles.walls, obstacles.unknown)
    return Built(name=name, space=space, load_s=loaded - started, build_s=ended - loaded)


def triangles(mesh: Mesh) -> NDArray[np.float64]:
    """Return the (F, 3, 3) corners of a mesh's faces."""
    return np.asarray(mesh.vertices.astype(np.float64)[mesh.faces])
