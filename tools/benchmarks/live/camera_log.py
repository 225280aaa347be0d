"""A log as a depth camera of 1280x720 at 30 Hz makes it: JPEG colour, raw 16-bit depth; made from the embedded one."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from players.opening import open_container
from tools.damage.damaging import write_mcap
from tools.robot.prepared import humble

_COLOR = "/zed/zed_node/rgb/color/rect/image/compressed"
_DEPTH = "/zed/zed_node/depth/depth_registered/compressedDepth"
_RAW_DEPTH = "/zed/zed_node/depth/depth_registered"
_SIZE = (1280, 720)
_RATE_HZ = 30
_QUALITY = 92


def write_720p(source: Path, target: Path, *, seconds: float) -> Path:
    """Write the beginning of a log of 640x360 at four times its pixels and at 30 Hz; images are repeated."""
    store, log = humble(), open_container(source)
    types = {topic.name: topic.type_name for topic in log.topics}
    messages = [(m.topic, m.log_ns, bytes(m.data)) for m in log.messages(list(types))]
    first_ns = min(at_ns for name, at_ns, _ in messages if name == _COLOR)
    made = list(_at_30_hz(messages, store, first_ns, round(seconds * _RATE_HZ)))
    for name, at_ns, data in messages:
        if name not in (_COLOR, _DEPTH) and at_ns - first_ns < seconds * 1e9:
            made.append((name, at_ns, _scaled(store.deserialize_cdr(data, types[name]))))
    return write_mcap(target, sorted(made, key=lambda entry: entry[1]), "none", 4 << 20)


def _at_30_hz(
    messages: list[tuple[str, int, bytes]], store: Any, first_ns: int, number: int
) -> Iterator[tuple[str, int, Any]]:
    for topic, enlarge, new_topic in ((_COLOR, _color, _COLOR), (_DEPTH, _depth, _RAW_DEPTH)):
        images = [(at_ns, data) for name, at_ns, data in messages if name == topic]
        for i in range(number):
            stamp_ns = first_ns + i * 1_000_000_000 // _RATE_HZ
            _, data = max((image for image in images if image[0] <= stamp_ns), default=images[0])
            message = store.deserialize_cdr(data, "sensor_msgs/msg/CompressedImage")
            stamp = message.header.stamp
            stamp.sec, stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
            yield new_topic, stamp_ns, enlarge(message, store)


def _color(message: Any, store: Any) -> Any:
    image = cv2.resize(cv2.imdecode(message.data, cv2.IMREAD_COLOR), _SIZE)
    message.data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].ravel()
    return message


def _depth(message: Any, store: Any) -> Any:
    small = cv2.imdecode(message.data[12:], cv2.IMREAD_UNCHANGED)
    image = cv2.resize(small, _SIZE, interpolation=cv2.INTER_NEAREST).astype(np.uint16)
    return store.types["sensor_msgs/msg/Image"](
        header=message.header, height=_SIZE[1], width=_SIZE[0], encoding="16UC1", is_bigendian=0, step=2 * _SIZE[0],
        data=image.view(np.uint8).ravel(),
    )  # fmt: skip


def _scaled(message: Any) -> Any:
    if message.__msgtype__ == "sensor_msgs/msg/CameraInfo":
        message.width, message.height = _SIZE
        message.k, message.p = message.k.copy(), message.p.copy()
        for matrix in (message.k.reshape(3, 3), message.p.reshape(3, 4)):
            matrix[:2] *= 2
            # The middle of the first pixel stays at zero.
            matrix[:2, 2] += 0.5
    return message
