"""Layouts of image folders: 7-Scenes, TUM RGB-D, Replica, HOPE, and `rgb/ depth/` with its text files.

The world is z up. `gravity-direction.txt` (the unit vector down) turns the log's world upright.
Without one, the log's z axis is taken to be up.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import CalibrationError, NoPosesError, RecordingError
from hickory_stream.geometry.rigid import compose, from_rotation_translation, invert
from players.logs import folder_text
from players.logs.folder import FolderContent, FolderFrame, FolderSource
from players.logs.synchronizer import Leftover, Stamped, default_tolerance_ns, pair_nearest
from players.messages.depth_registration import Registration
from players.messages.image_decoding import compressed_size
from players.options import DEFAULT_MAX_POSE_GAP_NS, NO_TOPIC, SourceOptions
from players.profile import Intrinsics, Profile, load_profile

INTRINSICS = "camera-intrinsics.txt"
CAM_PARAMS = "cam_params.json"
CAMERA_POSES = "camera_poses.txt"
TRAJECTORY = "traj.txt"
_COLOR_SUFFIXES = (".jpg", ".jpeg", ".png")


def open_seven_scenes(folder: Path, options: SourceOptions) -> FolderSource:
    """Return the source of `frame-NNNNNN.{color.jpg|color.png, depth.png, pose.txt}` with `camera-intrinsics.txt`.

    Intrinsics and poses are the depth camera's; the profile (default: seven_scenes) says where the colour camera is.
    A stamp is the number in the file's name divided by the profile's frame rate.
    """
    profile_name = options.profile or "seven_scenes"
    profile = load_profile(profile_name)
    depth_intrinsics = folder_text.read_intrinsics(folder / INTRINSICS)
    poses = _by_number(folder.glob("frame-*.pose.txt"))
    colors = _by_number(file for file in folder.glob("frame-*.color.*") if file.suffix in _COLOR_SUFFIXES)
    depths = _by_number(folder.glob("frame-*.depth.png"))
    found = _Collector(folder, profile, options)
    found.add_numbered(colors, depths, {i: folder_text.read_pose_file(file) for i, file in poses.items()})
    return found.source(
        kind="7-Scenes folder",
        depth_intrinsics=depth_intrinsics,
        color_intrinsics=profile.color,
        streams={
            "color": "frame-*.color.*",
            "depth": "frame-*.depth.png",
            "camera_info": f"{INTRINSICS}, profile {profile_name}",
            "pose": "frame-*.pose.txt",
            "stamps": found.clock,
        },
        text_files=[folder / INTRINSICS, *(poses[number] for number in sorted(poses))],
    )


def open_tum(folder: Path, options: SourceOptions) -> FolderSource:
    """Return the source of a TUM RGB-D folder: `rgb.txt`, `depth.txt` and `groundtruth.txt` with stamps in seconds.

    Colour is paired with the nearest depth; poses are interpolated at the stamps of the colour. Intrinsics are those of
    `camera-intrinsics.txt` if there is one, else of the profile (default: tum).
    """
    profile_name = options.profile or "tum"
    profile = load_profile(profile_name)
    files = {name: folder / f"{name}.txt" for name in ("rgb", "depth", "groundtruth")}
    missing = [files[name].name for name in ("rgb", "depth") if not files[name].is_file()]
    has_poses = files["groundtruth"].is_file() and options.pose_topic != NO_TOPIC
    if not has_poses and not missing and not options.estimates_poses:
        raise NoPosesError(
            f"{folder} looks like TUM RGB-D but has no groundtruth.txt; --odometry depth estimates poses"
        )
    if missing:
        raise RecordingError(f"{folder} looks like TUM RGB-D but has no {', '.join(missing)}")
    has_intrinsics = (folder / INTRINSICS).is_file()
    intrinsics = folder_text.read_intrinsics(folder / INTRINSICS) if has_intrinsics else profile.color
    if intrinsics is None:
        raise CalibrationError(f"{folder} has no {INTRINSICS} (3x3), and the profile {profile_name} has no intrinsics")
    images = {
        name: [(ns, folder / words[0]) for ns, words in folder_text.read_stamped_rows(files[name], 2)]
        for name in ("rgb", "depth")
    }
    tolerance_ns = options.sync_tolerance_ns
    if tolerance_ns is None:
        tolerance_ns = default_tolerance_ns(*([stamp_ns for stamp_ns, _ in rows] for rows in images.values()))
    track = None
    if has_poses:
        track = folder_text.read_tum_track(files["groundtruth"], options.max_pose_gap_ns or DEFAULT_MAX_POSE_GAP_NS)
    found = _Collector(folder, profile, options)
    stamped = [Stamped("color", *row) for row in images["rgb"]] + [Stamped("depth", *row) for row in images["depth"]]
    for match in pair_nearest(sorted(stamped, key=lambda image: image.stamp_ns), tolerance_ns):
        if isinstance(match, Leftover):
            is_color = match.stream == "color"
            found.add(match.stamp_ns, match.item if is_color else None, None if is_color else match.item, None)
        else:
            pose = track.at(match.stamp_ns) if track is not None else None
            found.add(match.stamp_ns, match.color, match.depth, pose)
    return found.source(
        kind="TUM RGB-D folder",
        depth_intrinsics=intrinsics,
        streams={
            "color": "rgb.txt",
            "depth": "depth.txt",
            "camera_info": INTRINSICS if has_intrinsics else f"profile {profile_name}",
            "pose": "groundtruth.txt" if has_poses else "none",
            "sync_tolerance": f"{tolerance_ns / 1e6:.1f} ms",
        },
        text_files=[file for file in files.values() if file.is_file()],
        pose_span_ns=track.span_ns if track is not None else None,
    )


def open_posed_folder(folder: Path, options: SourceOptions) -> FolderSource:
    """Return the source of `rgb/`, `depth/`, `cam_params.json` and `camera_poses.txt` (world_from_camera, a line each).

    Colour and depth are registered. Images are paired by name; images and poses are numbered in their order. A stamp is
    that number divided by the profile's frame rate (default: 30 Hz).
    """
    profile = load_profile(options.profile or "registered")
    for name in (CAM_PARAMS, CAMERA_POSES):
        if not (folder / name).is_file():
            error = CalibrationError if name == CAM_PARAMS else RecordingError
            raise error(f"{folder} has no {name}; the layout is rgb/, depth/, {CAM_PARAMS} and {CAMERA_POSES}")
    intrinsics, units_per_m = folder_text.read_cam_params(folder / CAM_PARAMS)
    poses = folder_text.read_pose_rows(folder / CAMERA_POSES)
    colors = _by_number(file for file in (folder / "rgb").glob("*") if file.suffix in _COLOR_SUFFIXES)
    depths = _by_number((folder / "depth").glob("*.png"))
    numbers = sorted(colors.keys() | depths.keys())
    if len(poses) != len(numbers):
        raise RecordingError(
            f"{folder}: {len(poses)} poses in {CAMERA_POSES} for {len(numbers)} images; expected as many"
        )
    found = _Collector(folder, profile, options)
    for i, (number, pose) in enumerate(zip(numbers, poses, strict=True)):
        found.add(i * 1_000_000_000 // profile.frame_rate_hz, colors.get(number), depths.get(number), pose)
    return found.source(
        kind="posed folder",
        depth_intrinsics=intrinsics,
        depth_units_per_m=units_per_m,
        streams={
            "color": "rgb/*",
            "depth": "depth/*.png",
            "camera_info": CAM_PARAMS,
            "pose": CAMERA_POSES,
            "stamps": f"order / {profile.frame_rate_hz} Hz",
        },
        text_files=[folder / CAM_PARAMS, folder / CAMERA_POSES],
    )


def open_replica(folder: Path, options: SourceOptions) -> FolderSource:
    """Return the source of a Replica folder: `results/frameN.jpg`, `results/depthN.png`, poses in `traj.txt`.

    Intrinsics and the depth's scale are those of a `cam_params.json` in the folder or above it, else of the profile.
    """
    profile = load_profile(options.profile or "replica")
    parameters = next((f for f in (folder / CAM_PARAMS, folder.parent / CAM_PARAMS) if f.is_file()), None)
    intrinsics, units_per_m = profile.color, profile.depth_units_per_m
    if parameters is not None:
        intrinsics, units_per_m = folder_text.read_cam_params(parameters)
    if intrinsics is None:
        raise CalibrationError(f"{folder} has no {CAM_PARAMS}, and the profile {profile.name} has no intrinsics")
    poses = folder_text.read_pose_rows(folder / TRAJECTORY)
    colors = _by_number(file for file in (folder / "results").glob("frame*") if file.suffix in _COLOR_SUFFIXES)
    depths = _by_number((folder / "results").glob("depth*.png"))
    found = _Collector(folder, profile, options)
    found.add_numbered(colors, depths, dict(enumerate(poses)))
    return found.source(
        kind="Replica folder",
        depth_intrinsics=intrinsics,
        depth_units_per_m=units_per_m,
        streams={
            "color": "results/frame*",
            "depth": "results/depth*.png",
            "camera_info": str(parameters or f"profile {profile.name}"),
            "pose": TRAJECTORY,
            "stamps": found.clock,
        },
        text_files=[folder / TRAJECTORY, *([parameters] if parameters is not None else [])],
    )


def open_hope(folder: Path, options: SourceOptions) -> FolderSource:
    """Return the source of a HOPE folder: `NNNN_rgb.jpg`, `NNNN_depth.png`, `NNNN.json` with intrinsics and extrinsics.

    The extrinsics are camera_from_world in the profile's units; frames without a json have no pose.
    """
    profile = load_profile(options.profile or "hope")
    colors = _by_number(file for file in folder.glob("*_rgb.*") if file.suffix in _COLOR_SUFFIXES)
    depths = _by_number(folder.glob("*_depth.png"))
    jsons = _by_number(folder.glob("*.json"))
    units_per_m = profile.extrinsics_units_per_m
    numbers = sorted(jsons.keys() & (colors.keys() | depths.keys()))
    cameras = {number: folder_text.read_hope_camera(jsons[number], units_per_m) for number in numbers}
    if not cameras:
        raise CalibrationError(f"{folder} has no NNNN.json with camera.intrinsics beside its {len(colors)} images")
    found = _Collector(folder, profile, options)
    found.add_numbered(colors, depths, {number: pose for number, (_, pose) in cameras.items()})
    return found.source(
        kind="HOPE folder",
        depth_intrinsics=cameras[numbers[0]][0],
        streams={
            "color": "*_rgb.*",
            "depth": "*_depth.png",
            "camera_info": "*.json",
            "pose": "*.json",
            "stamps": found.clock,
        },
        text_files=[jsons[number] for number in sorted(jsons)],
    )


class _Collector:
    def __init__(self, folder: Path, profile: Profile, options: SourceOptions) -> None:
        self._folder = folder
        self._estimates_poses = options.estimates_poses
        self._ignores_poses = options.pose_topic == NO_TOPIC
        self._world_from_log = folder_text.read_world_from_log(folder)
        self._up = folder_text.GRAVITY if (folder / folder_text.GRAVITY).is_file() else "z of the log"
        self._color_from_depth = from_rotation_translation(np.eye(3), np.array(profile.color_from_depth_m))
        self._depth_from_color = invert(self._color_from_depth)
        self._profile = profile
        self._frames: list[FolderFrame] = []
        self._fates: Counter[str] = Counter()
        self._unposed_ns: list[int] = []

    @property
    def clock(self) -> str:
        return f"number in the name / {self._profile.frame_rate_hz} Hz"

    def add_numbered(
        self, colors: Mapping[int, Path], depths: Mapping[int, Path], poses: Mapping[int, NDArray[np.float64] | None]
    ) -> None:
        for number in sorted(colors.keys() | depths.keys()):
            stamp_ns = number * 1_000_000_000 // self._profile.frame_rate_hz
            self.add(stamp_ns, colors.get(number), depths.get(number), poses.get(number))

    def add(
        self, stamp_ns: int, color: Path | None, depth: Path | None, log_from_depth: NDArray[np.float64] | None
    ) -> None:
        if color is None or not color.is_file():
            self._fates["depth_without_color"] += 1
        elif depth is None or not depth.is_file():
            self._fates["color_without_depth"] += 1
        elif (log_from_depth is None or self._ignores_poses) and not self._estimates_poses:
            self._fates["no_pose"] += 1
            self._unposed_ns.append(stamp_ns)
        else:
            world_from_camera = None
            if log_from_depth is not None and not self._ignores_poses:
                world_from_camera = compose(self._world_from_log, log_from_depth, self._depth_from_color)
            self._frames.append(
                FolderFrame(stamp_ns=stamp_ns, color=color, depth=depth, world_from_camera=world_from_camera)
            )

    def source(
        self,
        *,
        kind: str,
        depth_intrinsics: Intrinsics,
        streams: dict[str, str],
        text_files: list[Path],
        color_intrinsics: Intrinsics | None = None,
        depth_units_per_m: float | None = None,
        pose_span_ns: tuple[int, int] | None = None,
    ) -> FolderSource:
        if not self._frames:
            error = NoPosesError if self._unposed_ns and pose_span_ns is None else RecordingError
            raise error(self._why_empty(pose_span_ns))
        first = self._frames[0]
        registration = Registration(
            depth_camera=depth_intrinsics.camera(_size_of(first.depth)),
            color_camera=(color_intrinsics or depth_intrinsics).camera(_size_of(first.color)),
            color_from_depth=self._color_from_depth,
        )
        content = FolderContent(
            kind=kind,
            registration=registration,
            depth_units_per_m=depth_units_per_m or self._profile.depth_units_per_m,
            sensor=self._profile.sensor,
            frames=tuple(self._frames),
            fates=dict(self._fates),
            streams=(*streams.items(), ("up", self._up)),
            text_files=tuple(text_files),
        )
        return FolderSource(self._folder, content)

    def _why_empty(self, pose_span_ns: tuple[int, int] | None) -> str:
        if self._unposed_ns and pose_span_ns is not None:
            first_ns, last_ns = min(self._unposed_ns), max(self._unposed_ns)
            return (
                f"{self._folder}: no image has a pose: images from {first_ns / 1e9:.3f} s to {last_ns / 1e9:.3f} s, "
                f"poses from {pose_span_ns[0] / 1e9:.3f} s to {pose_span_ns[1] / 1e9:.3f} s"
            )
        found = ", ".join(f"{number} {fate}" for fate, number in sorted(self._fates.items())) or "no images"
        return f"{self._folder}: no frame has colour, depth and a pose; found {found}"


def _by_number(files: Iterable[Path]) -> dict[int, Path]:
    # frame-000012.color.jpg: 12
    numbered = {}
    for file in sorted(files):
        digits = re.findall(r"\d+", file.name.split(".")[0])
        if digits:
            numbered[int(digits[-1])] = file
    return numbered


def _size_of(file: Path) -> tuple[int, int]:
    size = compressed_size(file.read_bytes()[: 1 << 16])
    if size is None:
        raise RecordingError(f"{file} is neither JPEG nor PNG, or is torn")
    return size
