"""Small maps for alignment: boxes with clouds on a floor that was seen, as `play` would have saved them."""

import numpy as np
from hickory_stream.geometry.boxes import OrientedBox, gravity_aligned_box
from hickory_stream.geometry.rigid import apply, from_rotation_translation, yaw_rotation
from hickory_stream.geometry.voxels import keys_of_points
from hickory_stream.records import MapSnapshot, ObservedSpace, Phase, Submap, TrackedObject

VOXEL_M = 0.1


def furniture(count, seed):
    """Return (place, half extents, feature) of boxes that stand apart, all different."""
    rng = np.random.default_rng(seed)
    cells = rng.permutation(36)[:count]
    items = []
    for cell in cells:
        half = rng.uniform(0.1, 0.35, 3)
        place = np.array([cell % 6, cell // 6, 0.0]) * 1.2 + rng.uniform(-0.15, 0.15, 3) * (1, 1, 0)
        feature = rng.normal(size=24).astype(np.float32)
        items.append((place + np.array([0, 0, half[2]]), half, feature / np.linalg.norm(feature)))
    return items


def cloud(place, half, rng):
    """Return 1200 points of the surface of a box, with 2 mm of noise."""
    points = rng.uniform(-1, 1, (1200, 3))
    axis = rng.integers(0, 3, 1200)
    points[np.arange(1200), axis] = np.sign(points[np.arange(1200), axis])
    return (points * half + place + rng.normal(0, 0.002, (1200, 3))).astype(np.float32)


def snapshot_of(items, map_from_world, seed=0):
    """Return the map of boxes in a frame of its own; everything up to 2 m above the floor was seen, and is free."""
    rng = np.random.default_rng(seed)
    objects, solid = [], []
    for i, (place, half, feature) in enumerate(items):
        points = cloud(place, half, rng)
        solid.append(points)
        moved = apply(map_from_world, points)
        objects.append(
            TrackedObject(
                id=i + 1, phase=Phase.ACTIVE, submap_id=0, sightings=5, first_seen_ns=1000 + i, last_seen_ns=9000 + i,
                points_world=moved, colors=np.full((len(moved), 3), 128, dtype=np.uint8),
                box=gravity_aligned_box(moved, 0.005), feature=feature, views=(), best_view=None, shape=None,
            )
        )  # fmt: skip
    # Closer than the voxels, so that none is left out whichever way they are turned.
    steps = np.arange(-0.6, 7.2, 0.6 * VOXEL_M), np.arange(-0.6, 7.2, 0.6 * VOXEL_M), np.arange(0, 0.9, 0.6 * VOXEL_M)
    room = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3)
    free = np.unique(keys_of_points(apply(map_from_world, room), VOXEL_M))
    taken = keys_of_points(apply(map_from_world, np.concatenate(solid)) if solid else np.empty((0, 3)), VOXEL_M)
    space = ObservedSpace(
        voxel_m=VOXEL_M, free=np.setdiff1d(free, taken), structure=np.empty(0, dtype=np.int64), floor_z_m=None
    )
    return MapSnapshot(
        revision=1, stamp_ns=9999, submaps=(Submap(id=0, world_from_submap=np.eye(4), observed_space=space),),
        objects=tuple(objects),
    )  # fmt: skip


def frame(yaw_deg, x, y, z=0.0):
    return from_rotation_translation(yaw_rotation(np.radians(yaw_deg)), np.array([x, y, z]))


def box_at(place, half_m=0.1):
    return OrientedBox(world_from_box=from_rotation_translation(np.eye(3), place), half_extents_m=np.full(3, half_m))
