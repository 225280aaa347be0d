"""The table of layouts of image folders, and the files that hold such a folder: a new layout joins with one row.

Patterns are globs inside the folder; `|` separates alternatives. The first layout with all its marks is the folder's.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hickory_stream.errors import RecordingError
from hickory_stream.ports import Source
from players.logs.layouts import bop, data_sets, plain_folders, record3d, scannet_sens
from players.options import SourceOptions


@dataclass(frozen=True, kw_only=True, slots=True)
class Layout:
    """One layout: its files, and the function that opens a folder of it."""

    name: str
    #: The layout is recognised when all are there.
    marks: tuple[str, ...]
    #: Everything else that its reader needs.
    rest: tuple[str, ...]
    open: Callable[[Path, SourceOptions], Source]

    def found(self, folder: Path) -> tuple[str, ...]:
        """Return the patterns of all needed files that are there."""
        return tuple(pattern for pattern in self._needed if has_files(folder, pattern))

    def missing(self, folder: Path) -> tuple[str, ...]:
        """Return the patterns of all needed files that are not there."""
        return tuple(pattern for pattern in self._needed if not has_files(folder, pattern))

    @property
    def _needed(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys((*self.marks, *self.rest)))


Opener = Callable[[Path, SourceOptions], Source]


def _only(pattern: str, opener: Opener) -> Opener:
    # A folder that holds one file of a kind, perhaps beside meshes and labels.
    def opened(folder: Path, options: SourceOptions) -> Source:
        first, *others = sorted(folder.glob(pattern))
        if others:
            raise RecordingError(f"{folder} holds {1 + len(others)} files {pattern}; name the one to play")
        return opener(first, options)

    return opened


_ZIP = b"PK\x03\x04"
_POSED = ("cam_params.json", "camera_poses.txt")
_COLORS = "rgb/*.png|rgb/*.jpg"

LAYOUTS = (
    Layout(
        name="7-Scenes",
        marks=("frame-*.color.*",),
        rest=("frame-*.depth.png", "frame-*.pose.txt", "camera-intrinsics.txt"),
        open=plain_folders.open_seven_scenes,
    ),
    Layout(
        name="ICL-NUIM",
        marks=("rgb", "depth", "*.gt.sim|*.gt.freiburg"),
        rest=(_COLORS, "depth/*.png"),
        open=data_sets.open_icl_nuim,
    ),
    Layout(
        name="BOP",
        marks=("scene_camera.json",),
        rest=(f"{_COLORS}|gray/*.png", "depth/*.png"),
        open=bop.open_bop,
    ),
    Layout(name="BOP data set", marks=("*/*/scene_camera.json",), rest=(), open=bop.open_bop_data_set),
    Layout(
        name="ARKitScenes",
        marks=("lowres_depth|*_frames/lowres_depth", "lowres_wide|*_frames/lowres_wide"),
        rest=("lowres_wide.traj|*_frames/lowres_wide.traj", "lowres_wide_intrinsics|*_frames/lowres_wide_intrinsics"),
        open=data_sets.open_arkit_scenes,
    ),
    Layout(name="nerfstudio", marks=("transforms.json",), rest=(), open=data_sets.open_nerfstudio),
    Layout(
        name="ScanNet",
        marks=("color", "depth", "pose|intrinsic"),
        rest=("pose/*.txt", "intrinsic/intrinsic_color.txt", "intrinsic/intrinsic_depth.txt"),
        open=data_sets.open_scannet,
    ),
    Layout(
        name="TUM RGB-D", marks=("rgb.txt",), rest=("depth.txt", "groundtruth.txt"), open=plain_folders.open_tum
    ),
    Layout(
        name="Replica",
        marks=("results", "traj.txt"),
        rest=("results/frame*", "results/depth*.png"),
        open=plain_folders.open_replica,
    ),
    Layout(
        name="HOPE",
        marks=("*_rgb.jpg|*_rgb.png",),
        rest=("*_depth.png", "*.json"),
        open=plain_folders.open_hope,
    ),
    Layout(
        name="posed folder", marks=("|".join(_POSED),), rest=("rgb/*", "depth/*.png", *_POSED),
        open=plain_folders.open_posed_folder,
    ),
    Layout(
        name="unpacked .r3d", marks=("metadata", "rgbd/*.jpg", "rgbd/*.depth"), rest=(), open=record3d.open_record3d
    ),
    Layout(
        name="Record3D export",
        marks=("metadata.json|EXR_RGBD/metadata.json", "rgb|EXR_RGBD/rgb", "depth|EXR_RGBD/depth"),
        rest=(),
        open=record3d.open_record3d,
    ),
    Layout(name="ScanNet .sens", marks=("*.sens",), rest=(), open=_only("*.sens", scannet_sens.open_sens)),
    Layout(name="Record3D .r3d", marks=("*.r3d",), rest=(), open=_only("*.r3d", record3d.open_record3d)),
    Layout(
        name="Open3D",
        marks=("color|image|rgb", "depth", f"{data_sets.OPEN3D_LOGS}|{data_sets.OPEN3D_CAMERAS}"),
        rest=("depth/*.png", data_sets.OPEN3D_LOGS),
        open=data_sets.open_open3d,
    ),
)  # fmt: skip


def opener_of(path: Path) -> Opener | None:
    """Return the reader of an image folder, or of a file that holds one; None for anything else.

    Raises `RecordingError`: the path cannot be read.
    """
    if path.is_dir():
        layout = layout_of(path)
        return None if layout is None else layout.open
    if not path.is_file():
        return None
    try:
        with path.open("rb") as stream:
            magic = stream.read(16)
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}") from error
    # The first bytes may be damaged.
    if magic and (scannet_sens.is_sens(magic) or path.suffix == ".sens"):
        return scannet_sens.open_sens
    return record3d.open_record3d if magic and (magic.startswith(_ZIP) or path.suffix == ".r3d") else None


def layout_of(folder: Path) -> Layout | None:
    """Return the layout of a folder by its files, None if it has none; a ROS 2 bag has none.

    Raises `RecordingError`: the folder cannot be read.
    """
    try:
        next(folder.iterdir(), None)
    except OSError as error:
        raise RecordingError(f"{folder} cannot be read: {error.strerror or error}") from error
    if (folder / "metadata.yaml").exists():
        return None
    return next((layout for layout in LAYOUTS if all(has_files(folder, mark) for mark in layout.marks)), None)


def has_files(folder: Path, pattern: str) -> bool:
    """Return whether a file or folder matches one of the alternatives."""
    return any(next(folder.glob(part), None) is not None for part in pattern.split("|"))
