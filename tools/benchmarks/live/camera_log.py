"""Logs of other robots, made from logs that exist: a depth camera of 1280x720 at 30 Hz; a walking B2 with a ZED."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import cycle, takewhile
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from hickory_stream.geometry.rigid import from_rotation_translation, rotation_of_vector
from hickory_stream.records import RawFrame
from players.opening import open_container, open_source
from tools.damage.damaging import write_mcap
from tools.robot.prepared import humble
from tools.worlds.layouts import NusClbLog, drawn_mounting

_COLOR = "/zed/zed_node/rgb/color/rect/image/compressed"
_DEPTH = "/zed/zed_node/depth/depth_registered/compressedDepth"
_RAW_DEPTH = "/zed/zed_node/depth/depth_registered"
_SIZE = (1280, 720)
_RATE_HZ = 30
_QUALITY = 92
_B2_RATE_HZ, _STEPS_HZ, _PITCH_DEG, _EXPOSURE_S = 15, 2.0, 1.5, 0.01


def write_720p(source: Path, target: Path, *, seconds: float, repeats: bool = True) -> Path:
    """Write the beginning of a log of 640x360 at four times its pixels; `repeats`: images are repeated, at 30 Hz."""
    store, log = humble(), open_container(source)
    types = {topic.name: topic.type_name for topic in log.topics}
    messages = [(m.topic, m.log_ns, bytes(m.data)) for m in log.messages(list(types))]
    first_ns = min(at_ns for name, at_ns, _ in messages if name == _COLOR)
    messages = [message for message in messages if message[1] - first_ns < seconds * 1e9]
    due_ns = [first_ns + i * 1_000_000_000 // _RATE_HZ for i in range(round(seconds * _RATE_HZ))] if repeats else None
    made = list(_images(messages, store, due_ns))
    for name, at_ns, data in messages:
        if name not in (_COLOR, _DEPTH):
            made.append((name, at_ns, _scaled(store.deserialize_cdr(data, types[name]))))
    return write_mcap(target, sorted(made, key=lambda entry: entry[1]), "none", 4 << 20)


def write_b2(source: Path, folder: Path, *, seconds: float, width: int = 1280, seed: int = 0) -> Path:
    """Write a log, there and back, as a B2's bag in the layout of NUS-CLB (sqlite3), at 15 Hz; return its folder."""
    # The gait pitches the camera, which is a homography of the images; colour is blurred by the turn during exposure.
    frames = open_source(source)
    small, factor = frames.info.camera, width / frames.info.camera.width
    height = width * 9 // 16
    camera = replace(
        small, width=width, height=height, fx=small.fx * factor, fy=small.fy * factor,
        cx=(small.cx + 0.5) * factor - 0.5, cy=(small.cy + 0.5) * factor - 0.5 + (height - small.height * factor) / 2,
    )  # fmt: skip
    start_ns = frames.info.start_ns
    assert start_ns is not None
    end_ns, due_ns, before = start_ns + round(seconds * 1e9), start_ns, None
    with NusClbLog(folder, folder.name, camera, _QUALITY, end_ns, drawn_mounting(seed)) as log:
        log.write_static(start_ns)
        for raw in takewhile(lambda raw: raw.stamp_ns < end_ns, _there_and_back(frames.frames())):
            pitch = rotation_of_vector(np.array([_gait_rad(raw.stamp_ns - start_ns), 0.0, 0.0]))
            pose = raw.world_from_camera @ from_rotation_translation(pitch.T, np.zeros(3))
            log.write_pose(raw.stamp_ns, pose, np.eye(4))
            if raw.stamp_ns >= due_ns:
                due_ns += 1_000_000_000 // _B2_RATE_HZ
                turned = camera.K @ pitch @ np.linalg.inv(small.K)
                frame = raw.decode()
                rgb = cv2.warpPerspective(frame.rgb, turned, (width, height))
                along = np.linalg.inv(small.K)[:, :2] @ np.indices(frame.depth_m.shape)[::-1].reshape(2, -1)
                along = pitch[2] @ (along + np.linalg.inv(small.K)[:, 2:])
                depth = cv2.warpPerspective(
                    frame.depth_m * along.reshape(frame.depth_m.shape).astype(np.float32), turned, (width, height),
                    flags=cv2.INTER_NEAREST, borderValue=float("nan"),
                )  # fmt: skip
                log.write_images(raw.stamp_ns, _blurred(rgb, camera, before, (raw.stamp_ns, pose)), depth)
            before = raw.stamp_ns, pose
    return folder


def _there_and_back(frames: Iterable[RawFrame]) -> Iterator[RawFrame]:
    way = list(frames)
    step_ns = way[1].stamp_ns - way[0].stamp_ns
    for i, raw in enumerate(cycle([*way, *way[::-1]])):
        yield replace(raw, stamp_ns=way[0].stamp_ns + i * step_ns)


def _gait_rad(since_ns: int) -> float:
    return float(np.radians(_PITCH_DEG) * np.sin(2 * np.pi * _STEPS_HZ * since_ns / 1e9))


def _blurred(rgb: Any, camera: Any, before: tuple[int, Any] | None, now: tuple[int, Any]) -> Any:
    if before is None:
        return rgb
    ahead = before[1][:3, :3].T @ now[1][:3, 2]
    moved_px = camera.fx * _EXPOSURE_S * ahead[:2] / (now[0] - before[0]) * 1e9
    size = int(np.abs(moved_px).max()) | 1
    kernel = np.zeros((size, size), np.float32)
    middle = size // 2
    end = tuple(np.rint(middle + moved_px / 2).astype(int).tolist())
    start = tuple(np.rint(middle - moved_px / 2).astype(int).tolist())
    cv2.line(kernel, start, end, 1.0)
    return cv2.filter2D(rgb, -1, kernel / kernel.sum())


def _images(messages: list[Any], store: Any, due_ns: list[int] | None) -> Iterator[tuple[str, int, Any]]:
    for topic, enlarge, new_topic in ((_COLOR, _color, _COLOR), (_DEPTH, _depth, _RAW_DEPTH)):
        images = [(at_ns, data) for name, at_ns, data in messages if name == topic]
        for at_ns in due_ns or [at_ns for at_ns, _ in images]:
            _, data = max((image for image in images if image[0] <= at_ns), default=images[0])
            message = store.deserialize_cdr(data, "sensor_msgs/msg/CompressedImage")
            if due_ns is not None:
                stamp = message.header.stamp
                stamp.sec, stamp.nanosec = divmod(at_ns, 1_000_000_000)
            yield new_topic, at_ns, enlarge(message, store)


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
