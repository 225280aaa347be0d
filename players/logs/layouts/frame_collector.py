"""Collection of an image folder's frames: pairs of files, their poses turned upright, and counts of the rest.

The world is z up. `gravity-direction.txt` (the unit vector down) turns the log's world upright.
Without one, the layout says which axis of the log is up; by default z.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import NoPosesError, RecordingError
from hickory_stream.geometry.rigid import compose, from_rotation_translation, invert
from players.logs.layouts import folder_text
from players.logs.layouts.folder import FolderContent, FolderFrame, FolderSource
from players.messages.depth_registration import Registration
from players.messages.image_decoding import compressed_size
from players.options import NO_TOPIC, SourceOptions
from players.profile import Intrinsics, Profile

_COLOR_SUFFIXES = (".jpg", ".jpeg", ".png")


class FrameCollector:
    """Sorts image files into frames and counts the rest by reason."""

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
        """The origin of stamps, in words."""
        return f"number in the name / {self._profile.frame_rate_hz} Hz"

    def add_numbered(
        self, colors: Mapping[int, Path], depths: Mapping[int, Path], poses: Mapping[int, NDArray[np.float64] | None]
    ) -> None:
        """Add images by number; a stamp is the number divided by the profile's frame rate."""
        for number in sorted(colors.keys() | depths.keys()):
            stamp_ns = number * 1_000_000_000 // self._profile.frame_rate_hz
            self.add(stamp_ns, colors.get(number), depths.get(number), poses.get(number))

    def add(
        self, stamp_ns: int, color: Path | None, depth: Path | None, log_from_depth: NDArray[np.float64] | None
    ) -> None:
        """Add a pair of files with the depth camera's pose, or count why it is no frame."""
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
        """Return the source of all frames. Raises `RecordingError`: there are none, or an image has no size."""
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


def by_number(files: Iterable[Path]) -> dict[int, Path]:
    """Return files by the last number in their names: 12 for frame-000012.color.jpg."""
    numbered = {}
    for file in sorted(files):
        digits = re.findall(r"\d+", file.name.split(".")[0])
        if digits:
            numbered[int(digits[-1])] = file
    return numbered


def color_files(folder: Path, pattern: str = "*") -> dict[int, Path]:
    """Return the JPEG and PNG files of a pattern by number."""
    return by_number(file for file in folder.glob(pattern) if file.suffix in _COLOR_SUFFIXES)


def _size_of(file: Path) -> tuple[int, int]:
    size = compressed_size(file.read_bytes()[: 1 << 16])
    if size is None:
        raise RecordingError(f"{file} is neither JPEG nor PNG, or is torn")
    return size
