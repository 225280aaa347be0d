"""`hickory-stream segment`: draw the masks and features of one frame."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hickory_stream.cli.option_values import read_settings
from hickory_stream.cli.output_files import add_output, write_picture
from hickory_stream.errors import CalibrationError, ConfigError, InputError, RecordingError
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse

    import numpy as np
    from numpy.typing import NDArray

    from hickory_stream.cli.commands import Commands
    from hickory_stream.geometry.camera import Camera
    from hickory_stream.records import Frame
    from players.profile import Profile

_NO_FLOOR = (
    "no floor is in view, so that pieces of floor, walls and tables may count as objects. Unless the camera is level, "
    "give the direction down with --down X,Y,Z, e.g. --down 0,1,1 for a camera that looks down by 45 degrees"
)


def add(commands: Commands) -> None:
    segment = commands.add("segment", run, configured=True)
    segment.add_argument("image", type=Path, metavar="IMAGE", help="colour or grey, JPEG or PNG")
    segment.add_argument("depth", type=Path, metavar="DEPTH", help="16-bit PNG, 0 = no return, or .npy in metres")
    add_output(segment, "-o", "--out", type=Path, default=Path("segments.png"), metavar="PNG")
    segment.add_argument("--intrinsics", metavar="FX,FY,CX,CY", help="in pixels; default: a camera of 60 degrees")
    segment.add_argument(
        "--profile", help="depth unit, cameras and registration of a kind of log; --intrinsics are then of depth"
    )
    segment.add_argument(
        "--depth-units", type=float, default=None, metavar="N", help="depth units per metre; default 1000"
    )
    segment.add_argument(
        "--down",
        default="0,1,0",
        metavar="X,Y,Z",
        help="down direction in the camera (x right, y down, z forward); default: level",
    )


def run(options: argparse.Namespace) -> int:
    import numpy as np

    from hickory_stream.engine.reading import sensed
    from hickory_stream.perception.choose import make_extractor, make_segmenter
    from hickory_stream.perception.perceive import perceive
    from hickory_stream.pictures.show_perception import segmentation_picture

    settings = read_settings(options).mapper
    config = settings.perception
    frame = sensed(_frame(options), 0, settings.sensor)
    segmenter, extractor = make_segmenter(config), make_extractor(config)
    perceived = perceive(frame, None, segmenter.prepare(frame), segmenter, config, lattice=settings.mapping.voxels)
    patches = extractor.extract(np.asarray(frame.rgb))
    picture = segmentation_picture(frame.rgb, perceived.segmentation, perceived.rejected, patches)
    write_picture(options.out, picture)
    masks, floor_z_m = int(perceived.segmentation.instances.max(initial=0)), perceived.segmentation.floor_z_m
    if options.json:
        report: dict[str, Any] = {"picture": str(options.out), "masks": masks, "objects": len(perceived.observations)}
        report["floor_below_m"] = None if floor_z_m is None else -floor_z_m
        report["rejected"] = [{"box_px": r.box_px, "reason": r.reason} for r in perceived.rejected]
        print(output("segment", report))
    else:
        counts = f"{masks} masks, {len(perceived.observations)} objects, {len(perceived.rejected)} rejected"
        print(
            f"{options.out}: {counts}" + ("" if floor_z_m is None else f", floor {-floor_z_m:.2f} m below the camera")
        )
        if floor_z_m is None:
            sys.stderr.write(f"note: {_NO_FLOOR}\n")
    return 0


def _frame(options: argparse.Namespace) -> Frame:
    import numpy as np

    from hickory_stream.geometry.depth_sensor import DepthSensor
    from hickory_stream.records import Frame
    from players.messages.depth_registration import Registration, register_depth
    from players.profile import load_profile

    profile = load_profile(options.profile) if options.profile is not None else None
    rgb = _read_color(options.image)
    units = options.depth_units
    if units is None:
        units = profile.depth_units_per_m if profile is not None else 1000.0
    sensor = profile.sensor if profile is not None else DepthSensor()
    depth = sensor.returns(_read_depth(options.depth, units))
    height, width = rgb.shape[:2]
    given = _camera(options.intrinsics, width, height) if options.intrinsics is not None else None
    camera = given or _camera_of_60_degrees(width, height)
    if profile is not None and profile.color is not None:
        camera = profile.color.camera((width, height))
        color_from_depth = np.eye(4)
        color_from_depth[:3, 3] = profile.color_from_depth_m
        registration = Registration(
            depth_camera=_depth_camera(options, profile, depth.shape[1], depth.shape[0]),
            color_camera=camera,
            color_from_depth=color_from_depth,
        )
        depth = register_depth(depth, registration)
    if depth.shape != (height, width):
        raise InputError(
            f"{options.image} is of {width} x {height} pixels, {options.depth} of {depth.shape[1]} x {depth.shape[0]}; "
            "they must be registered, pixel by pixel"
        )
    return Frame(
        index=0,
        stamp_ns=0,
        rgb=rgb,
        depth_m=depth,
        camera=camera,
        world_from_camera=_upright(np.array(_numbers(options.down, 3, "--down", "X,Y,Z"))),
        sensor=sensor,
    )


def _depth_camera(options: argparse.Namespace, profile: Profile, width: int, height: int) -> Camera:
    from players.logs.layouts.folder_text import read_intrinsics
    from players.logs.layouts.plain_folders import INTRINSICS

    if options.intrinsics is not None:
        return _camera(options.intrinsics, width, height)
    beside = options.depth.parent / INTRINSICS
    # Without an offset between the cameras, depth is registered to colour and has its camera.
    own = profile.depth or (profile.color if not any(profile.color_from_depth_m) else None)
    intrinsics = read_intrinsics(beside) if beside.is_file() else own
    if intrinsics is None:
        raise CalibrationError(
            f"profile {profile.name}: its depth camera differs from its colour camera; give --intrinsics of depth"
        )
    if not (intrinsics.cx < width and intrinsics.cy < height):
        raise CalibrationError(
            f"profile {profile.name}: its depth camera has not {width} x {height} pixels; give --intrinsics of depth"
        )
    return intrinsics.camera((width, height))


def _camera(text: str, width: int, height: int) -> Camera:
    from hickory_stream.geometry.camera import Camera

    fx, fy, cx, cy = _numbers(text, 4, "--intrinsics", "FX,FY,CX,CY")
    try:
        return Camera(width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy)
    except ValueError as error:
        raise ConfigError(f"--intrinsics: {error}") from error


def _camera_of_60_degrees(width: int, height: int) -> Camera:
    from math import radians, tan

    from hickory_stream.geometry.camera import Camera

    focal = width / 2 / tan(radians(30))
    return Camera(width=width, height=height, fx=focal, fy=focal, cx=(width - 1) / 2, cy=(height - 1) / 2)


def _read_color(path: Path) -> NDArray[np.uint8]:
    import cv2
    import numpy as np

    image = cv2.imdecode(np.frombuffer(_bytes_of(path), dtype=np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise RecordingError(f"{path} is no readable image; expected JPEG or PNG")
    return np.ascontiguousarray(image[..., ::-1])


def _read_depth(path: Path, units_per_m: float) -> NDArray[np.float32]:
    import cv2
    import numpy as np

    if not units_per_m > 0:
        raise ConfigError(f"found --depth-units {units_per_m:g}, expected a number above 0")
    if path.suffix == ".npy":
        try:
            depth = np.load(path, allow_pickle=False)
        except (OSError, ValueError) as error:
            raise RecordingError(f"{path} cannot be read: {error}") from error
        if depth.ndim != 2 or depth.dtype.kind != "f":
            raise RecordingError(f"{path} holds {depth.dtype} of shape {depth.shape}; expected metres, (H, W) float")
        metres = depth.astype(np.float32)
    else:
        image = cv2.imdecode(np.frombuffer(_bytes_of(path), dtype=np.uint8), cv2.IMREAD_UNCHANGED)
        if image is None or image.ndim != 2 or image.dtype != np.uint16:
            found = "no image" if image is None else f"{image.dtype} of shape {image.shape}"
            raise RecordingError(f"{path} is {found}; expected depth as a 16-bit PNG of one channel")
        metres = image.astype(np.float32) / np.float32(units_per_m)
        metres[image == 65535] = np.nan
    metres[~(metres > 0) | ~np.isfinite(metres)] = np.nan
    return np.asarray(metres, dtype=np.float32)


def _bytes_of(path: Path) -> bytes:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise RecordingError(f"cannot read {path}: {error.strerror}") from error
    if not data:
        raise RecordingError(f"{path} is empty")
    return data


def _numbers(text: str, count: int, option: str, form: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        raise ConfigError(f"found {option} {text}, expected {form}")
    return numbers


def _upright(down_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return world_from_camera (4, 4) of a camera at the origin of a z-up world, from the down direction."""
    import numpy as np

    length = float(np.linalg.norm(down_camera))
    if not 0 < length < np.inf:
        raise ConfigError(f"found --down {down_camera.tolist()}, expected a direction")
    up = -down_camera / length
    forward = np.array([0.0, 0.0, 1.0]) if abs(up[2]) < 0.99 else np.array([0.0, -1.0, 0.0])
    y = forward - up * (forward @ up)
    y /= np.linalg.norm(y)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([np.cross(y, up), y, up])
    return pose
