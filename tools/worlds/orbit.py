"""A camera that circles a table and looks at what is on it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.worlds.trajectory import STEP_S, Trajectory, camera_rotation

if TYPE_CHECKING:
    from hickory_stream.worlds.scene import World

_SECONDS = 60.0
_TURNS_A_MINUTE = 1.35


def orbit(world: World, seconds: float | None, walk_index: int, rng: np.random.Generator) -> Trajectory:
    """Return a slow orbit of the middle of the world, 0.8 to 1.1 m away and 0.4 to 0.75 m above the table's top.

    `seconds` None is a minute; odd walks go the other way round.
    """
    lasts = _SECONDS if seconds is None else seconds
    times_s = np.arange(0.0, lasts + 2 * STEP_S, STEP_S)
    top = max(s.center_m[2] for item in world.objects if item.model.kind == "table" for s in item.model.surfaces)
    sense = 1.0 if walk_index % 2 == 0 else -1.0
    phase = rng.uniform(0, 2 * np.pi, size=6)
    turn = 2 * np.pi * times_s / 60.0
    angle = phase[0] + sense * _TURNS_A_MINUTE * turn
    radius = 0.95 + 0.13 * np.sin(2.3 * turn + phase[1])
    height = top + 0.57 + 0.16 * np.sin(3.1 * turn + phase[2])
    eyes = np.stack(
        [world.middle_m[0] + radius * np.cos(angle), world.middle_m[1] + radius * np.sin(angle), height], axis=1
    )
    # The gaze moves over the objects instead of staying on the centre.
    target = np.stack([0.12 * np.sin(5.0 * turn + phase[3]), 0.12 * np.sin(4.1 * turn + phase[4])], axis=1)
    look = np.column_stack([target + world.middle_m, np.full(len(times_s), top + 0.06)]) - eyes
    yaw = np.arctan2(look[:, 1], look[:, 0])
    pitch = np.arctan2(look[:, 2], np.linalg.norm(look[:, :2], axis=1))
    roll = np.radians(1.0) * np.sin(7.0 * turn + phase[5])
    poses = [
        from_rotation_translation(camera_rotation(float(a), float(b), float(c)), eye)
        for a, b, c, eye in zip(yaw, pitch, roll, eyes, strict=True)
    ]
    return Trajectory(times_s=times_s, world_from_camera=np.stack(poses))
