"""Readers of 7-Scenes, TUM RGB-D, Replica, HOPE, and `rgb/ depth/` with its text files."""

from pathlib import Path

from hickory_stream.errors import CalibrationError, NoPosesError, RecordingError
from players.logs.layouts import folder_text
from players.logs.layouts.folder import FolderSource
from players.logs.layouts.frame_collector import FrameCollector, by_number, color_files
from players.logs.synchronizer import default_tolerance_ns
from players.options import DEFAULT_MAX_POSE_GAP_NS, NO_TOPIC, SourceOptions
from players.profile import load_profile

INTRINSICS = "camera-intrinsics.txt"
CAM_PARAMS = "cam_params.json"
CAMERA_POSES = "camera_poses.txt"
TRAJECTORY = "traj.txt"


def open_seven_scenes(folder: Path, options: SourceOptions) -> FolderSource:
    """Return the source of `frame-NNNNNN.{color.jpg|color.png, depth.png, pose.txt}` with `camera-intrinsics.txt`.

    Intrinsics and poses are the depth camera's; the profile (default: seven_scenes) says where the colour camera is.
    A stamp is the number in the file's name divided by the profile's frame rate.
    """
    profile_name = options.profile or "seven_scenes"
    profile = load_profile(profile_name)
    depth_intrinsics = folder_text.read_intrinsics(folder / INTRINSICS)
    poses = by_number(folder.glob("frame-*.pose.txt"))
    colors = color_files(folder, "frame-*.color.*")
    depths = by_number(folder.glob("frame-*.depth.png"))
    found = FrameCollector(folder, profile, options)
    found.add_numbered(colors, depths, {i: folder_text.read_pose_file(file) for i, file in poses.items()})
    return found.source(
        kind="7-Scenes folder",
        depth_intrinsics=depth_intrinsics,
        color_intrinsics=profile.color,
        streams=(
            "frame-*.color.*",
            "frame-*.depth.png",
            f"{INTRINSICS}, profile {profile_name}",
            "frame-*.pose.txt",
            found.clock,
        ),
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
    found = FrameCollector(folder, profile, options)
    found.add_stamped(images["rgb"], images["depth"], tolerance_ns, track.at if track is not None else lambda ns: None)
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
    colors = color_files(folder / "rgb")
    depths = by_number((folder / "depth").glob("*.png"))
    numbers = sorted(colors.keys() | depths.keys())
    if len(poses) != len(numbers):
        raise RecordingError(
            f"{folder}: {len(poses)} poses in {CAMERA_POSES} for {len(numbers)} images; expected as many"
        )
    found = FrameCollector(folder, profile, options)
    for i, (number, pose) in enumerate(zip(numbers, poses, strict=True)):
        found.add(i * 1_000_000_000 // profile.frame_rate_hz, colors.get(number), depths.get(number), pose)
    return found.source(
        kind="posed folder",
        depth_intrinsics=intrinsics,
        depth_units_per_m=units_per_m,
        streams=("rgb/*", "depth/*.png", CAM_PARAMS, CAMERA_POSES, f"order / {profile.frame_rate_hz} Hz"),
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
    colors = color_files(folder / "results", "frame*")
    depths = by_number((folder / "results").glob("depth*.png"))
    found = FrameCollector(folder, profile, options)
    found.add_numbered(colors, depths, dict(enumerate(poses)))
    return found.source(
        kind="Replica folder",
        depth_intrinsics=intrinsics,
        depth_units_per_m=units_per_m,
        streams=(
            "results/frame*",
            "results/depth*.png",
            str(parameters or f"profile {profile.name}"),
            TRAJECTORY,
            found.clock,
        ),
        text_files=[folder / TRAJECTORY, *([parameters] if parameters is not None else [])],
    )


def open_hope(folder: Path, options: SourceOptions) -> FolderSource:
    """Return the source of a HOPE folder: `NNNN_rgb.jpg`, `NNNN_depth.png`, `NNNN.json` with intrinsics and extrinsics.

    The extrinsics are camera_from_world in the profile's units; frames without a json have no pose.
    """
    profile = load_profile(options.profile or "hope")
    colors = color_files(folder, "*_rgb.*")
    depths = by_number(folder.glob("*_depth.png"))
    jsons = by_number(folder.glob("*.json"))
    units_per_m = profile.extrinsics_units_per_m
    numbers = sorted(jsons.keys() & (colors.keys() | depths.keys()))
    cameras = {number: folder_text.read_hope_camera(jsons[number], units_per_m) for number in numbers}
    if not cameras:
        raise CalibrationError(f"{folder} has no NNNN.json with camera.intrinsics beside its {len(colors)} images")
    found = FrameCollector(folder, profile, options)
    found.add_numbered(colors, depths, {number: pose for number, (_, pose) in cameras.items()})
    return found.source(
        kind="HOPE folder",
        depth_intrinsics=cameras[numbers[0]][0],
        streams=("*_rgb.*", "*_depth.png", "*.json", "*.json", found.clock),
        text_files=[jsons[number] for number in sorted(jsons)],
    )
