"""A furnished room as a camera with noise sees it, and odometry of it that drifts: what tests of registration share."""

from functools import cache
from itertools import pairwise
import numpy as np
from hickory_stream.box_scene import SceneBox, cast_scene
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import compose, from_rotation_translation, invert, yaw_rotation
from hickory_stream.poses.surface_image import surface_image
from tests.perception.perception_scenes import looking

CAMERA = Camera(width=160, height=120, fx=87.0, fy=87.0, cx=79.5, cy=59.5)
SPREAD_PER_M = 0.0012
NUM_KEYFRAMES = 40
_GREY = (128, 128, 128)
ROOM = (
    SceneBox(low=(-3.1, -2.6, 0.0), high=(-3.0, 2.6, 2.5), rgb=_GREY),
    SceneBox(low=(3.0, -2.6, 0.0), high=(3.1, 2.6, 2.5), rgb=_GREY),
    SceneBox(low=(-3.1, -2.6, 0.0), high=(3.1, -2.5, 2.5), rgb=_GREY),
    SceneBox(low=(-3.1, 2.5, 0.0), high=(3.1, 2.6, 2.5), rgb=_GREY),
    SceneBox(low=(-0.6, -0.4, 0.0), high=(0.5, 0.4, 0.75), rgb=_GREY),
    SceneBox(low=(1.9, -2.5, 0.0), high=(2.7, -1.9, 1.6), rgb=_GREY),
    SceneBox(low=(-2.9, 0.7, 0.0), high=(-2.2, 1.9, 0.5), rgb=_GREY),
    SceneBox(low=(0.4, 1.8, 0.0), high=(1.6, 2.4, 0.9), rgb=_GREY),
)
EMPTY_WALL = (SceneBox(low=(-30.0, 2.5, -30.0), high=(30.0, 2.6, 30.0), rgb=_GREY),)


def true_pose(index):
    """Return world_from_camera (4, 4) of a keyframe on a circle through the room, looking across it and a bit down."""
    angle = 2 * np.pi * index / 32
    forward = np.array([np.cos(angle + 2.6), np.sin(angle + 2.6), -0.3])
    eye = np.array([1.2 * np.cos(angle), 1.2 * np.sin(angle), 1.5])
    return looking(eye + forward, start=eye)


def wall_pose(index):
    """Return world_from_camera (4, 4) of a keyframe on a way along a wall that fills the view."""
    return looking((0.15 * index, 1.0, 1.3), start=(0.15 * index, 0.0, 1.3))


def drifted(poses, scale=0.02, yaw_deg=0.1):
    """Return poses as odometry has them that errs by a share of the way and by so much of yaw for each step."""
    out = [poses[0]]
    for before, now in pairwise(poses):
        step = compose(invert(before), now)
        step[:3, 3] *= 1 + scale
        pose = compose(out[-1], step)
        out.append(from_rotation_translation(yaw_rotation(np.radians(yaw_deg)) @ pose[:3, :3], pose[:3, 3]))
    return out


@cache
def image(index, boxes=ROOM, seed=0, *, along_wall=False):
    """Return what a keyframe shows, with the noise of a stereo camera."""
    pose = wall_pose(index) if along_wall else true_pose(index)
    _, depth_m, _ = cast_scene(boxes, CAMERA, pose)
    rng = np.random.default_rng([seed, index])
    with np.errstate(invalid="ignore"):
        noisy = 1.0 / (1.0 / depth_m + SPREAD_PER_M * rng.standard_normal(depth_m.shape))
    depth_mm = np.nan_to_num(1e3 * noisy, nan=0.0, posinf=0.0).clip(0, 60000).astype(np.uint16)
    return surface_image(depth_mm, CAMERA, spread_per_m=SPREAD_PER_M, max_sigma_m=0.1)


def errors_m(poses, first=0):
    """Return how far keyframes are from where they truly were."""
    return np.array([np.linalg.norm(pose[:3, 3] - true_pose(first + i)[:3, 3]) for i, pose in enumerate(poses)])
