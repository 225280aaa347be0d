"""Readers of ICL-NUIM, ARKitScenes, Open3D and Redwood, nerfstudio, and the exported folders of ScanNet."""

import json
from collections.abc import Mapping
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Any

import numpy as np

from hickory_stream.base.json_text import dumps
from hickory_stream.errors import CalibrationError, NoPosesError, RecordingError
from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import compose, from_rotation_translation, invert, rotation_of_vector
from players.logs.layouts.folder import FolderSource, FolderView
from players.logs.layouts.folder_text import (
    expecting,
    intrinsics_of,
    read_intrinsics,
    read_numbers,
    read_pose_file,
    read_stamped_rows,
    read_text,
    resized,
    rigid_of,
)
from players.logs.layouts.frame_collector import FrameCollector, Pose, Sizes, by_number, color_files, is_there, sizes_of
from players.messages.calibration import Lens
from players.options import DEFAULT_MAX_POSE_GAP_NS, SourceOptions
from players.poses.interpolation import is_pose_row, pose_of_row, row_of_pose, track_of
from players.profile import Intrinsics, load_profile

_ARKIT_TOLERANCE_NS, _MOST_TURN_RAD = 5_000_000, 100.0
# So many images of ICL-NUIM may come before the first pose.
_MOST_LATE = 2
# ICL-NUIM's cameras and world are left-handed, y up, which its negative fy makes good for. Mirrored both, they are the
# optical axes (y down), and a right-handed world with z up.
_UPRIGHT_FROM_ICL = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
_ICL_FROM_OPTICAL = np.diag([1.0, -1.0, 1.0, 1.0])
# OpenGL's camera (y up, looking along -z), as nerfstudio has it.
_GL_FROM_OPTICAL = np.diag([1.0, -1.0, -1.0, 1.0])
_DISTORTIONS = ("k1", "k2", "p1", "p2", "k3"), ("k1", "k2", "k3", "k4")
_CALIBRATION = frozenset("camera_model w h fl_x fl_y cx cy camera_angle_x k1 k2 k3 k4 p1 p2".split())
_PINHOLES = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV_FISHEYE")


def open_icl_nuim(folder: Path, options: SourceOptions) -> FolderSource:
    """Return the source of ICL-NUIM's PNGs (`rgb/`, `depth/`) with `*.gt.sim` (3x4 matrices) or `*.gt.freiburg` (TUM).

    The first file is of the whole room, the second of the first camera; its stamps are numbers of images.
    """
    profile = load_profile(options.profile or "icl_nuim")
    if profile.color is None:
        raise CalibrationError(f"the profile {profile.name} has no intrinsics; ICL-NUIM's folders have none either")
    colors, depths = color_files(folder / "rgb"), by_number((folder / "depth").glob("*.png"))
    file = next((file for ending in ("sim", "freiburg") for file in sorted(folder.glob(f"*.gt.{ending}"))), None)
    if file is None:
        raise RecordingError(f"{folder} has no *.gt.sim and no *.gt.freiburg")
    icl_from_camera: dict[int, Pose] = {}
    if file.suffix == ".sim":
        numbers = read_numbers(file)
        late = max(0, max(colors, default=0) + 1 - numbers.size // 12)
        if numbers.size % 12 or late > _MOST_LATE:
            expected = f"expected 12 for each of {len(colors)} images"
            raise RecordingError(f"{file} is torn: {numbers.size} numbers; {expected}")
        icl_from_camera = {i: rigid_of(row) for i, row in enumerate(numbers.reshape(-1, 12), start=late)}
    else:
        with expecting(file, "rows of: number tx ty tz qx qy qz qw"):
            for stamp_ns, words in read_stamped_rows(file, 8):
                row = [float(word) for word in words[:7]]
                pose = pose_of_row(np.array(row)) if is_pose_row(row) else None
                icl_from_camera[stamp_ns // 1_000_000_000] = pose
    poses = {
        number: None if pose is None else compose(_UPRIGHT_FROM_ICL, pose, _ICL_FROM_OPTICAL)
        for number, pose in icl_from_camera.items()
    }
    found = FrameCollector(folder, profile, options)
    found.add_numbered(colors, depths, poses)
    return found.source(
        kind="ICL-NUIM folder",
        depth_intrinsics=profile.color,
        streams=("rgb/*", "depth/*.png", f"profile {profile.name}", f"{file.name}, mirrored", found.clock),
        text_files=[file],
    )


def open_arkit_scenes(folder: Path, options: SourceOptions) -> FolderSource:
    """Return the source of a video of ARKitScenes: `lowres_wide/`, `lowres_depth/`, `lowres_wide.traj` and `.pincam`.

    Names end in seconds. Poses of the .traj are camera_from_world as angle-axis, at 10 Hz; each image has intrinsics.
    """
    frames = next(iter(sorted(folder.glob("*_frames"))), folder)
    profile = load_profile(options.profile or "arkit_scenes")
    colors, depths, pincams = (
        _by_stamp(frames / name, ending)
        for name, ending in (("lowres_wide", "png"), ("lowres_depth", "png"), ("lowres_wide_intrinsics", "pincam"))
    )
    trajectory = frames / "lowres_wide.traj"
    if not trajectory.is_file() and not options.estimates_poses:
        raise NoPosesError(f"{frames} has no lowres_wide.traj; --odometry depth estimates poses")
    if not pincams:
        raise CalibrationError(f"{frames} has no lowres_wide_intrinsics/*.pincam")
    stamps_ns, rows = [], []
    for stamp_ns, words in read_stamped_rows(trajectory, 7) if trajectory.is_file() else ():
        with expecting(trajectory, "rows of: stamp, angle-axis, translation"):
            row = np.array([float(word) for word in words[:6]])
        if np.isfinite(row).all() and np.abs(row[:3]).max() < _MOST_TURN_RAD:
            world_from_camera = invert(from_rotation_translation(rotation_of_vector(row[:3]), row[3:]))
            stamps_ns.append(stamp_ns)
            rows.append(row_of_pose(world_from_camera))
    track = track_of(stamps_ns, rows, options.max_pose_gap_ns or DEFAULT_MAX_POSE_GAP_NS)
    found = FrameCollector(folder, profile, options)
    sizes: Sizes | None = None
    known_ns = np.array([stamp_ns for stamp_ns, _ in pincams])

    def view_at(stamp_ns: int) -> FolderView:
        nonlocal sizes
        sizes = sizes or sizes_of(zip((file for _, file in colors), (file for _, file in depths), strict=False))
        file = pincams[int(np.abs(known_ns - stamp_ns).argmin())][1]
        with expecting(file, "width height fx fy cx cy", CalibrationError):
            width, height, fx, fy, cx, cy = read_numbers(file).tolist()
            of_file = Intrinsics(fx=fx, fy=fy, cx=cx, cy=cy), (int(width), int(height))
            return found.view(
                sizes, profile.depth_units_per_m, resized(*of_file, sizes[1]), resized(*of_file, sizes[0])
            )

    tolerance_ns = _ARKIT_TOLERANCE_NS if options.sync_tolerance_ns is None else options.sync_tolerance_ns
    found.add_stamped(colors, depths, tolerance_ns, lambda ns: None if track is None else track.at(ns), view_at)
    return found.source(
        kind="ARKitScenes folder",
        depth_intrinsics=None,
        streams=("lowres_wide/*", "lowres_depth/*", "*.pincam", trajectory.name, "names of files"),
        text_files=[file for file in (trajectory, *(file for _, file in pincams)) if file.is_file()],
        pose_span_ns=None if track is None else track.span_ns,
    )


def open_open3d(folder: Path, options: SourceOptions) -> FolderSource:
    """Return the source of Open3D's and Redwood's layout: `color/`, `depth/`, a `trajectory.log`, intrinsics as JSON.

    The log names images by their place. Without intrinsics they are the profile's: PrimeSense's.
    """
    profile = load_profile(options.profile or "open3d")
    color = next(name for name in ("color", "image", "rgb") if (folder / name).is_dir())
    colors, depths = color_files(folder / color), by_number((folder / "depth").glob("*.png"))
    log = next((file for part in OPEN3D_LOGS.split("|") for file in sorted(folder.glob(part))), None)
    if log is None and not options.estimates_poses:
        raise NoPosesError(f"{folder} has no trajectory.log; --odometry depth estimates poses")
    poses: dict[int, Pose] = {}
    numbers = sorted(colors.keys() | depths.keys())
    if log is not None:
        values = read_numbers(log)
        for block in values[: values.size // 19 * 19].reshape(-1, 19):
            if block[0] in range(len(numbers)):
                poses[numbers[int(block[0])]] = rigid_of(block[3:])
    intrinsics, units_per_m = profile.color, profile.depth_units_per_m
    file = next((file for part in OPEN3D_CAMERAS.split("|") for file in sorted(folder.glob(part))), None)
    if file is not None:
        with expecting(file, "intrinsic_matrix with nine numbers by columns", CalibrationError):
            table = json.loads(read_text(file))
            intrinsics = intrinsics_of(np.asarray(table["intrinsic_matrix"], dtype=np.float64).reshape(3, 3).T)
            units_per_m = float(table.get("depth_scale", units_per_m))
    if intrinsics is None:
        raise CalibrationError(f"{folder} has no *intrinsic*.json, and the profile {profile.name} has no intrinsics")
    found = FrameCollector(folder, profile, options, rough_up=(0.0, -1.0, 0.0))
    found.add_numbered(colors, depths, poses)
    streams = (
        f"{color}/*", "depth/*.png", file.name if file else f"profile {profile.name}", log.name if log else "none",
        found.clock,
    )  # fmt: skip
    return found.source(
        kind="Open3D folder",
        depth_intrinsics=intrinsics,
        depth_units_per_m=units_per_m,
        streams=streams,
        text_files=[part for part in (log, file) if part is not None],
    )


OPEN3D_CAMERAS = "*intrinsic*.json|camera_primesense.json"
OPEN3D_LOGS = "*trajectory*.log|scene/trajectory.log|*-traj.txt"


def open_nerfstudio(folder: Path, options: SourceOptions) -> FolderSource:
    """Return the source of a nerfstudio `transforms.json` whose frames have a `depth_file_path`.

    Intrinsics are of the file or of a frame. Depth shows the view of the image at any resolution.
    """
    file = folder / "transforms.json"
    profile = load_profile(options.profile or "nerfstudio")
    found = FrameCollector(folder, profile, options, rough_up=(0.0, -1.0, 0.0))
    with expecting(file, "frames with file_path, depth_file_path and transform_matrix"):
        table = json.loads(read_text(file))
        units_per_m = 1.0 / float(table.get("depth_unit_scale_factor", 1 / profile.depth_units_per_m))
        entries = sorted(
            ((folder / entry["file_path"], entry) for entry in table["frames"]), key=lambda pair: pair[0].name
        )
        depths = [folder / entry["depth_file_path"] if "depth_file_path" in entry else None for _, entry in entries]
        matrices = [np.asarray(entry["transform_matrix"], dtype=np.float64).ravel() for _, entry in entries]
    if not any(depths):
        raise RecordingError(f"{file}: no frame has a depth_file_path; depth is needed")
    numbered = by_number(color for color, _ in entries)
    numbers = {color: number for number, color in numbered.items()} if len(numbered) == len(entries) else {}
    views: dict[str, FolderView] = {}
    sizes: Sizes | None = None
    for i, ((color, entry), depth, matrix) in enumerate(zip(entries, depths, matrices, strict=True)):
        view = None
        if is_there(color) and is_there(depth):
            sizes = sizes or sizes_of((c, d) for (c, _), d in zip(entries, depths, strict=True) if d is not None)
            with expecting(file, f"fl_x, fl_y, cx, cy and a known camera_model for {color.name}", CalibrationError):
                calibration = {name: value for name, value in {**table, **entry}.items() if name in _CALIBRATION}
                key = dumps(calibration)
                view = views[key] = views.get(key) or _nerfstudio_view(found, calibration, sizes, units_per_m)
        rigid = rigid_of(matrix)
        pose = None if rigid is None else compose(rigid, _GL_FROM_OPTICAL)
        found.add(numbers.get(color, i) * 1_000_000_000 // profile.frame_rate_hz, color, depth, pose, view)
    return found.source(
        kind="nerfstudio folder",
        depth_intrinsics=None,
        streams=("file_path", "depth_file_path", file.name, file.name, found.clock),
        text_files=[file],
    )


def open_scannet(folder: Path, options: SourceOptions) -> FolderSource:
    """Return the source of a scene that ScanNet's tools exported: `color/`, `depth/`, `pose/`, `intrinsic/`.

    Colour has more pixels than depth. Poses are -inf where tracking was lost.
    """
    profile = load_profile(options.profile or "scannet")
    colors, depths = color_files(folder / "color"), by_number((folder / "depth").glob("*.png"))
    poses = by_number((folder / "pose").glob("*.txt"))
    parts = {name: folder / "intrinsic" / f"{name}.txt" for name in ("intrinsic_color", "intrinsic_depth")}
    extrinsics = []
    for name in ("extrinsic_color", "extrinsic_depth"):
        file = folder / "intrinsic" / f"{name}.txt"
        pose = read_pose_file(file) if file.is_file() else np.eye(4)
        if pose is None:
            raise CalibrationError(f"{file} holds no rigid transform (4x4)")
        extrinsics.append(pose)
    found = FrameCollector(folder, profile, options, color_from_depth=compose(invert(extrinsics[0]), extrinsics[1]))
    found.add_numbered(colors, depths, {number: read_pose_file(file) for number, file in poses.items()})
    return found.source(
        kind="ScanNet folder",
        depth_intrinsics=read_intrinsics(parts["intrinsic_depth"]),
        color_intrinsics=read_intrinsics(parts["intrinsic_color"]),
        streams=("color/*", "depth/*.png", "intrinsic/*.txt", "pose/*.txt", found.clock),
        text_files=[*parts.values(), *(poses[number] for number in sorted(poses))],
    )


def _by_stamp(folder: Path, ending: str) -> list[tuple[int, Path]]:
    # 42444949_76.123.png: 76.123 s
    stamped = []
    for file in sorted(folder.glob(f"*.{ending}")):
        try:
            stamped.append((int(Decimal(file.stem.rsplit("_", 1)[-1]) * 1_000_000_000), file))
        except (InvalidOperation, ValueError, OverflowError):
            continue
    return sorted(stamped)


def _nerfstudio_view(found: FrameCollector, table: Mapping[str, Any], sizes: Sizes, units_per_m: float) -> FolderView:
    model = table.get("camera_model", "OPENCV")
    if model not in _PINHOLES:
        raise ValueError(f"camera_model {model}")
    size = int(table.get("w", sizes[0][0])), int(table.get("h", sizes[0][1]))
    if "fl_x" in table:
        fx, fy = float(table["fl_x"]), float(table.get("fl_y", table["fl_x"]))
    else:
        half = float(table["camera_angle_x"]) / 2
        fx = fy = size[0] / 2 * float(portable.cos(half) / portable.sin(half))
    # There, the middle of the first pixel is at 0.5.
    cx, cy = (float(table.get(name, side / 2)) - 0.5 for name, side in zip(("cx", "cy"), size, strict=True))
    of_file = Intrinsics(fx=fx, fy=fy, cx=cx, cy=cy)
    view = found.view(sizes, units_per_m, resized(of_file, size, sizes[1]), resized(of_file, size, sizes[0]))
    is_fisheye = model == "OPENCV_FISHEYE"
    distortion = tuple(float(table.get(name, 0.0)) for name in _DISTORTIONS[is_fisheye])
    if not np.isfinite(distortion).all():
        raise ValueError(f"distortion {distortion}")
    if not any(distortion):
        return view
    cameras = view.registration.color_camera, view.registration.depth_camera
    color, depth = (Lens(camera, distortion, is_fisheye) for camera in cameras)
    return FolderView(registration=view.registration, depth_units_per_m=units_per_m, lenses=(color, depth))
