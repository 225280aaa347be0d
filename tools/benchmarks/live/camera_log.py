"""A log as a depth camera of 1280x720 at 30 Hz makes it: JPEG colour, raw 16-bit depth; made from the embedded one."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from players.logs.containers import Topic
from players.opening import open_container
from tools.robot.prepared import humble

_COLOR = "/zed/zed_node/rgb/color/rect/image/compressed"
_DEPTH = "/zed/zed_node/depth/depth_registered/compressedDepth"
_RAW_DEPTH = "/zed/zed_node/depth/depth_registered"
_SIZE = (1280, 720)
_RATE_HZ = 30
_QUALITY = 92


def write_720p(source: Path, target: Path, *, seconds: float) -> Path:
    """Write the beginning of a log of 640x360 at four times its pixels and at 30 Hz; images are repeated."""
    from mcap.writer import Writer

    store: Any = humble()
    log = open_container(source)
    topics = {topic.name: topic for topic in log.topics}
    messages = [(m.topic, m.log_ns, bytes(m.data)) for m in log.messages(list(topics))]
    first_ns = min(at_ns for name, at_ns, _ in messages if name == _COLOR)
    made = [
        (_RAW_DEPTH if name == _DEPTH else name, at_ns, data)
        for name, at_ns, data in _at_30_hz(messages, store, first_ns, round(seconds * _RATE_HZ))
    ]
    made += [entry for entry in messages if entry[0] not in (_COLOR, _DEPTH) and entry[1] - first_ns < seconds * 1e9]
    with target.open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start(profile="ros2")
        channels: dict[str, int] = {}
        for name, at_ns, data in sorted(made, key=lambda entry: entry[1]):
            if name not in channels:
                type_name = "sensor_msgs/msg/Image" if name == _RAW_DEPTH else topics[name].type_name
                definition = store.generate_msgdef(type_name, ros_version=2)[0].encode()
                channels[name] = writer.register_channel(
                    name, "cdr", writer.register_schema(type_name, "ros2msg", definition)
                )
            writer.add_message(channels[name], at_ns, _scaled(topics.get(name), data, store), at_ns)
        writer.finish()
    return target


def _at_30_hz(
    messages: list[tuple[str, int, bytes]], store: Any, first_ns: int, number: int
) -> Iterator[tuple[str, int, bytes]]:
    for name, enlarge in ((_COLOR, _color), (_DEPTH, _depth)):
        images = [(at_ns, data) for topic, at_ns, data in messages if topic == name]
        for i in range(number):
            stamp_ns = first_ns + i * 1_000_000_000 // _RATE_HZ
            _, data = max((image for image in images if image[0] <= stamp_ns), default=images[0])
            message = store.deserialize_cdr(data, "sensor_msgs/msg/CompressedImage")
            stamp = message.header.stamp
            stamp.sec, stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
            made = enlarge(message, store)
            yield name, stamp_ns, bytes(store.serialize_cdr(made, made.__msgtype__))


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


def _scaled(topic: Topic | None, data: bytes, store: Any) -> bytes:
    if topic is None or topic.type_name != "sensor_msgs/msg/CameraInfo":
        return data
    info = store.deserialize_cdr(data, topic.type_name)
    info.width, info.height = _SIZE
    for name in ("k", "p"):
        matrix = getattr(info, name).reshape(3, -1).copy()
        matrix[0] *= 2
        matrix[1] *= 2
        # The middle of the first pixel stays at zero.
        matrix[:2, 2] += 0.5
        setattr(info, name, matrix.ravel())
    return bytes(store.serialize_cdr(info, topic.type_name))
