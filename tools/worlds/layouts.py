"""Synthetic logs in the exact layouts of public data sets, quirks included, to test the players with."""
# Messages of ROS 1 and ROS 2 for synthetic logs; they differ in the case of a few fields and in the header. The numbers
# of the rigs are repeated here, so that an error in a profile of `players` cannot cancel itself out.

from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import from_rotation_translation, invert, rotation_of_vector, yaw_rotation
from hickory_stream.worlds.zed_log import COLOR_ENCODING, DepthView, LogWriter, ZedLog, encode_jpeg
from tools.worlds.container_layouts import CONTAINER_LOGS
from tools.worlds.image_folders import FOLDER_LOGS
from tools.worlds.ros_bags import HumbleDatabase, Ros1Bag, RosMessages

LAYOUTS = ("zed", "kimera_multi", "nus_clb", "nus_clb_jpeg", *FOLDER_LOGS, *CONTAINER_LOGS)

_FLU_FROM_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def layout_files(layout: str, name: str) -> tuple[str, ...]:
    """Return the files or folders of a recording in a layout, beginning with the one to play."""
    if layout == "kimera_multi":
        return f"{name}.bag", f"{name}_vio.bag"
    return (f"{name}.mcap",) if layout == "zed" else (f"{name}{getattr(CONTAINER_LOGS.get(layout), 'ending', '')}",)


def layout_camera(layout: str, camera: Camera) -> Camera:
    """Return the colour camera of a layout for images of the size of `camera`; some layouts have fixed intrinsics."""
    if layout == "kimera_multi":
        return _resized(Camera(width=640, height=480, fx=372.4634, fy=371.5072, cx=315.9902, cy=254.5944), camera)
    if layout == "icl_nuim":
        return _resized(Camera(width=640, height=480, fx=481.2, fy=480.0, cx=319.5, cy=239.5), camera)
    return camera


def drawn_mounting(seed: int) -> NDArray[np.float64]:
    """Return body_from_camera (4, 4) of a camera 0.4 m from the body's origin, 10 degrees off its axes, by a seed."""
    # The pose on a Unitree B2 was not published; the camera is mostly ahead.
    rng = np.random.default_rng([seed, 7])
    ahead = np.array([1.0, 0.5, 0.5]) * rng.standard_normal(3) + np.array([1.5, 0.0, 0.5])
    axis = rng.standard_normal(3)
    turn = rotation_of_vector(np.radians(10.0) * axis / np.linalg.norm(axis))
    return from_rotation_translation(turn @ _FLU_FROM_OPTICAL, 0.4 * ahead / np.linalg.norm(ahead))


def open_layout(
    layout: str, folder: Path, name: str, camera: Camera, jpeg_quality: int, end_ns: int,
    mounting: NDArray[np.float64] | None = None,
) -> LogWriter:  # fmt: skip
    """Return the writer of a layout; `mounting` is body_from_camera (4, 4) of a NUS-CLB robot, None: one origin."""
    if layout == "kimera_multi":
        return KimeraMultiLog(folder, name, camera, jpeg_quality)
    if layout in FOLDER_LOGS:
        return FOLDER_LOGS[layout](folder / name, camera, jpeg_quality)
    if layout.startswith("nus_clb"):
        quality = jpeg_quality if layout.endswith("jpeg") else None
        return NusClbLog(folder / name, name, camera, quality, end_ns, mounting)
    if layout in CONTAINER_LOGS:
        return CONTAINER_LOGS[layout](folder / layout_files(layout, name)[0], camera, jpeg_quality)
    return ZedLog(folder / f"{name}.mcap", camera, jpeg_quality)


class KimeraMultiLog:
    """A robot's bag and, beside it, the bag of its visual odometry."""

    # No TF, frames with another robot's prefix, bags recorded two minutes late; depth is 16UC1, unregistered, of the
    # left infrared camera; odometry is of the IMU in optical axes, at 5 Hz at most.
    robot = "acl_jackal"
    prefix = "acl_jackal2"
    log_offset_ns = 111_300_000_000

    # Kimera-VIO's T_BS, and the factory calibration of acl_jackal's colour camera.
    body_from_infra1 = np.array([
        [0.99985945, -0.01443721, 0.00852319, -0.02647408], [0.01453776, 0.99982404, -0.01185494, 0.00914898],
        [-0.00835054, 0.01197718, 0.99989340, 0.02575617], [0.0, 0.0, 0.0, 1.0],
    ])  # fmt: skip
    infra1_from_color = np.array([
        [0.999997, 0.0016371, -0.0015848, 0.0589082], [-0.0016342, 0.999997, 0.0017948, -3.43e-05],
        [0.0015877, -0.0017922, 0.999997, -0.0001886], [0.0, 0.0, 0.0, 1.0],
    ])  # fmt: skip
    odometry_step_ns = 195_000_000

    def __init__(self, folder: Path, name: str, camera: Camera, jpeg_quality: int) -> None:
        self._jpeg_quality = jpeg_quality
        self._camera = camera
        depth = _resized(Camera(width=640, height=480, fx=381.2355, fy=381.2355, cx=321.2549, cy=237.6025), camera)
        self.depth_view: DepthView | None = DepthView(
            camera=depth, color_from_depth=np.linalg.inv(self.infra1_from_color), lag_ns=7_300_000
        )
        self._bags = [Ros1Bag(folder / file) for file in layout_files("kimera_multi", name)]
        self._messages = self._bags[0].messages
        self._odometry_ns = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for bag in self._bags:
            bag.close()

    def write_static(self, stamp_ns: int) -> None:
        """Write nothing: the public bags have no TF."""

    def write_pose(
        self, stamp_ns: int, world_from_camera: NDArray[np.float64], velocity_link: NDArray[np.float64]
    ) -> None:
        """Write the wheels' planar odometry, and Kimera-VIO's into the other bag."""
        del velocity_link
        m = self._messages
        world_from_body = world_from_camera @ np.linalg.inv(self.body_from_infra1 @ self.infra1_from_color)
        planar = np.eye(4)
        planar[:2, 3] = world_from_camera[:2, 3]
        forward = world_from_camera[:3, 2]
        planar[:3, :3] = yaw_rotation(float(np.arctan2(forward[1], forward[0])))
        wheels = m.odometry(stamp_ns, f"{self.prefix}/odom", f"{self.prefix}/base", planar)
        self._put(0, "jackal_velocity_controller/odom", stamp_ns, wheels)
        if stamp_ns - self._odometry_ns >= self.odometry_step_ns:
            self._odometry_ns = stamp_ns
            frames = (f"{self.robot}/odom", f"{self.robot}/realsense_base")
            vio = m.odometry(stamp_ns, *frames, _orthogonal(world_from_body))
            self._put(1, "kimera_vio_ros/odometry", stamp_ns, vio)

    def write_images(self, stamp_ns: int, rgb: NDArray[np.uint8], depth_m: NDArray[np.float32]) -> None:
        """Write JPEG colour and raw 16UC1 depth, each with its camera info."""
        m, view = self._messages, self.depth_view
        assert view is not None
        color_frame, depth_frame = (f"{self.prefix}/forward_{name}_optical_frame" for name in ("color", "depth"))
        jpeg = encode_jpeg(rgb, self._jpeg_quality)
        color = m.compressed(stamp_ns, color_frame, COLOR_ENCODING, jpeg)
        self._put(0, "forward/color/image_raw/compressed", stamp_ns, color)
        info = m.camera_info(stamp_ns, color_frame, self._camera, "plumb_bob", 5)
        self._put(0, "forward/color/camera_info", stamp_ns, info)
        depth_ns = stamp_ns + view.lag_ns
        millimetres = np.nan_to_num(depth_m * 1000.0, nan=0.0, posinf=0.0, neginf=0.0).round().astype(np.uint16)
        depth = m.image(depth_ns, depth_frame, "16UC1", millimetres)
        self._put(0, "forward/depth/image_rect_raw", depth_ns, depth)
        info = m.camera_info(depth_ns, depth_frame, view.camera, "plumb_bob", 5)
        self._put(0, "forward/depth/camera_info", depth_ns, info)

    def _put(self, bag: int, name: str, stamp_ns: int, message: Any) -> None:
        self._bags[bag].put(f"/{self.robot}/{name}", stamp_ns + self.log_offset_ns, message)


class NusClbLog:
    """A ROS 2 bag (sqlite3) of a Unitree B2 with a ZED 2i."""

    # Colour is bgra8, or JPEG under the raw name; depth has NaN, +inf beyond the range and -inf before it. The pose is
    # LiDAR odometry in FLU axes with a jump by a loop closure. Unitree's own types lie beside it, without definitions.
    jump_at = 0.8
    after_from_before = from_rotation_translation(yaw_rotation(0.03), np.array([0.35, -0.2, 0.05]))
    _color = "/zed/zed_node/rgb/color/rect/image"
    _frame = "zed_left_camera_frame_optical"

    def __init__(
        self, folder: Path, name: str, camera: Camera, jpeg_quality: int | None, end_ns: int,
        mounting: NDArray[np.float64] | None = None,
    ) -> None:  # fmt: skip
        aligned = from_rotation_translation(_FLU_FROM_OPTICAL, np.zeros(3))
        self._camera_from_flu = invert(aligned if mounting is None else mounting)
        self.depth_view: DepthView | None = None
        self._messages = RosMessages(2)
        self._folder = folder
        self._file = f"{name}_0.db3"
        self._camera = camera
        self._jpeg_quality = jpeg_quality
        self._start_ns: int | None = None
        self._end_ns = end_ns
        self._lidar_ns = 0

    def __enter__(self) -> Self:
        self._folder.mkdir(parents=True)
        self._database = HumbleDatabase(self._folder / self._file)
        return self

    def __exit__(self, *_: object) -> None:
        counts, low, high = self._database.close()
        topics = "".join(
            f"    - topic_metadata:\n        name: {name}\n        type: {kind_}\n        serialization_format: cdr\n"
            f'        offered_qos_profiles: ""\n      message_count: {counts.get(number, 0)}\n'
            for name, (number, kind_) in self._database.topics.items()
        )
        (self._folder / "metadata.yaml").write_text(
            "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: sqlite3\n"
            f"  duration:\n    nanoseconds: {high - low}\n"
            f"  starting_time:\n    nanoseconds_since_epoch: {low}\n  message_count: {sum(counts.values())}\n"
            f'  topics_with_message_count:\n{topics}  compression_format: ""\n  compression_mode: ""\n'
            f"  relative_file_paths:\n    - {self._file}\n",
            encoding="utf-8",
        )

    def write_static(self, stamp_ns: int) -> None:
        """Write the camera's links; none leads to the LiDAR's frames."""
        self._start_ns = stamp_ns
        center, left = (
            from_rotation_translation(np.eye(3), np.array(at)) for at in ((0.0, 0.0, 0.015), (-0.01, 0.06, 0.0))
        )
        links = (
            ("zed_camera_link", "zed_camera_center", center),
            ("zed_camera_center", "zed_left_camera_frame", left),
            ("zed_left_camera_frame", self._frame, from_rotation_translation(_FLU_FROM_OPTICAL, np.zeros(3))),
        )
        self._put("/tf_static", stamp_ns, self._messages.tf(stamp_ns, *links))

    def write_pose(
        self, stamp_ns: int, world_from_camera: NDArray[np.float64], velocity_link: NDArray[np.float64]
    ) -> None:
        """Write LiDAR odometry at its rate, and what Unitree publishes all the time."""
        del velocity_link
        self._put_bytes("/sportmodestate", "unitree_go/msg/SportModeState", stamp_ns, bytes(range(64)))
        self._put_bytes("/lowstate", "unitree_go/msg/LowState", stamp_ns, bytes(96))
        if stamp_ns - self._lidar_ns < 95_000_000:
            return
        self._lidar_ns = stamp_ns
        world_from_flu = world_from_camera @ self._camera_from_flu
        has_jumped = stamp_ns - (self._start_ns or 0) >= self.jump_at * (self._end_ns - (self._start_ns or 0))
        pose = self.after_from_before @ world_from_flu if has_jumped else world_from_flu
        message = self._messages.odometry(stamp_ns, "odom", "odom_mapping", _orthogonal(pose))
        self._put("/lio_sam_ros2/mapping/odometry", stamp_ns, message)

    def write_images(self, stamp_ns: int, rgb: NDArray[np.uint8], depth_m: NDArray[np.float32]) -> None:
        m = self._messages
        if self._jpeg_quality is None:
            bgra = np.dstack([rgb[..., ::-1], np.full(rgb.shape[:2], 255, dtype=np.uint8)])
            color = m.image(stamp_ns, self._frame, "bgra8", bgra)
        else:
            color = m.compressed(stamp_ns, self._frame, "jpeg", encode_jpeg(rgb, self._jpeg_quality))
        self._put(self._color, stamp_ns, color)
        depth = depth_m.copy()
        lost = np.flatnonzero(~np.isfinite(depth))
        depth.flat[lost[::3]], depth.flat[lost[1::3]] = np.inf, -np.inf
        self._put("/zed/zed_node/depth/depth_registered", stamp_ns, m.image(stamp_ns, self._frame, "32FC1", depth))
        for topic in ("/zed/zed_node/rgb/color/rect/camera_info", "/zed/zed_node/depth/camera_info"):
            info = m.camera_info(stamp_ns, self._frame, self._camera, "rational_polynomial", 8)
            self._put(topic, stamp_ns, info)

    def _put(self, topic: str, stamp_ns: int, message: Any) -> None:
        self._put_bytes(topic, message.__msgtype__, stamp_ns, self._messages.data(message))

    def _put_bytes(self, topic: str, kind: str, stamp_ns: int, data: bytes) -> None:
        self._database.put(topic, kind, stamp_ns + 30_000_000, data)


def _resized(camera: Camera, like: Camera) -> Camera:
    # Scaled to the width, cropped to the middle of the height.
    factor = like.width / camera.width
    return Camera(
        width=like.width, height=like.height, fx=camera.fx * factor, fy=camera.fy * factor,
        cx=(camera.cx + 0.5) * factor - 0.5,
        cy=(camera.cy + 0.5) * factor - 0.5 + (like.height - camera.height * factor) / 2,
    )  # fmt: skip


def _orthogonal(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    # Rotations of printed calibrations are not exactly orthogonal.
    u, _, vt = np.linalg.svd(pose[:3, :3])
    return from_rotation_translation(u @ vt, pose[:3, 3])
