"""Variants of an object map: in another frame, bent by drift, mirrored."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.object_map import ObjectMap
from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.geometry.rigid import apply, from_rotation_translation, yaw_rotation
from hickory_stream.geometry.superquadric import moved

_REACH_M = 5.0


def random_frame(rng: np.random.Generator) -> NDArray[np.float64]:
    """Return `new_from_old` (4, 4) with a random yaw and a translation of up to 5 m along each axis."""
    return from_rotation_translation(yaw_rotation(rng.uniform(0, 2 * np.pi)), rng.uniform(-_REACH_M, _REACH_M, 3))


def moved_map(objects: ObjectMap, new_from_old: NDArray[np.float64]) -> ObjectMap:
    return _placed(objects, np.broadcast_to(new_from_old, (len(objects), 4, 4)), new_from_old)


def bent_map(objects: ObjectMap, yaw_deg_per_m: float) -> ObjectMap:
    """Return the map as made with odometry whose heading drifts along x; every object stays rigid."""
    # An object x metres from the map's first end is rotated by x times `yaw_deg_per_m` about the vertical.
    start = objects.centroids[:, 0].min() if len(objects) else 0.0
    poses = np.empty((len(objects), 4, 4))
    rate = np.radians(yaw_deg_per_m)
    for pose, place in zip(poses, objects.centroids, strict=True):
        x = place[0] - start
        # The path becomes an arc, with a lateral displacement of rate x^2 / 2.
        turn = yaw_rotation(rate * x)
        shift = np.array([0.0, rate * x**2 / 2, 0.0])
        pose[:] = from_rotation_translation(turn, place - turn @ place + shift)
    return _placed(objects, poses, np.eye(4))


def mirrored_map(objects: ObjectMap) -> ObjectMap:
    """Return the map with every object, itself unchanged, at its mirrored position (x to -x)."""
    poses = np.broadcast_to(np.eye(4), (len(objects), 4, 4)).copy()
    poses[:, 0, 3] = -2 * objects.centroids[:, 0]
    return replace(_placed(objects, poses, np.eye(4)), submaps=())


def _placed(
    objects: ObjectMap, new_from_old: NDArray[np.float64], submaps_new_from_old: NDArray[np.float64]
) -> ObjectMap:
    return replace(
        objects,
        centroids=np.array(
            [apply(pose, place) for pose, place in zip(new_from_old, objects.centroids, strict=True)]
        ).reshape(-1, 3),
        shapes=tuple(
            None if shape is None else moved(shape, pose)
            for shape, pose in zip(objects.shapes, new_from_old, strict=True)
        ),
        boxes=tuple(
            OrientedBox(world_from_box=pose @ box.world_from_box, half_extents_m=box.half_extents_m)
            for box, pose in zip(objects.boxes, new_from_old, strict=True)
        ),
        points=tuple(
            None if points is None else apply(pose, points)
            for points, pose in zip(objects.points, new_from_old, strict=True)
        ),
        submaps=tuple(
            replace(submap, world_from_submap=submaps_new_from_old @ submap.world_from_submap)
            for submap in objects.submaps
        ),
    )
