"""The small scene of the players' tests as arrays, for robots that have nothing of this project."""

import numpy as np
from hickory_stream.geometry.rigid import quaternion_from_rotation
from tests.player_scenes import CAMERA, START_NS, make_scene


def scene_file(path):
    """Write the scene."""
    scene = make_scene(num_frames=6)
    rgb, depth_mm, poses = (np.stack([getattr(f, n) for f in scene]) for n in ("rgb", "depth_mm", "world_from_camera"))
    np.savez(
        path, rgb=rgb, depth_mm=depth_mm, positions=poses[:, :3, 3], start_ns=START_NS,
        quaternions=np.stack([quaternion_from_rotation(pose[:3, :3]) for pose in poses]),
        pinhole=np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy]),
    )  # fmt: skip
    return path
