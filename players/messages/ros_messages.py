"""Messages of ROS 2, built and serialised without ROS."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import quaternion_from_rotation
from players.messages.records import CAMERA_INFO, IMAGE, ODOMETRY


class RosMessages:
    """Builds and serialises messages; a subclass for ROS 1 has other names of fields."""

    camera_matrices: tuple[str, str, str, str] = ("d", "k", "r", "p")
    more_of_header: Mapping[str, int] = MappingProxyType({})

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_typestore

        self.store = get_typestore(Stores.ROS2_HUMBLE)

    def data(self, message: Any) -> bytes:
        """Return the serialised bytes of a message."""
        return bytes(self.store.serialize_cdr(message, message.__msgtype__))

    def make(self, kind: str, **fields: Any) -> Any:
        """Return a message of a kind such as std_msgs/msg/Header."""
        return self.store.types[kind](**fields)

    def header(self, stamp_ns: int, frame_id: str) -> Any:
        """Return a header."""
        stamp = self.make("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id, **self.more_of_header)

    def compressed(self, stamp_ns: int, frame_id: str, encoding: str, data: bytes) -> Any:
        """Return a CompressedImage."""
        return self.make(
            "sensor_msgs/msg/CompressedImage",
            header=self.header(stamp_ns, frame_id),
            format=encoding,
            data=np.frombuffer(data, dtype=np.uint8),
        )

    def image(self, stamp_ns: int, frame_id: str, encoding: str, pixels: NDArray[Any]) -> Any:
        """Return an Image of (H, W) or (H, W, C) pixels, without padding."""
        rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(pixels.shape[0], -1)
        return self.make(
            IMAGE, header=self.header(stamp_ns, frame_id), height=pixels.shape[0], width=pixels.shape[1],
            encoding=encoding, is_bigendian=0, step=rows.shape[1], data=rows.ravel(),
        )  # fmt: skip

    def camera_info(self, stamp_ns: int, frame_id: str, camera: Camera, model: str, num_coefficients: int) -> Any:
        """Return a CameraInfo without distortion, K = P."""
        region = self.make(
            "sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        projection = np.column_stack([camera.K, np.zeros(3)])
        matrices = (np.zeros(num_coefficients), camera.K.ravel(), np.eye(3).ravel(), projection.ravel())
        return self.make(
            CAMERA_INFO,
            header=self.header(stamp_ns, frame_id),
            height=camera.height,
            width=camera.width,
            distortion_model=model,
            binning_x=0,
            binning_y=0,
            roi=region,
            **dict(zip(self.camera_matrices, matrices, strict=True)),
        )

    def odometry(
        self,
        stamp_ns: int,
        parent: str,
        child: str,
        parent_from_child: NDArray[np.float64],
        velocity: Sequence[float] | NDArray[np.float64] = (0.0,) * 6,
    ) -> Any:
        """Return an Odometry; `velocity` (6,) is linear and angular, in the child's frame."""
        pose = self.make(
            "geometry_msgs/msg/Pose",
            position=self.vector("geometry_msgs/msg/Point", parent_from_child[:3, 3]),
            orientation=self._rotation(parent_from_child),
        )
        twist = self.make(
            "geometry_msgs/msg/Twist",
            linear=self.vector("geometry_msgs/msg/Vector3", velocity[:3]),
            angular=self.vector("geometry_msgs/msg/Vector3", velocity[3:]),
        )
        return self.make(
            ODOMETRY,
            header=self.header(stamp_ns, parent),
            child_frame_id=child,
            pose=self.make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
            twist=self.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )

    def tf(self, stamp_ns: int, *links: tuple[str, str, NDArray[np.float64]]) -> Any:
        """Return a TFMessage of links (parent, child, parent_from_child)."""
        transforms = [
            self.make(
                "geometry_msgs/msg/TransformStamped",
                header=self.header(stamp_ns, parent),
                child_frame_id=child,
                transform=self.make(
                    "geometry_msgs/msg/Transform",
                    translation=self.vector("geometry_msgs/msg/Vector3", parent_from_child[:3, 3]),
                    rotation=self._rotation(parent_from_child),
                ),
            )
            for parent, child, parent_from_child in links
        ]
        return self.make("tf2_msgs/msg/TFMessage", transforms=transforms)

    def _rotation(self, a_from_b: NDArray[np.float64]) -> Any:
        return self.vector("geometry_msgs/msg/Quaternion", quaternion_from_rotation(a_from_b[:3, :3]))

    def vector(self, kind: str, values: Sequence[float] | NDArray[np.float64]) -> Any:
        """Return a message of x, y, z and, of a Quaternion, w."""
        return self.make(kind, **dict(zip("xyzw", np.asarray(values, dtype=np.float64).tolist(), strict=False)))
