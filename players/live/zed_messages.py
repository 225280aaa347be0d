"""Frames of a ZED camera as the ROS 2 messages of its wrapper."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import quaternion_from_rotation
from players.logs.containers import Topic
from players.messages.records import CAMERA_INFO, IMAGE, ODOMETRY
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
    k = np.array([camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1], dtype=np.float64)
    p = np.insert(k.reshape(3, 3), 3, 0.0, axis=1).ravel()
    region = _new("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    message = _new(
        CAMERA_INFO,
        header=_header(stamp_ns, _OPTICAL),
        height=camera.height,
        width=camera.width,
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=k,
        r=np.eye(3).ravel(),
        p=p,
        binning_x=0,
        binning_y=0,
        roi=region,
    )
    return _encoded(CAMERA_INFO, message)


def pose_message(stamp_ns: int, pose: NDArray[np.float64]) -> bytes:
    """Return world_from_camera (4, 4), z up, as odometry of the left camera."""
    x, y, z = pose[:3, 3].tolist()
    qx, qy, qz, qw = quaternion_from_rotation(pose[:3, :3]).tolist()
    placed = _new(
        "geometry_msgs/msg/Pose",
        position=_new("geometry_msgs/msg/Point", x=x, y=y, z=z),
        orientation=_new("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
    )
    zero = _new("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    still = _new("geometry_msgs/msg/Twist", linear=zero, angular=zero)
    message = _new(
        ODOMETRY,
        header=_header(stamp_ns, _WORLD),
        child_frame_id=_OPTICAL,
        pose=_new("geometry_msgs/msg/PoseWithCovariance", pose=placed, covariance=np.zeros(36)),
        twist=_new("geometry_msgs/msg/TwistWithCovariance", twist=still, covariance=np.zeros(36)),
    )
    return _encoded(ODOMETRY, message)


def _image(stamp_ns: int, pixels: NDArray[Any], encoding: str) -> bytes:
    # Rows of the SDK's images may be longer than their pixels.
    data = np.ascontiguousarray(pixels)
    message = _new(
        IMAGE,
        header=_header(stamp_ns, _OPTICAL),
        height=data.shape[0],
        width=data.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=data.strides[0],
        data=data.view(np.uint8).ravel(),
    )
    return _encoded(IMAGE, message)


@cache
def _store() -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)


def _new(type_name: str, **values: Any) -> Any:
    return _store().types[type_name](**values)


def _encoded(type_name: str, message: Any) -> bytes:
    return bytes(_store().serialize_cdr(message, type_name))


def _header(stamp_ns: int, frame: str) -> Any:
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    return _new(
        "std_msgs/msg/Header",
        stamp=_new("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds),
        frame_id=frame,
    )
