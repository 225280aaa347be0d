"""One small synthetic scene, written in every format that the players read.

The scene is a room with a floor, a wall, a box and a ball, cast analytically: colour and depth are exact for any
camera, so that what a player yields can be compared with what a camera at that place would have seen.
"""

import json
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any
import cv2
import numpy as np
from numpy.typing import NDArray
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import (
    from_rotation_translation,
    invert,
    quaternion_from_rotation,
    rotation_from_quaternion,
    yaw_rotation,
)
from tools.worlds.ros_bags import RosMessages

CAMERA = Camera(width=80, height=60, fx=70.0, fy=70.0, cx=39.5, cy=29.5)
START_NS = 1_700_000_000_123_456_789
PERIOD_NS = 100_000_000
NUM_FRAMES = 6

OPTICAL_FROM_FLU = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
BODY_FROM_CAMERA = from_rotation_translation(OPTICAL_FROM_FLU.T, np.array([0.10, 0.06, 0.30]))


@dataclass(frozen=True, kw_only=True)
class SceneFrame:
    """A frame with its truth: `rgb` (H, W, 3), `depth_mm` (H, W) uint16 with 0 = no return."""

    stamp_ns: int
    world_from_camera: NDArray[np.float64]
    rgb: NDArray[np.uint8]
    depth_mm: NDArray[np.uint16]

    @property
    def depth_m(self):
        depth = self.depth_mm.astype(np.float32) * np.float32(0.001)
        depth[self.depth_mm == 0] = np.nan
        return depth


@dataclass(frozen=True, kw_only=True)
class Message:
    """A message for a log: a type, a topic, and the stamp under which it is recorded."""

    topic: str
    stamp_ns: int
    message: Any


def pose_at(stamp_ns):
    """Return world_from_camera of a camera that walks along x and turns slowly; z is up in the world."""
    s = (stamp_ns - START_NS) / 1e9
    return from_rotation_translation(yaw_rotation(0.3 * s), np.array([0.2 * s, 0.1 * s, 0.9])) @ BODY_FROM_CAMERA


def cast(camera, world_from_camera):
    """Return colour (H, W, 3) and depth (H, W) along the optical axis; depth is infinite where nothing is hit."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
    rays = rays @ world_from_camera[:3, :3].T
    eye = world_from_camera[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        hits = [_plane(eye, rays, 2, 0.0), _plane(eye, rays, 0, 4.0), _ball(eye, rays), _box(eye, rays)]
    depth = np.min(hits, axis=0)
    surface = np.argmin(hits, axis=0)
    points = eye + rays * np.where(np.isfinite(depth), depth, 0.0)[..., None]
    waves = 128 + 60 * np.sin(4.0 * points + surface[..., None] * np.array([1.0, 2.0, 3.0]))
    return np.where(np.isfinite(depth)[..., None], waves, 30).astype(np.uint8), depth


def make_scene(camera=CAMERA, num_frames=NUM_FRAMES):
    """Return the frames; depth ends at 3.5 m, as a depth camera's does."""
    frames = []
    for i in range(num_frames):
        stamp_ns = START_NS + i * PERIOD_NS
        rgb, depth = cast(camera, pose_at(stamp_ns))
        depth_mm = np.round(np.where(depth < 3.5, depth, 0.0) * 1000.0).astype(np.uint16)
        frames.append(SceneFrame(stamp_ns=stamp_ns, world_from_camera=pose_at(stamp_ns), rgb=rgb, depth_mm=depth_mm))
    return frames


def write_seven_scenes(folder, frames, camera=CAMERA):
    """Write a registered 7-Scenes folder whose world is tilted by 30 degrees about x."""
    folder.mkdir(parents=True)
    log_from_world = np.eye(4)
    log_from_world[:3, :3] = rotation_from_quaternion(np.sin(np.pi / 12), 0.0, 0.0, np.cos(np.pi / 12))
    np.savetxt(folder / "camera-intrinsics.txt", camera.K)
    np.savetxt(folder / "gravity-direction.txt", -log_from_world[:3, 2])
    for i, frame in enumerate(frames):
        stem = folder / f"frame-{3 * i:06d}"
        write_png(stem.with_suffix(".color.png"), frame.rgb[..., ::-1])
        write_png(stem.with_suffix(".depth.png"), frame.depth_mm)
        np.savetxt(stem.with_suffix(".pose.txt"), log_from_world @ frame.world_from_camera)
    return folder


def write_tum(folder, frames, camera=CAMERA):
    """Write a TUM RGB-D folder; depth is stamped 7 ms later, poses lie between the images."""
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
    np.savetxt(folder / "camera-intrinsics.txt", camera.K)
    rgb, depth, poses = ["# timestamp filename"], ["# timestamp filename"], ["# timestamp tx ty tz qx qy qz qw"]
    for frame in frames:
        stem = seconds(frame.stamp_ns)
        write_png(folder / "rgb" / f"{stem}.png", frame.rgb[..., ::-1])
        write_png(folder / "depth" / f"{stem}.png", frame.depth_mm * 5)
        rgb.append(f"{stem} rgb/{stem}.png")
        depth.append(f"{seconds(frame.stamp_ns + 7_000_000)} depth/{stem}.png")
    poses += [
        f"{seconds(stamp_ns)} {' '.join(f'{number:.9f}' for number in pose_row(pose_at(stamp_ns)))}"
        for stamp_ns in range(frames[0].stamp_ns - 20_000_000, frames[-1].stamp_ns + 40_000_000, 25_000_000)
    ]
    for name, lines in (("rgb", rgb), ("depth", depth), ("groundtruth", poses)):
        (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")
    return folder


def write_posed_folder(folder, frames, camera=CAMERA):
    """Write `rgb/ depth/ cam_params.json camera_poses.txt`."""
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
    parameters = {
        "w": camera.width, "h": camera.height, "fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy,
    }  # fmt: skip
    (folder / "cam_params.json").write_text(json.dumps({"camera": {**parameters, "scale": 1000.0}}))
    np.savetxt(folder / "camera_poses.txt", [frame.world_from_camera.ravel() for frame in frames])
    for i, frame in enumerate(frames):
        write_png(folder / "rgb" / f"frame{i:06d}.png", frame.rgb[..., ::-1])
        write_png(folder / "depth" / f"depth{i:06d}.png", frame.depth_mm)
    return folder


class Messages(RosMessages):
    """Builds ROS messages of one version: `ros` is 1 or 2."""

    def image(self, stamp_ns, frame, encoding, pixels, padding=0):
        made = super().image(stamp_ns, frame, encoding, pixels)
        rows = np.pad(made.data.reshape(made.height, -1), ((0, 0), (0, padding)))
        is_bigendian = int(pixels.dtype.byteorder == ">")
        return replace(made, is_bigendian=is_bigendian, step=rows.shape[1], data=rows.ravel())

    def camera_info(self, stamp_ns, frame, camera, distortion=(0.0,) * 5):
        made = super().camera_info(stamp_ns, frame, camera, "plumb_bob", len(distortion))
        return replace(made, **{self.camera_matrices[0]: np.array(list(distortion))})

    def pose(self, a_from_b):
        return self.odometry(0, "", "", a_from_b).pose.pose

    def pose_stamped(self, stamp_ns, parent, a_from_b):
        header = self.header(stamp_ns, parent)
        return self.make("geometry_msgs/msg/PoseStamped", header=header, pose=self.pose(a_from_b))


RAW_COLOR = "/cam/color/image_rect"
PNG_COLOR = "/cam/color/image_rect/compressed"
RAW_DEPTH = "/cam/aligned_depth/image_rect"
PNG_DEPTH = "/cam/aligned_depth/image_rect/compressedDepth"
OPTICAL = "cam_optical"


def raw_images(m, frame):
    """Return bgra8 colour with padded rows and 32FC1 depth in metres with NaN."""
    bgra = np.dstack([frame.rgb[..., ::-1], np.full(frame.depth_mm.shape, 255, dtype=np.uint8)])
    return [
        Message(topic=RAW_COLOR, stamp_ns=frame.stamp_ns, message=m.image(frame.stamp_ns, OPTICAL, "bgra8", bgra, 12)),
        Message(
            topic=RAW_DEPTH, stamp_ns=frame.stamp_ns, message=m.image(frame.stamp_ns, OPTICAL, "32FC1", frame.depth_m)
        ),
    ]


def png_images(m, frame):
    """Return PNG colour and compressedDepth in millimetres, stamped 9 ms later."""
    color = m.compressed(frame.stamp_ns, OPTICAL, "bgra8; png compressed bgr8", png_bytes(frame.rgb[..., ::-1]))
    late_ns = frame.stamp_ns + 9_000_000
    packed = bytes(12) + png_bytes(frame.depth_mm)
    depth = m.compressed(late_ns, OPTICAL, "16UC1; compressedDepth png", packed)
    return [
        Message(topic=PNG_COLOR, stamp_ns=frame.stamp_ns, message=color),
        Message(topic=PNG_DEPTH, stamp_ns=late_ns, message=depth),
    ]


def scene_messages(m, frames, images, *, with_odometry=True):
    """Return all messages of a log in the order of time: images, calibration, and poses by odometry or by TF alone."""
    statics = m.tf(0, ("base_link", "cam_link", np.eye(4)), ("cam_link", OPTICAL, BODY_FROM_CAMERA))
    messages = [Message(topic="/tf_static", stamp_ns=START_NS - 200_000_000, message=statics)]
    for frame in frames:
        messages += images(m, frame)
        for folder in ("color", "aligned_depth"):
            info = m.camera_info(frame.stamp_ns, OPTICAL, CAMERA)
            messages.append(Message(topic=f"/cam/{folder}/camera_info", stamp_ns=frame.stamp_ns, message=info))
    for stamp_ns in range(frames[0].stamp_ns - 30_000_000, frames[-1].stamp_ns + 40_000_000, 20_000_000):
        world_from_body = pose_at(stamp_ns) @ invert(BODY_FROM_CAMERA)
        if with_odometry:
            message = m.odometry(stamp_ns, "odom", "base_link", world_from_body)
            messages.append(Message(topic="/odom", stamp_ns=stamp_ns, message=message))
        else:
            message = m.tf(stamp_ns, ("odom", "base_link", world_from_body))
            messages.append(Message(topic="/tf", stamp_ns=stamp_ns, message=message))
    return sorted(messages, key=lambda message: message.stamp_ns)


def write_ros1(path, m, messages, *, late_ns=120_000_000_000, compression=None):
    """Write a ROS 1 bag, recorded two minutes late by the clock of the recorder, or by another time."""
    from rosbags.rosbag1 import Writer

    writer = Writer(path)
    if compression is not None:
        writer.set_compression(Writer.CompressionFormat[compression.upper()])
    return _written(path, writer, m, messages, m.store.serialize_ros1, late_ns)


def write_ros2(path, m, messages, storage="sqlite3", *, compression=None):
    """Write a ROS 2 bag folder with `storage` sqlite3 or mcap; Zstandard packs each MESSAGE or FILE."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    writer = Writer(path, version=9, storage_plugin=plugin)
    if compression is not None:
        writer.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)
    return _written(path, writer, m, messages, m.store.serialize_cdr)


def _written(path, writer, m, messages, serialize, late_ns=0):
    with writer:
        connections = {}
        for entry in messages:
            name = entry.message.__msgtype__
            if entry.topic not in connections:
                connections[entry.topic] = writer.add_connection(entry.topic, name, typestore=m.store)
            writer.write(connections[entry.topic], entry.stamp_ns + late_ns, serialize(entry.message, name))
    return path


@contextmanager
def mcap_writer(path, profile="ros2", **settings):
    """Yield a writer of the `mcap` package, and finish its file."""
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream, **settings)
        writer.start(profile=profile)
        yield writer
        writer.finish()


def write_mcap(
    path, m, messages, *, pack=bytes, topic=str, type_name=str, encoding="ros2msg", definition=lambda _: "", **settings
):
    """Write a bare MCAP file; functions may change messages, names and definitions, `settings` are the writer's."""
    with mcap_writer(path, **settings) as writer:
        channels = {}
        for entry in messages:
            name = entry.message.__msgtype__
            if entry.topic not in channels:
                text = definition(entry) or m.store.generate_msgdef(name, ros_version=2)[0]
                schema = writer.register_schema(type_name(name), encoding, text.encode())
                channels[entry.topic] = writer.register_channel(topic(entry.topic), "cdr", schema)
            data = pack(bytes(m.store.serialize_cdr(entry.message, name)))
            writer.add_message(channels[entry.topic], entry.stamp_ns, data, entry.stamp_ns)
    return path


def pose_row(a_from_b):
    """Return tx ty tz qx qy qz qw."""
    return [*a_from_b[:3, 3].tolist(), *quaternion_from_rotation(a_from_b[:3, :3]).tolist()]


def seconds(stamp_ns):
    """Return a stamp in seconds with all its digits."""
    return f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}"


def png_bytes(image):
    """Return an image (BGR or one channel) as a PNG."""
    return bytes(cv2.imencode(".png", np.ascontiguousarray(image))[1])


def jpeg_bytes(image):
    """Return an image (BGR) as a JPEG."""
    return bytes(cv2.imencode(".jpg", np.ascontiguousarray(image))[1])


def write_png(path, image):
    """Write an image (BGR or one channel)."""
    path.write_bytes(png_bytes(image))


def _plane(eye, rays, axis, at):
    t = (at - eye[axis]) / rays[..., axis]
    return np.where(t > 0, t, np.inf)


def _ball(eye, rays):
    to_eye = eye - np.array([2.0, 0.5, 0.6])
    a, b = (rays**2).sum(-1), rays @ to_eye
    root = b**2 - a * (to_eye @ to_eye - 0.3**2)
    return np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)


def _box(eye, rays):
    low, high = np.array([1.6, -0.7, 0.0]), np.array([2.2, -0.1, 0.8])
    near, far = (low - eye) / rays, (high - eye) / rays
    entry, leave = np.minimum(near, far).max(-1), np.maximum(near, far).min(-1)
    return np.where((entry < leave) & (entry > 0), entry, np.inf)
