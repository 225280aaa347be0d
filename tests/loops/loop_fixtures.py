"""Rooms as surfaces: points on floor, walls and boxes with the normals that a camera inside sees."""

import numpy as np
from hickory_stream.geometry.rigid import apply, from_rotation_translation, invert, yaw_rotation
from hickory_stream.geometry.voxels import keys_of_points, sorted_unique
from hickory_stream.loops.surfaces import Surface
from tools.evaluation.simulated_maps.loop_rooms import STEP_M, bare_room, box

VOXEL_M = 0.05
BOXES = ((0.5, 0.6, 0.6, 0.7), (2.6, 1.7, 0.9, 0.4))
"""The low corner of each, its side and its height."""
ANCHOR = from_rotation_translation(yaw_rotation(0.4), np.array([2.0, 1.5, 1.2]))


def room():
    """A floor of 4 m by 3 m and four walls of 2 m, seen from inside, with two boxes."""
    return [*bare_room(0.0), *(side for each in BOXES for side in box(*each))]


def air(boxes=BOXES, low=(0, 0, 0), high=(4, 3, 2)):
    """The voxels inside a room, but for its boxes."""
    axes = [np.arange(a + VOXEL_M, b - VOXEL_M, VOXEL_M) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    for x, y, side, height in boxes:
        inside = (points >= [x, y, 0]).all(axis=1) & (points <= [x + side, y + side, height]).all(axis=1)
        points = points[~inside]
    return sorted_unique(keys_of_points(points, VOXEL_M))


def surface(patches, *, own_from_world=None, free=None, noise_m=0.005, seed=0):
    """A surface with noise, in a frame of its own."""
    move = np.eye(4) if own_from_world is None else own_from_world
    rng = np.random.default_rng(seed)
    points, normals = (np.concatenate(parts) for parts in zip(*patches, strict=True))
    points = points + rng.normal(0, noise_m, points.shape) + rng.uniform(0, 0.3 * STEP_M, 3)
    return Surface(
        points=apply(move, points), normals=normals @ move[:3, :3].T,
        free=np.empty(0, np.int64) if free is None else free, voxel_m=VOXEL_M, anchor=move @ ANCHOR,
    )  # fmt: skip


def shift(x, y, z=0.0, yaw_deg=0.0):
    return from_rotation_translation(yaw_rotation(np.radians(yaw_deg)), np.array([x, y, z]))


def off(found, own_from_world):
    """How far a found earlier_from_later is from the true one, at the anchor: metres, degrees."""
    step = invert(invert(own_from_world) @ own_from_world @ ANCHOR) @ (found @ own_from_world @ ANCHOR)
    return float(np.linalg.norm(step[:3, 3])), float(
        np.degrees(np.arccos(np.clip((np.trace(step[:3, :3]) - 1) / 2, -1, 1)))
    )
