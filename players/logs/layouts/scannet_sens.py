"""ScanNet's `.sens` file: two cameras, then frames of pose, stamps, compressed colour and compressed depth.

By ScanNet's SensReader, poses are the depth camera's, all -inf where tracking was lost, and the extrinsics of depth
lead to colour. Many scans have no stamps, or a few random ones: the number of a frame then replaces them.
"""

import struct
import zlib
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import CalibrationError, RecordingError
from hickory_stream.geometry.rigid import compose, invert
from players.logs.layouts.file_parts import FilePart, span_of
from players.logs.layouts.folder import FolderSource, FolderView
from players.logs.layouts.folder_text import intrinsics_of
from players.logs.layouts.frame_collector import FrameCollector, Pose
from players.messages.depth_registration import Registration
from players.messages.image_decoding import MAX_PIXELS, metres_of_u16
from players.options import SourceOptions
from players.poses.interpolation import nearest_rigid
from players.profile import load_profile

_VERSION = 4
_NAME, _HEAD, _FRAME = struct.Struct("<IQ"), struct.Struct("<64f2i4IfQ"), struct.Struct("<16f4Q")
_COLORS, _DEPTHS = {1: "PNG", 2: "JPEG"}, {0: "raw", 1: "zlib"}
_MAX_NAME = 4096
_MAX_STEP_US = 10_000_000


class _Frame(NamedTuple):
    stamp_us: int
    world_from_depth: Pose
    color: FilePart | None
    depth: FilePart | None


def is_sens(magic: bytes) -> bool:
    """Return whether the first bytes of a file are those of a `.sens`: its version, then the length of a name."""
    return len(magic) >= _NAME.size and magic[:4] == _VERSION.to_bytes(4, "little") and not any(magic[6:12])


def open_sens(file: Path, options: SourceOptions) -> FolderSource:
    """Return the source of a `.sens` file; the profile (default: scannet) has the noise of depth.

    Raises `RecordingError`: the header is damaged, or there is no usable frame; `CalibrationError`: no intrinsics.
    """
    profile, num_bytes = load_profile(options.profile or "scannet"), file.stat().st_size
    with file.open("rb") as stream:
        view, declared = _read_head(stream, file)
        frames = _read_frames(stream, file, num_bytes, declared)
        place = stream.tell()
    found = FrameCollector(file, profile, options, color_from_depth=view.registration.color_from_depth)
    flaws = []
    if len(frames) < declared:
        # A damaged count may be larger than all that fits into the file.
        found.lose(min(declared - len(frames), num_bytes // _FRAME.size))
        flaws.append(f"{file.name} is cut off or damaged at byte {place}, after {len(frames)} of {declared} frames")
    elif declared == 0:
        flaws.append(f"{file.name} was not closed: it declares no frames, and has {len(frames)}")
    steps_us = [after.stamp_us - before.stamp_us for before, after in pairwise(frames)]
    has_stamps = bool(steps_us) and min(steps_us) > 0 and max(steps_us) <= _MAX_STEP_US and frames[-1].stamp_us < 2**52
    for i, frame in enumerate(frames):
        stamp_ns = frame.stamp_us * 1000 if has_stamps else i * 1_000_000_000 // profile.frame_rate_hz
        found.add(stamp_ns, frame.color, frame.depth, frame.world_from_depth, view)
    stamps = "of colour" if has_stamps else f"number of the frame / {profile.frame_rate_hz} Hz: no usable stamps"
    return found.source(
        kind="ScanNet .sens",
        depth_intrinsics=None,
        streams=("colour of frames", "depth of frames", "header", "pose of frames", stamps),
        text_files=[],
        flaws=flaws,
    )


def _read_head(stream: BinaryIO, file: Path) -> tuple[FolderView, int]:
    # The calibration, and the declared number of frames.
    try:
        version, name_bytes = _NAME.unpack(stream.read(_NAME.size))
        if version != _VERSION or name_bytes > _MAX_NAME:
            raise ValueError(f"version {version}, a name of {name_bytes} bytes")
        stream.seek(name_bytes, 1)
        *floats, color_kind, depth_kind, width, height, depth_width, depth_height, units, count = _HEAD.unpack(
            stream.read(_HEAD.size)
        )
        if not (0 < width * height <= MAX_PIXELS and 0 < depth_width * depth_height <= MAX_PIXELS):
            raise ValueError(f"images of {width}x{height} and {depth_width}x{depth_height} pixels")
        if not 1e-3 <= units <= 1e9:
            raise ValueError(f"{units:g} units of depth per metre")
        if color_kind not in _COLORS or depth_kind not in _DEPTHS:
            raise ValueError(f"compression {color_kind} and {depth_kind}; those of {_COLORS} and {_DEPTHS} are known")
    except (struct.error, ValueError) as error:
        raise RecordingError(
            f"{file}: the header of a ScanNet .sens (version {_VERSION}) is damaged: {error}"
        ) from error
    color_k, color_pose, depth_k, depth_pose = np.array(floats, dtype=np.float64).reshape(4, 4, 4)
    base_from_color, base_from_depth = nearest_rigid(color_pose), nearest_rigid(depth_pose)
    try:
        if base_from_color is None or base_from_depth is None:
            raise ValueError("its extrinsics are no rigid transforms")
        registration = Registration(
            depth_camera=intrinsics_of(depth_k).camera((depth_width, depth_height)),
            color_camera=intrinsics_of(color_k).camera((width, height)),
            color_from_depth=compose(invert(base_from_color), base_from_depth),
        )
    except ValueError as error:
        raise CalibrationError(f"{file}: the header of a ScanNet .sens is damaged: {error}") from error
    decode = partial(_metres, kind=depth_kind, shape=(depth_height, depth_width), units_per_m=units)
    return FolderView(registration=registration, depth_units_per_m=units, decode_depth=decode), count


def _read_frames(stream: BinaryIO, file: Path, end: int, declared: int) -> list[_Frame]:
    # A recording that was not closed declares none. The stream is left at the first frame that cannot be read.
    frames: list[_Frame] = []
    while len(frames) < declared or declared == 0:
        start = stream.tell()
        head = stream.read(_FRAME.size)
        *pose, stamp_us, _, color_bytes, depth_bytes = _FRAME.unpack(head.ljust(_FRAME.size, b"\0"))
        at, i = start + _FRAME.size, len(frames)
        if not 0 < color_bytes + depth_bytes <= end - at:
            stream.seek(start)
            break
        color = span_of(file, f"colour of frame {i}", at, color_bytes) if color_bytes else None
        depth = span_of(file, f"depth of frame {i}", at + color_bytes, depth_bytes) if depth_bytes else None
        frames.append(_Frame(stamp_us, nearest_rigid(np.array(pose).reshape(4, 4)), color, depth))
        stream.seek(at + color_bytes + depth_bytes)
    return frames


def _metres(data: bytes, what: str, *, kind: int, shape: tuple[int, int], units_per_m: float) -> NDArray[np.float32]:
    num_bytes = 2 * shape[0] * shape[1]
    if _DEPTHS[kind] == "zlib":
        try:
            data = zlib.decompressobj().decompress(data, num_bytes + 1)
        except zlib.error as error:
            raise RecordingError(f"{what} is damaged: {error}") from error
    if len(data) != num_bytes:
        raise RecordingError(f"{what} has {len(data)} bytes; expected {num_bytes} ({shape[1]}x{shape[0]})")
    return metres_of_u16(np.frombuffer(data, dtype="<u2").reshape(shape), units_per_m)
