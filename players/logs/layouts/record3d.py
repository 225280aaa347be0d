"""Recordings of the iPhone app Record3D: `.r3d` files (ZIP), unpacked ones, and exports as EXR (or PNG) and JPEG.

Poses are camera-to-world in OpenGL axes (x right, y up, z back), the world is y up; K is stored by columns.
Intrinsics are those of the `w` x `h` image of the metadata, whatever size the JPEGs and the depth have.
"""

import importlib
import io
import json
import math
import re
from collections import defaultdict
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import CalibrationError, RecordingError
from hickory_stream.geometry.camera import MOST_SIDE_PX
from hickory_stream.geometry.rigid import compose
from players.logs.layouts.file_parts import FilePart, ImageFile, members_of, read_image_file
from players.logs.layouts.folder import FolderSource, FolderView
from players.logs.layouts.folder_text import resized
from players.logs.layouts.frame_collector import FrameCollector, Pose, sizes_of
from players.messages.depth_registration import Registration
from players.messages.image_decoding import MAX_PIXELS, decode_depth_png
from players.options import SourceOptions
from players.poses.interpolation import is_pose_row, pose_of_row
from players.profile import Intrinsics, load_profile

_METADATA = re.compile(r"(.*/)?metadata(\.json)?")
_IMAGE = re.compile(r"(rgbd|rgb|depth)/(\d{1,7})\.(jpg|jpeg|png|depth|exr|conf)")
_PACKAGES = {".depth": "lzfse", ".exr": "OpenEXR"}
_CAMERA_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
_CAMERA_UP = (0.0, -1.0, 0.0)
_SAME = 1e-6


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Metadata:
    size: tuple[int, int]
    depth_size: tuple[int, int] | None
    intrinsics: Intrinsics
    frame_intrinsics: tuple[Intrinsics, ...]
    poses: tuple[Pose, ...]
    #: Whether the world of the poses is y up; else it is the first camera's.
    is_y_up: bool
    stamps_ns: tuple[int, ...]
    rate_hz: float


def open_record3d(path: Path, options: SourceOptions) -> FolderSource:
    """Return the source of an `.r3d` file or a folder of Record3D; the profile (default: record3d) has the noise.

    Depth of low confidence is no return. Videos of the front camera have no poses.

    Raises `RecordingError`: the archive or its metadata is damaged, there is no usable frame, or the package that
    unpacks the depth is not installed; `CalibrationError`: the metadata has no intrinsics.
    """
    files: dict[str, ImageFile] = dict(members_of(path)) if path.is_file() else _files_of(path)
    names = sorted((name for name in files if _METADATA.fullmatch(name)), key=lambda name: (name.count("/"), name))
    if not names:
        raise RecordingError(f"{path} has no metadata of Record3D; found {', '.join(sorted(files)[:5]) or 'nothing'}")
    metadata, root = files[names[0]], names[0].rpartition("metadata")[0]
    info = _read_metadata(metadata)
    images: dict[str, dict[int, ImageFile]] = defaultdict(dict)
    streams: dict[str, str] = {}
    for name, file in files.items():
        hit = _IMAGE.fullmatch(name.removeprefix(root)) if name.startswith(root) else None
        if hit is not None:
            is_depth = hit[1] == "depth" or hit[3] in ("depth", "exr")
            role = "conf" if hit[3] == "conf" else "depth" if is_depth else "color"
            images[role][int(hit[2])] = file
            streams[role] = f"{root}{hit[1]}/*.{hit[3]}"
    colors, depths = images["color"], images["depth"]
    if not colors or not depths:
        raise RecordingError(f"{path} has {len(colors)} colour and {len(depths)} depth images")
    for suffix in {Path(str(file)).suffix for file in depths.values()} & _PACKAGES.keys():
        _package(_PACKAGES[suffix], path)
    sizes = (
        sizes_of((color, color) for color in colors.values())[0],
        info.depth_size or _derived_size(path, depths, info.size),
    )
    profile, rough_up = load_profile(options.profile or "record3d"), None if info.is_y_up else _CAMERA_UP
    found = FrameCollector(path, profile, options, rough_up=rough_up, is_y_up=info.is_y_up)
    has_stamps = len(info.stamps_ns) > max(colors)
    for i in sorted(colors.keys() | depths.keys()):
        depth = depths.get(i)
        if depth is not None:
            file = depth.file if isinstance(depth, FilePart) else depth
            read = partial(_depth_bytes, depth, images["conf"].get(i))
            depth = FilePart(file=file, name=f"depth {i}", read=read)
        stamp_ns = info.stamps_ns[i] if has_stamps else round(i * 1e9 / info.rate_hz)
        found.add(
            stamp_ns, colors.get(i), depth, info.poses[i] if i < len(info.poses) else None, _view(info, i, *sizes)
        )
    return found.source(
        kind="Record3D",
        depth_intrinsics=None,
        streams={
            **streams,
            "camera_info": f"{names[0]}, {'each frame its own' if info.frame_intrinsics else 'one for all frames'}",
            "pose": names[0],
            "stamps": names[0] if has_stamps else f"number of the frame / {info.rate_hz:g} Hz",
        },
        text_files=[metadata] if isinstance(metadata, Path) else [],
    )


def _files_of(folder: Path) -> dict[str, ImageFile]:
    return {file.relative_to(folder).as_posix(): file for file in sorted(folder.rglob("*")) if file.is_file()}


def _read_metadata(file: ImageFile) -> _Metadata:
    try:
        table = json.loads(read_image_file(file))
        size, depth_size = (table["w"], table["h"]), (table.get("dw"), table.get("dh"))
        for sides in (size, size if None in depth_size else depth_size):
            if (
                not all(type(side) is int and 0 < side <= MOST_SIDE_PX for side in sides)
                or math.prod(sides) > MAX_PIXELS
            ):
                raise ValueError(f"images of {sides[0]}x{sides[1]} pixels")
        poses, is_y_up = _poses([_row(values) for values in table.get("poses") or ()], table.get("initPose"))
        rate_hz = float(table.get("fps") or 60)
        stamps_ns = [round(float(stamp) * 1e9) for stamp in table.get("frameTimestamps") or ()]
        if not 0.1 <= rate_hz <= 1000:
            raise ValueError(f"{rate_hz:g} frames per second")
        k = [float(value) for value in table["K"]]
        # By columns; some programs that write this format use rows.
        cx, cy = (k[6], k[7]) if k[6] or k[7] else (k[2], k[5])
        return _Metadata(
            size=size,
            depth_size=None if None in depth_size else depth_size,
            intrinsics=_intrinsics(k[0], k[4], cx, cy),
            frame_intrinsics=tuple(_intrinsics(*row[:4]) for row in table.get("perFrameIntrinsicCoeffs") or ()),
            poses=poses,
            is_y_up=is_y_up,
            stamps_ns=tuple(stamps_ns) if all(0 <= a < b < 2**62 for a, b in pairwise(stamps_ns)) else (),
            rate_hz=rate_hz,
        )
    except (ValueError, TypeError, LookupError, AttributeError, OverflowError, RecursionError) as error:
        raise CalibrationError(f"{file}: {error!r:.120}; expected JSON of Record3D with w, h, K and poses") from error


def _intrinsics(fx: float, fy: float, cx: float, cy: float) -> Intrinsics:
    return Intrinsics(fx=float(fx), fy=float(fy), cx=float(cx), cy=float(cy))


def _row(values: Any) -> list[float] | None:
    qx, qy, qz, qw, x, y, z = (float(value) for value in values)
    row = [x, y, z, qx, qy, qz, qw]
    return row if is_pose_row(row) else None


def _poses(rows: list[list[float] | None], first: Any) -> tuple[tuple[Pose, ...], bool]:
    # In older versions of the app poses begin at the identity; some of them have the first pose beside it.
    if len({tuple(row) for row in rows if row is not None}) <= 1 < len(rows):
        return (), True  # The front camera is not tracked.
    start, is_y_up = np.eye(4), True
    if rows and rows[0] is not None and np.abs(pose_of_row(np.array(rows[0])) - start).max() < _SAME:
        row = _row(first) if first else None
        start = start if row is None else pose_of_row(np.array(row))
        is_y_up = bool(np.abs(start - np.eye(4)).max() >= _SAME)
    poses = (None if row is None else compose(start, pose_of_row(np.array(row)), _CAMERA_FROM_OPENGL) for row in rows)
    return tuple(poses), is_y_up


def _view(info: _Metadata, i: int, color_size: tuple[int, int], depth_size: tuple[int, int]) -> FolderView:
    of = info.frame_intrinsics[i] if i < len(info.frame_intrinsics) else info.intrinsics
    depth, color = (resized(of, info.size, size).camera(size) for size in (depth_size, color_size))
    return FolderView(
        registration=Registration(depth_camera=depth, color_camera=color, color_from_depth=np.eye(4)),
        depth_units_per_m=1.0,
        decode_depth=partial(_metres, shape=(depth_size[1], depth_size[0])),
    )


def _derived_size(path: Path, depths: dict[int, ImageFile], size: tuple[int, int]) -> tuple[int, int]:
    # Older versions do not state the size of depth, which has the shape of colour.
    number = len(_depth_bytes(next(iter(depths.values())), None)) // 4
    width = max(1, round(math.sqrt(number * size[0] / size[1])))
    if number == 0 or number % width:
        raise CalibrationError(f"{path}: {number} pixels of depth have no size (dw, dh), nor the shape of colour")
    return width, number // width


def _depth_bytes(depth: ImageFile, confidence: ImageFile | None) -> bytes:
    # float32 metres; NaN where the confidence is low (0 of 0, 1, 2).
    metres = _values(depth, "<f4")
    if confidence is not None:
        sure = _values(confidence, "u1")
        metres = np.where(sure > 0, metres, np.float32(np.nan)) if sure.size == metres.size else metres
    return metres.astype("<f4").tobytes()


def _metres(data: bytes, what: str, *, shape: tuple[int, int]) -> NDArray[np.float32]:
    if len(data) != 4 * shape[0] * shape[1]:
        raise RecordingError(f"{what} has {len(data) // 4} pixels; expected {shape[1]}x{shape[0]}")
    metres = np.frombuffer(data, dtype="<f4").reshape(shape)
    return np.where(np.isfinite(metres) & (metres > 0), metres, np.float32(np.nan))


def _values(file: ImageFile, dtype: str) -> NDArray[Any]:
    # All pixels of an image in one row. Some programs that write this format do not compress.
    data, what = read_image_file(file), str(file)
    if what.endswith(".png"):
        return decode_depth_png(data, 1000.0, what).ravel()
    if what.endswith(".exr"):
        exr = _package("OpenEXR", what)
        exr.setMaxImageSize(*(math.isqrt(MAX_PIXELS),) * 2)
        try:
            (channel, *_) = exr.File(io.BytesIO(data), separate_channels=True).channels().values()
        except (ValueError, RuntimeError, TypeError, MemoryError) as error:
            raise RecordingError(f"{what} is no EXR image, or damaged: {error}") from error
        return np.asarray(channel.pixels, dtype=np.float32).ravel()
    if data.startswith(b"bvx"):
        lzfse = _package("lzfse", what)
        try:
            data = lzfse.decompress(data)
        except (lzfse.error, MemoryError) as error:
            raise RecordingError(f"{what} is damaged: LZFSE cannot unpack it") from error
    return np.frombuffer(data, dtype=dtype, count=len(data) // np.dtype(dtype).itemsize)


def _package(name: str, what: object) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        other = "EXR + JPEG" if name == "lzfse" else ".r3d"
        way_out = f"pip install {name.lower()}, or export {other} from the app"
        raise RecordingError(f"{what} needs the package {name}, which is not installed: {way_out}") from error
