"""The small scene of the players' tests as arrays, for robots that have nothing of this project."""

from __future__ import annotations

from typing import TYPE_CHECKING
import numpy as np
from hickory_stream.geometry.rigid import quaternion_from_rotation
from tests.player_scenes import CAMERA, START_NS, make_scene

if TYPE_CHECKING:
    pass


def scene_file(path):
    """Write the scene."""
    scene = make_scene(num_frames=6)
    np.savez(
        path,
        rgb=np.stack([item.rgb for item in scene]),
        depth_mm=np.stack([item.depth_mm for item in scene]),
        positions=np.stack([item.world_from_camera[:3, 3] for item in scene]),
        quaternions=np.stack([quaternion_from_rotation(item.world_from_camera[:3, :3]) for item in scene]),
        pinhole=np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy]),
        start_ns=START_NS,
    )
    return path
