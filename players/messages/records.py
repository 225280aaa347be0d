"""Poses and calibrations as records; ROS 1 and ROS 2 differ in the letter case of a few fields only."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
VIDEOS = ("foxglove_msgs/msg/CompressedVideo", "ffmpeg_image_transport_msgs/msg/FFMPEGPacket")
ODOMETRY = "nav_msgs/msg/Odometry"
POSE = "geometry_msgs/msg/PoseStamped"
POSE_WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
PATH = "nav_msgs/msg/Path"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
POSE_TYPES = (ODOMETRY, POSE_WITH_COVARIANCE, POSE, PATH)
HEADER_FIRST = frozenset(
    (IMAGE, COMPRESSED_IMAGE, CAMERA_INFO, *POSE_TYPES, POINT_CLOUD, "sensor_msgs/msg/Imu", "sensor_msgs/msg/LaserScan")
)
"""Types whose first field is a header."""


@dataclass(frozen=True, kw_only=True, slots=True)
class StampedPose:
    """The pose parent_from_child as `row` = tx ty tz qx qy qz qw; `child` is "" for messages without a child frame."""

    stamp_ns: int
    parent: str
    child: str
    row: tuple[float, ...]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CameraInfo:
    """The fields of a `CameraInfo`: `K` (3, 3), `P` (3, 4), `D` (n,); `size` is (width, height), (0, 0) if unset.

    Size, `K` and `P` are those of the whole sensor, unbinned; images are its `region` (x, y, width, height), binned.
    """

    frame: str
    size: tuple[int, int]
    K: NDArray[np.float64]
    P: NDArray[np.float64]
    D: NDArray[np.float64]
    distortion_model: str
    binning: tuple[int, int] = (1, 1)
    region: tuple[int, int, int, int] = (0, 0, 0, 0)

    @property
    def layout(self) -> tuple[object, ...]:
        """Which pixels of the sensor the images have."""
        return self.size, self.binning, self.region


def header_stamp_ns(message: Any) -> int:
    """Return the stamp of a message's header."""
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def frame_name(name: str) -> str:
    """Return a frame's name without the leading slash that ROS 1 allowed."""
    return name.lstrip("/")


def poses_of(type_name: str, message: Any) -> list[StampedPose]:
    """Return the poses in a message of one of `POSE_TYPES` or `TF`."""
    if type_name in TF:
        return [_transform(transform) for transform in message.transforms]
    if type_name == PATH:
        # Every Path message repeats the whole path with corrections; only its last pose is new.
        return [_stamped(p, "", p.pose.position, p.pose.orientation) for p in message.poses[-1:]]
    pose = message.pose if type_name == POSE else message.pose.pose
    child = frame_name(message.child_frame_id) if type_name == ODOMETRY else ""
    return [_stamped(message, child, pose.position, pose.orientation)]


def camera_info_of(message: Any) -> CameraInfo:
    """Return the calibration of a `CameraInfo` message."""
    k, p, d = (getattr(message, name if hasattr(message, name) else name.upper()) for name in "kpd")
    roi = getattr(message, "roi", None)
    return CameraInfo(
        frame=frame_name(message.header.frame_id),
        size=(int(message.width), int(message.height)),
        K=np.asarray(k, dtype=np.float64).reshape(3, 3),
        P=np.asarray(p, dtype=np.float64).reshape(3, 4),
        D=np.asarray(d, dtype=np.float64).ravel(),
        distortion_model=str(message.distortion_model),
        # 0 is no binning; Foxglove's calibrations have neither field.
        binning=(max(1, int(getattr(message, "binning_x", 1))), max(1, int(getattr(message, "binning_y", 1)))),
        region=(roi.x_offset, roi.y_offset, roi.width, roi.height) if roi is not None else (0, 0, 0, 0),
    )


def _transform(transform: Any) -> StampedPose:
    translation, rotation = transform.transform.translation, transform.transform.rotation
    return _stamped(transform, frame_name(transform.child_frame_id), translation, rotation)


def _stamped(message: Any, child: str, position: Any, orientation: Any) -> StampedPose:
    return StampedPose(
        stamp_ns=header_stamp_ns(message),
        parent=frame_name(message.header.frame_id),
        child=child,
        row=(position.x, position.y, position.z, orientation.x, orientation.y, orientation.z, orientation.w),
    )
