"""Collection of an image folder's frames: pairs of files, their poses turned upright, and counts of the rest.

The world is z up. `gravity-direction.txt` (the unit vector down) turns the log's world upright.
Without one, a layout's z axis is up, or the layout leaves it to level surfaces in the first images.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.ranges import Range
from hickory_stream.errors import NoPosesError, RecordingError
from hickory_stream.geometry import portable
from hickory_stream.geometry.camera import MOST_SIDE_PX
from hickory_stream.geometry.rigid import compose, from_rotation_translation, invert
from hickory_stream.poses.depth_scan import scan_of_depth
from hickory_stream.poses.upright import up_in
from players.logs.layouts import folder_text
from players.logs.layouts.file_parts import FilePart, ImageFile, read_image_file
from players.logs.layouts.folder import FolderContent, FolderFrame, FolderSource, FolderView, decoded
from players.logs.synchronizer import Leftover, Stamped, pair_nearest
from players.messages.depth_registration import Registration
from players.messages.image_decoding import compressed_size, decode_color
from players.options import DEFAULT_MAX_POSE_GAP_NS, NO_TOPIC, SourceOptions
from players.poses.interpolation import row_of_pose, track_of, world_from_down
from players.poses.pose_gaps import PoseGaps
from players.profile import Corrections, Intrinsics, Profile

_COLOR_SUFFIXES = (".jpg", ".jpeg", ".png")
# The images that are searched for level surfaces, and the cosine of 4 degrees, within which an axis of the log is up.
_LEVEL_IMAGES, _AXIS_COSINE = 5, 0.99756405

FAR_M = 1e6
"""A pose that is so far away is damaged."""

ROLES = ("color", "depth", "camera_info", "pose", "stamps")
_UNITS = Range(low=1e-3, high=1e9, unit="units in a metre")

Pose = NDArray[np.float64] | None
_Found = tuple[int, ImageFile, ImageFile, Pose, FolderView | None]
Sizes = tuple[tuple[int, int], tuple[int, int]]
"""(width, height) of colour, and of depth."""


class FrameCollector:
    """Sorts image files into frames and counts the rest by reason."""

    def __init__(
        self,
        folder: Path,
        profile: Profile,
        options: SourceOptions,
        *,
        color_from_depth: NDArray[np.float64] | None = None,
        rough_up: tuple[float, float, float] | None = None,
        is_y_up: bool = False,
    ) -> None:
        """`rough_up` is up in the camera within 50 degrees, if level surfaces have to tell; None: z or y of the log."""
        self._folder = folder
        self._estimates_poses = options.estimates_poses
        self._ignores_poses = options.pose_topic == NO_TOPIC
        self._rough_up, self._is_y_up = rough_up, is_y_up
        shift = from_rotation_translation(np.eye(3), np.array(profile.color_from_depth_m))
        self._color_from_depth = shift if color_from_depth is None else color_from_depth
        self._depth_from_color = invert(self._color_from_depth)
        self._profile = profile
        self._found: list[_Found] = []
        self._fates: Counter[str] = Counter()
        self._unposed: list[tuple[int, ImageFile]] = []

    @property
    def clock(self) -> str:
        """The origin of stamps, in words."""
        return f"number in the name / {self._profile.frame_rate_hz} Hz"

    def add_numbered(
        self,
        colors: Mapping[int, Path],
        depths: Mapping[int, Path],
        poses: Mapping[int, Pose],
        views: Mapping[int, FolderView] | None = None,
    ) -> None:
        """Add images by number; a stamp is the number divided by the profile's frame rate."""
        for number in sorted(colors.keys() | depths.keys()):
            stamp_ns = number * 1_000_000_000 // self._profile.frame_rate_hz
            if views is not None and number in colors and number in depths and number not in views:
                self._fates["no_intrinsics"] += 1
            else:
                view = None if views is None else views.get(number)
                self.add(stamp_ns, colors.get(number), depths.get(number), poses.get(number), view)

    def add_stamped(
        self,
        colors: Sequence[tuple[int, Path]],
        depths: Sequence[tuple[int, Path]],
        tolerance_ns: int,
        pose_at: Callable[[int], Pose],
        view_at: Callable[[int], FolderView | None] = lambda stamp_ns: None,
    ) -> None:
        """Add images by stamp: colour with the nearest depth within the tolerance, at the stamp of the colour."""
        stamped = [Stamped("color", *row) for row in colors] + [Stamped("depth", *row) for row in depths]
        for match in pair_nearest(sorted(stamped, key=lambda image: image.stamp_ns), tolerance_ns):
            if isinstance(match, Leftover):
                is_color = match.stream == "color"
                self.add(match.stamp_ns, match.item if is_color else None, None if is_color else match.item, None)
            else:
                stamp_ns = match.stamp_ns
                self.add(stamp_ns, match.color, match.depth, pose_at(stamp_ns), view_at(stamp_ns))

    def add(
        self,
        stamp_ns: int,
        color: ImageFile | None,
        depth: ImageFile | None,
        log_from_depth: Pose,
        view: FolderView | None = None,
    ) -> None:
        """Add a pair of files with the depth camera's pose, or count why it is no frame.

        `view` replaces the calibration of all frames.
        """
        if log_from_depth is not None and not np.abs(log_from_depth[:3, 3]).max() < FAR_M:
            log_from_depth = None
        if not is_there(color):
            self._fates["depth_without_color"] += 1
        elif not is_there(depth):
            self._fates["color_without_depth"] += 1
        elif (log_from_depth is None or self._ignores_poses) and not self._estimates_poses:
            self._fates["no_pose"] += 1
            self._unposed.append((stamp_ns, color))
        else:
            self._found.append((stamp_ns, color, depth, None if self._ignores_poses else log_from_depth, view))

    def lose(self, number: int) -> None:
        """Count pairs that are lost in damage."""
        self._fates["unreadable_frames"] += number

    def source(
        self,
        *,
        kind: str,
        depth_intrinsics: Intrinsics | None,
        streams: Mapping[str, str] | tuple[str, str, str, str, str],
        text_files: Sequence[Path],
        color_intrinsics: Intrinsics | None = None,
        depth_units_per_m: float | None = None,
        pose_span_ns: tuple[int, int] | None = None,
        flaws: Sequence[str] = (),
    ) -> FolderSource:
        """Return the source of all frames; without `depth_intrinsics` every frame has a view.

        `streams` are the origins of the frames by role, a tuple those of `ROLES`.

        Raises `RecordingError`: there are no frames, or an image has no size.
        """
        if not self._found:
            error = NoPosesError if self._unposed and pose_span_ns is None else RecordingError
            raise error(self._why_empty(pose_span_ns))
        corrections, usual = self._profile.corrections, None
        if corrections.pose_offset_ns or corrections.depth_offset_ns:
            self._found = list(self._at_other_times(corrections))
        origins = dict(zip(ROLES, streams, strict=True) if isinstance(streams, tuple) else streams)
        if depth_intrinsics is not None:
            sizes = sizes_of(found[1:3] for found in self._found)
            usual = self.view(
                sizes, depth_units_per_m or self._profile.depth_units_per_m, depth_intrinsics, color_intrinsics
            )
            width, height = depth_intrinsics.width, depth_intrinsics.height
            if width is not None and (width, height) not in sizes:
                origins["camera_info"] += f" (scaled from {width}x{height})"
        frames = []
        for stamp_ns, color, depth, pose, own in self._found:
            view = own or usual
            assert view is not None
            view = replace(view, depth_scale=corrections.depth_scale)
            frames.append(FolderFrame(stamp_ns=stamp_ns, color=color, depth=depth, world_from_camera=pose, view=view))
        world_from_log, up = self._upright(frames)
        content = FolderContent(
            kind=kind,
            sensor=self._profile.sensor,
            frames=tuple(
                replace(
                    frame, world_from_camera=corrections.turned(compose(world_from_log, pose, self._depth_from_color))
                )
                if (pose := frame.world_from_camera) is not None
                else frame
                for frame in frames
            ),
            world_from_log=world_from_log,
            fates=dict(self._fates),
            streams=(*origins.items(), ("up", up)),
            text_files=tuple(text_files),
            flaws=tuple(flaws),
            gaps=self._gaps(),
        )
        return FolderSource(self._folder, content)

    def _at_other_times(self, corrections: Corrections) -> Iterator[_Found]:
        # Poses and depth by their corrected stamps; the frames are their only ones.
        found = sorted(self._found, key=itemgetter(0))
        stamps_ns = np.array([stamp_ns for stamp_ns, *_ in found])
        near_ns = np.median(np.diff(stamps_ns)) if len(found) > 1 else 0
        posed = {stamp_ns: row_of_pose(pose) for stamp_ns, _, _, pose, _ in found if pose is not None}
        track = track_of(list(posed), list(posed.values()), DEFAULT_MAX_POSE_GAP_NS)
        for stamp_ns, color, _, pose, view in found:
            off_ns = np.abs(stamps_ns + corrections.depth_offset_ns - stamp_ns)
            if off_ns.min() > near_ns / 2:
                self._fates["color_without_depth"] += 1
                continue
            if pose is not None:
                pose = track.at(stamp_ns - corrections.pose_offset_ns) if track is not None else None
                if pose is None and not self._estimates_poses:
                    self._fates["no_pose"] += 1
                    self._unposed.append((stamp_ns, color))
                    continue
            yield stamp_ns, color, found[int(off_ns.argmin())][2], pose, view

    def _gaps(self) -> PoseGaps:
        gaps, unposed = PoseGaps(), [(stamp_ns, color, None, None, None) for stamp_ns, color in self._unposed]
        for _, color, _, pose, _ in sorted([*self._found, *unposed], key=itemgetter(0)):
            if pose is not None:
                gaps.posed(pose)
            elif not self._estimates_poses:
                gaps.unposed(partial(_pixels, color))
        return gaps

    def view(
        self, sizes: Sizes, depth_units_per_m: float, depth: Intrinsics, color: Intrinsics | None = None
    ) -> FolderView:
        """Return a calibration without distortion; colour has by default the intrinsics of depth.

        Raises `RangeError`: the unit of depth is none; `CalibrationError`: the intrinsics are of another size.
        """
        _UNITS.check("depth", depth_units_per_m)
        if color is None:
            depth = depth.of_nearest(sizes)
        registration = Registration(
            depth_camera=depth.camera(sizes[1], str(self._folder)),
            color_camera=(color or depth).camera(sizes[0], str(self._folder)),
            color_from_depth=self._color_from_depth,
        )
        return FolderView(registration=registration, depth_units_per_m=depth_units_per_m)

    def _upright(self, frames: Sequence[FolderFrame]) -> tuple[NDArray[np.float64], str]:
        # The rotation (4, 4) from the log's world to the upright one, and its origin in words.
        if (self._folder / folder_text.GRAVITY).is_file():
            return folder_text.read_world_from_log(self._folder), folder_text.GRAVITY
        posed = [frame for frame in frames if frame.world_from_camera is not None]
        if self._rough_up is None or not posed:
            return (
                (world_from_down(np.array([0, -1, 0])), "y of the log")
                if self._is_y_up
                else (np.eye(4), "z of the log")
            )
        rough_up = np.array(self._rough_up)
        for frame in posed[:: max(1, len(posed) // _LEVEL_IMAGES)]:
            try:
                up = up_in(scan_of_depth(decoded(frame, self._profile.sensor)), rough_up)
            except RecordingError:
                continue
            if up is not None:
                up = portable.matmul(portable.matmul(frame.pose[:3, :3], self._depth_from_color[:3, :3]), up)
                axis = int(np.abs(up).argmax())
                if abs(up[axis]) > _AXIS_COSINE:
                    sign, up = np.sign(up[axis]), np.eye(3)[axis] * np.sign(up[axis])
                    return world_from_down(-up), f"{'-' if sign < 0 else ''}{'xyz'[axis]} of the log, by level surfaces"
                return world_from_down(-up), f"level surfaces of {Path(str(frame.depth)).name}"
        return world_from_down(
            -portable.matmul(posed[0].pose[:3, :3], rough_up)
        ), "the first image, without a level surface in view"

    def _why_empty(self, pose_span_ns: tuple[int, int] | None) -> str:
        if self._unposed and pose_span_ns is not None:
            stamps_ns = [stamp_ns for stamp_ns, _ in self._unposed]
            return (
                f"{self._folder}: no image has a pose: images from {min(stamps_ns) / 1e9:.3f} s to "
                f"{max(stamps_ns) / 1e9:.3f} s, "
                f"poses from {pose_span_ns[0] / 1e9:.3f} s to {pose_span_ns[1] / 1e9:.3f} s"
            )
        found = ", ".join(f"{number} {fate}" for fate, number in sorted(self._fates.items())) or "no images"
        return f"{self._folder}: no frame has colour, depth and a pose; found {found}"


def _pixels(color: ImageFile) -> NDArray[np.uint8]:
    return decode_color(read_image_file(color), str(color))


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


def is_there(image: ImageFile | None) -> TypeGuard[ImageFile]:
    """Return whether there is such an image; a damaged name may be too long for a file."""
    try:
        return isinstance(image, FilePart) or (image is not None and image.is_file())
    except OSError:
        return False


def sizes_of(pairs: Iterable[tuple[ImageFile, ImageFile]]) -> Sizes:
    """Return the sizes of the first pair of images (colour, depth) whose headers can be read.

    Raises `RecordingError`: no image can be read, or is JPEG or PNG.
    """
    refusal = RecordingError("there are no images")
    for color, depth in pairs:
        try:
            return _size_of(color), _size_of(depth)
        except RecordingError as error:
            refusal = error
    raise refusal


def _size_of(file: ImageFile) -> tuple[int, int]:
    size = compressed_size(read_image_file(file)[: 1 << 16])
    if size is None or not all(0 < side <= MOST_SIDE_PX for side in size):
        raise RecordingError(f"{file} is neither JPEG nor PNG, or is torn")
    return size
