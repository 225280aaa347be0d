"""Messages of ROS 1 and ROS 2 for synthetic logs; they differ in the case of a few fields and in the header."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from hickory_stream.geometry.rigid import quaternion_from_rotation

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.geometry.camera import Camera


class RosMessages:
    """Builds and serialises messages of ROS 1 or ROS 2."""

    def __init__(self, ros: Literal[1, 2]) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.ros = ros
        self.store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
        if ros == 1:
            transforms = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(transforms, "tf2_msgs/msg/TFMessage"))

    def data(self, message: Any) -> bytes:
        """Return the serialised bytes of a message."""
        name = message.__msgtype__
        return bytes(
            self.store.serialize_ros1(message, name) if self.ros == 1 else self.store.serialize_cdr(message, name)
        )

    def make(self, kind: str, **fields: Any) -> Any:
        """Return a message of a kind such as std_msgs/msg/Header."""
        return self.store.types[kind](**fields)

    def header(self, stamp_ns: int, frame_id: str) -> Any:
        """Return a header."""
        stamp = self.make("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        sequence = {"seq": 0} if self.ros == 1 else {}
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id, **sequence)

    def image(self, stamp_ns: int, frame_id: str, encoding: str, pixels: NDArray[Any]) -> Any:
        """Return an Image of (H, W) or (H, W, C) pixels, without padding."""
        rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(pixels.shape[0], -1)
        return self.make(
            "sensor_msgs/msg/Image",
            header=self.header(stamp_ns, frame_id),
            height=pixels.shape[0],
            width=pixels.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=rows.shape[1],
            data=rows.ravel(),
        )

    def compressed(self, stamp_ns: int, frame_id: str, encoding: str, data: bytes) -> Any:
        """Return a CompressedImage."""
        return self.make(
            "sensor_msgs/msg/CompressedImage",
            header=self.header(stamp_ns, frame_id),
            format=encoding,
            data=np.frombuffer(data, dtype=np.uint8),
        )

    def camera_info(self, stamp_ns: int, frame_id: str, camera: Camera, model: str, num_coefficients: int) -> Any:
        """Return a CameraInfo without distortion, K = P."""
        region = self.make(
            "sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        matrices = {
            "d": np.zeros(num_coefficients),
            "k": camera.K.ravel(),
            "r": np.eye(3).ravel(),
            "p": np.hstack([camera.K, np.zeros((3, 1))]).ravel(),
        }
        return self.make(
            "sensor_msgs/msg/CameraInfo",
            header=self.header(stamp_ns, frame_id),
            height=camera.height,
            width=camera.width,
            distortion_model=model,
            binning_x=0,
            binning_y=0,
            roi=region,
            **{name.upper() if self.ros == 1 else name: matrix for name, matrix in matrices.items()},
        )

    def odometry(self, stamp_ns: int, parent: str, child: str, parent_from_child: NDArray[np.float64]) -> Any:
        """Return an Odometry without velocities."""
        zero = self._vector("geometry_msgs/msg/Vector3", (0.0, 0.0, 0.0))
        pose = self.make(
            "geometry_msgs/msg/Pose",
            position=self._vector("geometry_msgs/msg/Point", parent_from_child[:3, 3]),
            orientation=self._quaternion(parent_from_child),
        )
        twist = self.make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
        return self.make(
            "nav_msgs/msg/Odometry",
            header=self.header(stamp_ns, parent),
            child_frame_id=child,
            pose=self.make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
            twist=self.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )

    def tf(self, stamp_ns: int, *links: tuple[str, str, NDArray[np.float64]]) -> Any:
        """Return a TFMessage of links (parent, child, parent_from_child)."""
        transforms = []
        for parent, child, parent_from_child in links:
            transform = self.make(
                "geometry_msgs/msg/Transform",
                translation=self._vector("geometry_msgs/msg/Vector3", parent_from_child[:3, 3]),
                rotation=self._quaternion(parent_from_child),
            )
            transforms.append(
                self.make(
                    "geometry_msgs/msg/TransformStamped",
                    header=self.header(stamp_ns, parent),
                    child_frame_id=child,
                    transform=transform,
                )
            )
        return self.make("tf2_msgs/msg/TFMessage", transforms=transforms)

    def _vector(self, kind: str, values: Any) -> Any:
        x, y, z = (float(value) for value in values)
        return self.make(kind, x=x, y=y, z=z)

    def _quaternion(self, a_from_b: NDArray[np.float64]) -> Any:
        x, y, z, w = (float(value) for value in quaternion_from_rotation(a_from_b[:3, :3]))
        return self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
