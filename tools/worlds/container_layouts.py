"""Synthetic logs as the files of ScanNet (.sens), Record3D (.r3d and its export) and the RealSense viewer (.bag)."""

import io
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.json_text import dumps
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import (
    from_rotation_translation,
    invert,
    quaternion_from_rotation,
    rotation_of_vector,
)
from hickory_stream.worlds.zed_log import DepthView, encode_jpeg
from tools.worlds.image_folders import FolderLog
from tools.worlds.ros_bags import Ros1Bag

COLOR_FROM_DEPTH = from_rotation_translation(
    rotation_of_vector(np.array([0.004, -0.01, 0.006])), np.array([0.025, -0.002, 0.001])
)
_Y_UP_FROM_Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, -1.0, 0, 0], [0, 0, 0, 1.0]])
_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


class ContainerLog(FolderLog):
    """A log in one file whose depth camera is beside the colour camera."""

    ending, lag_ns = "", 0

    def __init__(self, path: Path, camera: Camera, jpeg_quality: int) -> None:
        super().__init__(path, camera, jpeg_quality)
        self.depth_camera = Camera(
            width=camera.width, height=camera.height, fx=0.97 * camera.fx, fy=0.97 * camera.fy,
            cx=camera.cx + 1.5, cy=camera.cy - 1.0,
        )  # fmt: skip
        self.depth_view = DepthView(camera=self.depth_camera, color_from_depth=COLOR_FROM_DEPTH, lag_ns=self.lag_ns)


class SensLog(ContainerLog):
    """A `.sens` file; tracking is lost in one frame."""

    ending, lost = ".sens", 3

    def __init__(self, path: Path, camera: Camera, jpeg_quality: int) -> None:
        super().__init__(path, camera, jpeg_quality)
        self.frames: list[bytes] = []

    def write_images(self, stamp_ns: int, rgb: NDArray[np.uint8], depth_m: NDArray[np.float32]) -> None:
        pose = np.full((4, 4), -np.inf) if len(self.frames) == self.lost else self._pose @ COLOR_FROM_DEPTH
        color, depth = encode_jpeg(rgb, self._jpeg_quality), zlib.compress(_units(depth_m, 1000.0).tobytes())
        head = struct.pack("<4Q", stamp_ns // 1000, stamp_ns // 1000, len(color), len(depth))
        self.frames.append(pose.astype("<f4").tobytes() + head + color + depth)

    def finish(self) -> None:
        matrices = np.tile(np.eye(4, dtype="<f4"), (4, 1, 1))
        matrices[0, :3, :3], matrices[2, :3, :3], matrices[3] = self._camera.K, self.depth_camera.K, COLOR_FROM_DEPTH
        name, sizes = b"StructureSensor", (self._camera.width, self._camera.height) * 2
        head = struct.pack("<2i4IfQ", 2, 1, *sizes, 1000.0, len(self.frames))
        head = struct.pack("<IQ", 4, len(name)) + name + matrices.tobytes() + head
        self._folder.write_bytes(head + b"".join(self.frames) + struct.pack("<Q", 0))


class Record3dExport(FolderLog):
    """The app's export of EXR and JPEG: depth has half the size of colour, poses are those of a world with y up."""

    ending, metadata, begins_at_identity = "", "EXR_RGBD/metadata.json", False

    def __init__(self, path: Path, camera: Camera, jpeg_quality: int) -> None:
        super().__init__(path, camera, jpeg_quality)
        self.depth_view = self.smaller_depth()
        self.files: dict[str, bytes] = {}

    def write_images(self, stamp_ns: int, rgb: NDArray[np.uint8], depth_m: NDArray[np.float32]) -> None:
        self.put_images(len(self.poses), encode_jpeg(rgb, self._jpeg_quality), depth_m)
        self.poses.append(_Y_UP_FROM_Z_UP @ self._pose @ _OPENGL)
        self.stamps_ns.append(stamp_ns)

    def put_images(self, i: int, jpeg: bytes, depth_m: NDArray[np.float32]) -> None:
        self.files[f"EXR_RGBD/rgb/{i}.jpg"], self.files[f"EXR_RGBD/depth/{i}.exr"] = jpeg, exr_bytes(depth_m)

    def finish(self) -> None:
        camera, start = self._camera, self.poses[0] if self.begins_at_identity else np.eye(4)
        assert self.depth_view is not None
        table = {
            "w": camera.width, "h": camera.height, "fps": 60, "K": camera.K.T.ravel().tolist(),
            "dw": self.depth_view.camera.width, "dh": self.depth_view.camera.height, "initPose": _row(start),
            "poses": [_row(invert(start) @ pose) for pose in self.poses],
            "perFrameIntrinsicCoeffs": [[camera.fx, camera.fy, camera.cx, camera.cy] for _ in self.poses],
            "frameTimestamps": [(stamp_ns - self.stamps_ns[0]) / 1e9 for stamp_ns in self.stamps_ns],
        }  # fmt: skip
        self.files[self.metadata] = dumps(table).encode()
        self.write()

    def write(self) -> None:
        for name, data in self.files.items():
            (self._folder / name).parent.mkdir(parents=True, exist_ok=True)
            (self._folder / name).write_bytes(data)


class Record3dLog(Record3dExport):
    """An `.r3d` file of an older version: poses begin at the identity; confidence is low in the first rows."""

    ending, metadata, begins_at_identity = ".r3d", "metadata", True
    unsure_rows = 4

    def put_images(self, i: int, jpeg: bytes, depth_m: NDArray[np.float32]) -> None:
        import lzfse

        sure = np.full(depth_m.shape, 2, dtype=np.uint8)
        sure[: self.unsure_rows] = 0
        self.files[f"rgbd/{i}.jpg"] = jpeg
        self.files[f"rgbd/{i}.depth"] = lzfse.compress(depth_m.astype("<f4").tobytes())
        self.files[f"rgbd/{i}.conf"] = lzfse.compress(sure.tobytes())

    def write(self) -> None:
        with zipfile.ZipFile(self._folder, "w") as archive:
            for name, data in self.files.items():
                archive.writestr(name, data)


class ViewerBag(ContainerLog):
    """A viewer's bag: no poses, log times from zero, a unit of depth behind each image that no definition has."""

    ending, lag_ns, unit_m, version = ".bag", 4_000_000, 1e-4, "1"

    def __init__(self, path: Path, camera: Camera, jpeg_quality: int) -> None:
        super().__init__(path, camera, jpeg_quality)
        self.bag, self.start_ns = Ros1Bag(path), 0
        self.messages = self.bag.messages

    def write_static(self, stamp_ns: int) -> None:
        m, self.start_ns = self.messages, stamp_ns
        self.put("/file_version", 1, m.make("std_msgs/msg/UInt32", data=4))
        self.put("/device_0/sensor_0/option/Depth Units/value", 1, m.make("std_msgs/msg/Float32", data=self.unit_m))
        for stream, camera, stream_from_reference in (
            ("sensor_0/Depth_0", self.depth_camera, np.eye(4)),
            ("sensor_1/Color_0", self._camera, COLOR_FROM_DEPTH),
        ):
            info = m.camera_info(0, "", camera, "Brown Conrady", 5)
            info.R, info.P = np.zeros(9), np.zeros(12)
            self.put(f"/device_0/{stream}/info/camera_info", 1, info)
            link = m.tf(0, ("", "", stream_from_reference)).transforms[0].transform
            self.put(f"/device_0/{stream}/tf/0", 1, link)

    def write_images(self, stamp_ns: int, rgb: NDArray[np.uint8], depth_m: NDArray[np.float32]) -> None:
        depth = (stamp_ns + self.lag_ns, "sensor_0/Depth_0", "mono16", _units(depth_m, 1 / self.unit_m))
        for at_ns, stream, encoding, pixels in ((stamp_ns, "sensor_1/Color_0", "rgb8", rgb), depth):
            image = self.messages.image(at_ns, self.version, encoding, pixels)
            unit = struct.pack("<f", self.unit_m)
            self.put(f"/device_0/{stream}/image/data", at_ns - self.start_ns + 10**8, image, unit)

    def put(self, topic: str, log_ns: int, message: Any, more: bytes = b"") -> None:
        self.bag.put(topic, log_ns, message, more)

    def finish(self) -> None:
        self.bag.close()


CONTAINER_LOGS: dict[str, type[SensLog | Record3dExport | ViewerBag]] = {
    "scannet_sens": SensLog, "record3d": Record3dLog, "record3d_exr": Record3dExport, "realsense_viewer": ViewerBag,
}  # fmt: skip


def exr_bytes(image: NDArray[np.float32]) -> bytes:
    """Return an EXR image with one channel."""
    import OpenEXR

    stream = io.BytesIO()
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION}, {"R": np.ascontiguousarray(image)}).write(stream)
    return stream.getvalue()


def _units(depth_m: NDArray[np.float32], units_per_m: float) -> NDArray[np.uint16]:
    units = np.nan_to_num(depth_m * units_per_m, nan=0.0, posinf=0.0, neginf=0.0).round()
    return np.where(units < 65535, units, 0).astype("<u2")


def _row(a_from_b: NDArray[np.float64]) -> list[float]:
    return [*quaternion_from_rotation(a_from_b[:3, :3]).tolist(), *a_from_b[:3, 3].tolist()]
