"""Variants of an object map: in another frame, bent by drift, mirrored."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.object_map import ObjectMap
from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.geometry.rigid import apply, from_rotation_translation, yaw_rotation
from hickory_stream.geometry.superquadric import Superquadrics, log_implicit_value, moved
from hickory_stream.geometry.superquadric_surface import surface_points

_REACH_M = 5.0


def random_frame(rng: np.random.Generator, reach_m: float = _REACH_M) -> NDArray[np.float64]:
    """Return `new_from_old` (4, 4) with a random yaw and a translation of up to `reach_m` along each axis."""
    return from_rotation_translation(yaw_rotation(rng.uniform(0, 2 * np.pi)), rng.uniform(-reach_m, reach_m, 3))


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


def with_points(objects: ObjectMap, count: int = 150) -> ObjectMap:
    """Return the map with about `count` points on the surface of each shape, for methods that need point clouds."""
    points = tuple(None if shape is None else _cloud(shape, count) for shape in objects.shapes)
    return replace(objects, points=points)


def _cloud(shape: Superquadrics, count: int) -> NDArray[np.float32]:
    shares = shape.semi_axes_m.prod(axis=1) ** (2 / 3)
    counts = np.maximum(np.round(count * shares / shares.sum()), 8).astype(np.int64)
    kept = []
    for i in range(len(shape)):
        own = surface_points(shape, i, int(counts[i]))
        buried = [log_implicit_value(shape, j, own) < 0 for j in range(len(shape)) if j != i]
        kept.append(own[~np.any(buried, axis=0)] if buried else own)
    return np.concatenate(kept).astype(np.float32)


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
