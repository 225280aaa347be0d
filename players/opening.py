"""What lies behind a path: told by its first bytes or by the files of a folder, never by its extension alone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.errors import RecordingError
from players.options import SourceOptions

if TYPE_CHECKING:
    from hickory_stream.ports import Source

_MCAP = b"\x89MCAP"
_ROS1 = b"#ROSBAG"
_SQLITE = b"SQLite format 3\0"
_KINDS = (
    "an MCAP file, a ROS 1 bag, a ROS 2 bag (folder or .db3), or a folder of images: "
    "7-Scenes (frame-000000.color.jpg ...), TUM RGB-D (rgb.txt, depth.txt, groundtruth.txt), "
    "or rgb/ with depth/, cam_params.json and camera_poses.txt"
)


def open_source(uri: str | Path, options: SourceOptions | None = None) -> Source:
    """Return the source that plays a recorded log or an image folder.

    Raises:
        RecordingError: nothing is there, it is of no known kind, or lacks what mapping needs.
        CalibrationError: intrinsics or extrinsics are missing or contradict the images.
    """
    path = Path(uri)
    options = options or SourceOptions()
    try:
        return _open_folder(path, options) if path.is_dir() else _open_file(path, options)
    except OSError as error:
        raise RecordingError(f"{error.filename or path} cannot be read: {error.strerror or error}") from error


def _open_file(path: Path, options: SourceOptions) -> Source:
    """Return the source of a single file."""
    if not path.exists():
        raise RecordingError(f"no such file or folder: {path}")
    with path.open("rb") as stream:
        magic = stream.read(16)
    if not magic:
        raise RecordingError(f"{path} is empty; expected {_KINDS}")
    from players.log_opening import open_log

    if magic.startswith(_MCAP):
        from players.mcap_log import McapLog

        return open_log(McapLog(path), options)
    if magic.startswith(_ROS1) or magic.startswith(_SQLITE):
        from players.bag import BagLog

        return open_log(BagLog(path, is_ros1=magic.startswith(_ROS1)), options)
    raise RecordingError(f"{path} is of no known kind (it begins with {magic[:8].hex(' ')}); expected {_KINDS}")


def _open_folder(folder: Path, options: SourceOptions) -> Source:
    """Return the source of a folder, told by the files in it."""
    names = sorted(entry.name for entry in folder.iterdir())
    if "metadata.yaml" in names:
        from players.bag import BagLog
        from players.log_opening import open_log

        return open_log(BagLog(folder, is_ros1=False), options)
    from players.folder_layouts import CAM_PARAMS, CAMERA_POSES, open_posed_folder, open_seven_scenes, open_tum

    if any(name.startswith("frame-") and ".color." in name for name in names):
        return open_seven_scenes(folder, options)
    if "rgb.txt" in names:
        return open_tum(folder, options)
    if CAM_PARAMS in names or CAMERA_POSES in names:
        return open_posed_folder(folder, options)
    logs = [name for name in names if name.endswith((".mcap", ".bag", ".db3"))]
    if len(logs) == 1:
        return _open_file(folder / logs[0], options)
    if logs:
        raise RecordingError(f"{folder} holds {len(logs)} logs without a metadata.yaml; name one of: {', '.join(logs)}")
    found = ", ".join(names[:8]) + (" ..." if len(names) > 8 else "") or "nothing"
    raise RecordingError(f"{folder} is no log that is known; found {found}; expected {_KINDS}")
