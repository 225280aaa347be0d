"""Frames of a ZED camera as the ROS 2 messages of its wrapper."""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.camera import Camera
from players.logs.containers import Topic
from players.messages.records import CAMERA_INFO, IMAGE, ODOMETRY
from players.messages.ros_messages import RosMessages
from players.profile import OPTICAL_FROM_FLU

COLOR, DEPTH = "/zed/zed_node/left/color/rect/image", "/zed/zed_node/depth/depth_registered"
COLOR_INFO, DEPTH_INFO = "/zed/zed_node/left/color/rect/camera_info", "/zed/zed_node/depth/camera_info"
ODOM = "/zed/zed_node/odom"
_OPTICAL, _WORLD = "zed_left_optical", "odom"

TOPICS = tuple(
    Topic(name=name, type_name=type_name)
    for name, type_name in (
        (COLOR, IMAGE),
        (DEPTH, IMAGE),
        (COLOR_INFO, CAMERA_INFO),
        (DEPTH_INFO, CAMERA_INFO),
        (ODOM, ODOMETRY),
    )
)


def world_from_camera(image_world_from_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (4, 4), z up and x ahead at the start, of a pose in the SDK's IMAGE axes (x right, y down, z ahead)."""
    turned = np.eye(4)
    turned[:3, :3] = OPTICAL_FROM_FLU.T
    return np.asarray(turned @ image_world_from_camera)


def color_message(stamp_ns: int, bgra: NDArray[np.uint8]) -> bytes:
    """Return (H, W, 4) uint8 as an image of `bgra8`."""
    return _image(stamp_ns, bgra, "bgra8")


def depth_message(stamp_ns: int, depth_m: NDArray[np.float32]) -> bytes:
    """Return (H, W) float32 metres as an image of `32FC1`; values that are not finite are no return."""
    return _image(stamp_ns, depth_m, "32FC1")


def info_message(stamp_ns: int, camera: Camera) -> bytes:
    """Return the calibration of rectified images."""
    return _messages().data(_messages().camera_info(stamp_ns, _OPTICAL, camera, "plumb_bob", 5))


def pose_message(stamp_ns: int, pose: NDArray[np.float64]) -> bytes:
    """Return world_from_camera (4, 4), z up, as odometry of the left camera."""
    return _messages().data(_messages().odometry(stamp_ns, _WORLD, _OPTICAL, pose))


def _image(stamp_ns: int, pixels: NDArray[Any], encoding: str) -> bytes:
    return _messages().data(_messages().image(stamp_ns, _OPTICAL, encoding, pixels))


@cache
def _messages() -> RosMessages:
    return RosMessages()
