"""Image folders, and files that hold a folder's images, as a source.

Files are found and paired on opening; colour is read when a frame is reached, depth when it is decoded.
Frames are those of the colour camera, and the poses are its poses.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import CalibrationError, RecordingError
from hickory_stream.geometry.depth_sensor import DepthSensor
from hickory_stream.records import Frame, RawFrame, SourceInfo
from players.logs.containers import files_identity
from players.logs.layouts.file_parts import FilePart, ImageFile, read_image_file
from players.logs.message_account import Account, Ledger, TopicAccount
from players.messages.calibration import Lens
from players.messages.depth_registration import Registration, register_depth
from players.messages.image_decoding import compressed_size, decode_color, decode_depth_png
from players.poses.pose_gaps import PoseGaps

_LOST = "unreadable_frames"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FolderView:
    """The calibration of a pair of images; the lenses of colour and depth are None without distortion."""

    registration: Registration
    depth_units_per_m: float
    #: Depth as read, times this, is in metres.
    depth_scale: float = 1.0
    lenses: tuple[Lens, Lens] | None = None
    #: Returns metres from the bytes and the name of a depth image; None: 16-bit PNG.
    decode_depth: Callable[[bytes, str], NDArray[np.float32]] | None = None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FolderFrame:
    """A pair of images with its stamp and the colour camera's pose, None if odometry has to estimate it."""

    stamp_ns: int
    color: ImageFile
    depth: ImageFile
    world_from_camera: NDArray[np.float64] | None
    view: FolderView

    @property
    def pose(self) -> NDArray[np.float64]:
        """The pose (4, 4), the identity if there is none."""
        return self.world_from_camera if self.world_from_camera is not None else np.eye(4)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FolderContent:
    """The frames that a layout found in a folder, in the order of their stamps."""

    kind: str
    sensor: DepthSensor
    frames: tuple[FolderFrame, ...]
    #: (4, 4); annotations of the log are in its own world.
    world_from_log: NDArray[np.float64]
    #: Counts, by reason, of files that became no frame; `unreadable_frames`: pairs lost in damage.
    fates: Mapping[str, int]
    streams: tuple[tuple[str, str], ...]
    #: Poses and intrinsics; with the names and sizes of the images they identify the folder.
    text_files: tuple[Path, ...]
    #: Damaged places, in words.
    flaws: tuple[str, ...] = ()
    gaps: PoseGaps = field(default_factory=PoseGaps)

    @property
    def images(self) -> list[Path]:
        """The files of all frames, colour before depth, each once."""
        images = (image for frame in self.frames for image in (frame.color, frame.depth))
        return list(dict.fromkeys(image.file if isinstance(image, FilePart) else image for image in images))


class FolderSource:
    """A `Source` of an image folder."""

    def __init__(self, folder: Path, content: FolderContent) -> None:
        """Raises `RecordingError`: no frame has colour, depth and a pose."""
        if not content.frames:
            found = ", ".join(f"{count} {fate}" for fate, count in content.fates.items() if count) or "no images"
            raise RecordingError(f"{folder}: no frame has colour, depth and a pose; found {found}")
        self.content, self.gaps = content, content.gaps
        self._ledger = Ledger()
        images = content.images
        sampled = [*content.text_files, *images[:2], *images[-2:]]
        self.info = SourceInfo(
            uri=str(folder),
            kind=content.kind,
            identity=files_identity([*content.text_files, *images], sampled),
            camera=content.frames[0].view.registration.color_camera,
            num_frames=len(content.frames),
            start_ns=content.frames[0].stamp_ns,
            end_ns=content.frames[-1].stamp_ns,
            streams=content.streams,
        )

    def frames(self) -> Iterator[RawFrame]:
        """Yield the frames from the beginning; a frame whose colour has another size is counted and skipped.

        Raises `CalibrationError`: no frame has the size that the intrinsics are for.
        """
        ledger = self._ledger = Ledger()
        for fate, number in self.content.fates.items():
            ledger.count(fate, number)
        index = 0
        for files in self.content.frames:
            camera = files.view.registration.color_camera
            try:
                color_bytes = read_image_file(files.color)
            except RecordingError:
                color_bytes = b""  # Reported when the frame is decoded.
            size = compressed_size(color_bytes)
            if size is not None and size != (camera.width, camera.height):
                ledger.count("frame_of_other_size")
                continue
            ledger.count("frames")
            yield RawFrame(
                index=index,
                stamp_ns=files.stamp_ns,
                camera=camera,
                world_from_camera=files.pose,
                decode=partial(_decode, self.content.sensor, files, index, color_bytes, ledger),
                color_bytes=color_bytes if color_bytes and files.view.lenses is None else None,
                is_posed=files.world_from_camera is not None,
            )
            index += 1
        if index == 0:
            raise CalibrationError(
                f"{self.info.uri}: the intrinsics are for {camera.width}x{camera.height} pixels; no image is"
            )
        ledger.is_complete = True

    def ledger(self) -> Mapping[str, int]:
        """Return the counts of the latest pass: frames, and files that became none."""
        return self._ledger.as_dict()

    def account(self) -> Account:
        """Return the ledger of all image files in the latest pass."""
        counts, content = self._ledger.as_dict(), self.content
        frames, other_size = counts.get("frames", 0), counts.get("frame_of_other_size", 0)
        not_played = len(content.frames) - frames - other_size
        streams, topics = dict(content.streams), []
        for role, other in (("color", "depth_without_color"), ("depth", "color_without_depth")):
            became_none = {fate: number for fate, number in content.fates.items() if fate not in (other, _LOST)}
            lost = content.fates.get(_LOST, 0)
            rejected = {**became_none, "frame_of_other_size": other_size}
            topics.append(
                TopicAccount(
                    topic=streams.get(role, role),
                    declared=len(content.frames) + sum(became_none.values()) + lost,
                    used=frames,
                    unreadable=lost,
                    not_played=not_played,
                    rejected={fate: number for fate, number in rejected.items() if number},
                )
            )
        return Account(
            topics=tuple(topics),
            is_complete=self._ledger.is_complete,
            num_flaws=len(content.flaws),
            flaws=content.flaws,
            findings=tuple(self.findings()),
            unit="images" if isinstance(content.frames[0].color, FilePart) else "files",
        )

    def findings(self) -> Mapping[str, bool]:
        """Return faults of the poses, and whether each does harm."""
        return {text: True for text in [self.gaps.finding()] if text}

    @property
    def depth_units_per_m(self) -> float:
        """The unit of the first depth image."""
        view = self.content.frames[0].view
        return view.depth_units_per_m / view.depth_scale

    def num_bytes(self) -> int:
        """Return the size of everything that is played: images, poses and intrinsics."""
        return sum(file.stat().st_size for file in {*self.content.text_files, *self.content.images})

    def close(self) -> None:
        """Do nothing: no file stays open between frames."""


def decoded(files: FolderFrame, sensor: DepthSensor) -> Frame:
    """Return a single frame, outside of any pass. Raises `RecordingError`: an image cannot be read."""
    return _decode(sensor, files, 0, read_image_file(files.color), Ledger())


def _decode(sensor: DepthSensor, files: FolderFrame, index: int, color_bytes: bytes, ledger: Ledger) -> Frame:
    try:
        rgb = decode_color(color_bytes or read_image_file(files.color), str(files.color))
        data, what, decode = read_image_file(files.depth), str(files.depth), files.view.decode_depth
        if decode is None:
            depth_m = decode_depth_png(data, files.view.depth_units_per_m / files.view.depth_scale, what)
        else:
            depth_m = decode(data, what) * np.float32(files.view.depth_scale)
        depth_m = sensor.returns(depth_m)
        camera = files.view.registration.depth_camera
        if depth_m.shape != (camera.height, camera.width):
            size = f"{depth_m.shape[1]}x{depth_m.shape[0]}"
            raise RecordingError(f"{files.depth} has {size} pixels; expected {camera.width}x{camera.height}")
    except RecordingError:
        ledger.count("unreadable_image")
        raise
    if files.view.lenses is not None:
        rgb, depth_m = files.view.lenses[0].rectified_color(rgb), files.view.lenses[1].rectified_depth(depth_m)
    if not np.isfinite(depth_m).any():
        ledger.count("depth_without_returns")
    return Frame(
        index=index,
        stamp_ns=files.stamp_ns,
        rgb=rgb,
        depth_m=register_depth(depth_m, files.view.registration),
        camera=files.view.registration.color_camera,
        world_from_camera=files.pose,
        sensor=sensor,
    )
