"""Messages of ROS 1 and ROS 2 for synthetic logs; they differ in the case of a few fields and in the header."""

from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hickory_stream.worlds import ros_messages


class RosMessages(ros_messages.RosMessages):
    """Builds and serialises messages of ROS 1 or ROS 2."""

    def __init__(self, ros: Literal[1, 2]) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        super().__init__()
        self.ros = ros
        if ros == 1:
            self.camera_matrices = ("D", "K", "R", "P")
            self.more_of_header = MappingProxyType({"seq": 0})
            self.store = get_typestore(Stores.ROS1_NOETIC)
            transforms = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(transforms, "tf2_msgs/msg/TFMessage"))

    def data(self, message: Any) -> bytes:
        if self.ros == 1:
            return bytes(self.store.serialize_ros1(message, message.__msgtype__))
        return super().data(message)

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
