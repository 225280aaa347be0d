"""A recorded log as a source: images paired as they stream by, poses known before the first of them.

Opening reads up to the first complete frame, so that a log that cannot be mapped is refused before anything is written.
Stamps are those of the headers; the time of recording is never used.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.errors import CalibrationError, RecordingError
from hickory_stream.records import Frame, RawFrame, SourceInfo
from players.containers import UnreadableMessageError, deserialize
from players.counts import Ledger
from players.discover import ImageTopics
from players.identity import files_identity
from players.images import LogImage, color_of, depth_of, image_of
from players.register import Registration, register_depth
from players.sync import Leftover, Pair, Stamped, pair_nearest

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from players.calibration import Lens
    from players.containers import Log, Topic
    from players.rig import CameraPoses


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LogSetup:
    """What opening a log has settled."""

    topics: ImageTopics
    color_lens: Lens
    depth_lens: Lens
    registration: Registration
    poses: CameraPoses
    tolerance_ns: int
    streams: tuple[tuple[str, str], ...]
    fates: Mapping[str, int]


class LogSource:
    """A `Source` of a recorded log."""

    def __init__(self, log: Log, setup: LogSetup) -> None:
        """Read up to the first frame.

        Raises:
            RecordingError: there is no frame with colour, depth and a pose; says what does not meet what.
            CalibrationError: all images have another size than their calibration.
        """
        self._log = log
        self._setup = setup
        self._ledger = Ledger()
        first = next(self.frames(), None)
        if first is None:
            raise self._why_empty()
        self._info = SourceInfo(
            uri=str(log.path),
            kind=log.kind,
            identity=files_identity(log.files),
            camera=setup.registration.color_camera,
            num_frames=_fewer(setup.topics.color.num_messages, setup.topics.depth.num_messages),
            start_ns=first.stamp_ns,
            end_ns=None,
            streams=setup.streams,
        )

    @property
    def info(self) -> SourceInfo:
        """What was found when the log was opened; `num_frames` is the most there can be: images may lack partners."""
        return self._info

    def frames(self) -> Iterator[RawFrame]:
        """Yield the frames from the beginning, in the order of their stamps; what became no frame is in the ledger."""
        ledger = self._ledger = Ledger()
        for fate, number in self._setup.fates.items():
            ledger.count(fate, number)
        index = 0
        for match in pair_nearest(self._images(ledger), self._setup.tolerance_ns):
            if isinstance(match, Leftover):
                ledger.count(_fate_of(match))
                continue
            frame = self._frame(index, match, ledger)
            if frame is not None:
                index += 1
                yield frame

    def ledger(self) -> Mapping[str, int]:
        """Return the counts of the latest pass.

        Each colour image is in one of `frames`, `no_pose`, `frame_of_other_size`, `color_without_depth`, `late_color`
        or `unreadable_message`, and each depth image likewise; the first three count pairs. `unreadable_image` and
        `depth_without_returns` are found on decoding, among the `frames`.
        """
        return self._ledger.as_dict()

    def close(self) -> None:
        """Do nothing: each pass over the log opens and closes its own files."""

    def _images(self, ledger: Ledger) -> Iterator[Stamped]:
        """Yield the images of both topics as they lie in the log."""
        topics = self._setup.topics
        for image in read_images(self._log, topics, ledger):
            yield Stamped("color" if image.topic == topics.color.name else "depth", image.stamp_ns, image)

    def _frame(self, index: int, pair: Pair, ledger: Ledger) -> RawFrame | None:
        """Return the frame of a pair, or None when it is of another size or has no pose."""
        registration = self._setup.registration
        if not (_has_size(pair.color, self._setup.color_lens) and _has_size(pair.depth, self._setup.depth_lens)):
            ledger.count("frame_of_other_size")
            return None
        world_from_camera = self._setup.poses.at(pair.stamp_ns)
        if world_from_camera is None:
            ledger.count("no_pose")
            return None
        ledger.count("frames")
        is_passed_on = pair.color.is_compressed and not self._setup.color_lens.is_distorted
        return RawFrame(
            index=index,
            stamp_ns=pair.stamp_ns,
            camera=registration.color_camera,
            world_from_camera=world_from_camera,
            decode=partial(_decode, self._setup, pair, index, world_from_camera, ledger),
            color_bytes=(pair.color.data() or None) if is_passed_on else None,
        )

    def _why_empty(self) -> RecordingError | CalibrationError:
        """Return the error for a log whose images, depth, poses and calibration never come together."""
        fates, path, topics = self._ledger.as_dict(), self._log.path, self._setup.topics
        if fates.get("no_pose"):
            images = _span_text(self._stamps(topics.color))
            return RecordingError(
                f"{path}: no image has a pose: images from {images}, poses of {self._setup.poses.source} "
                f"from {_span_text(self._setup.poses.span_ns or (0, 0))}; name another with --pose-topic"
            )
        if fates.get("frame_of_other_size"):
            lenses = (self._setup.color_lens.camera, self._setup.depth_lens.camera)
            sizes = " and ".join(f"{camera.width}x{camera.height}" for camera in lenses)
            return CalibrationError(
                f"{path}: the camera infos are for {sizes} pixels; no pair of images has these sizes"
            )
        tolerance = f"{self._setup.tolerance_ns / 1e6:.1f} ms"
        return RecordingError(
            f"{path}: no colour image has a depth image within {tolerance}: {topics.color.name} "
            f"from {_span_text(self._stamps(topics.color))}, {topics.depth.name} from "
            f"{_span_text(self._stamps(topics.depth))}; found {fates}; widen it with --sync-tolerance"
        )

    def _stamps(self, topic: Topic) -> tuple[int, int]:
        """Return the first and the last stamp of an image topic, by reading all of it."""
        pair = ImageTopics(color=topic, depth=topic)
        stamps = [image.stamp_ns for image in read_images(self._log, pair, Ledger())]
        return (min(stamps), max(stamps)) if stamps else (0, 0)


def read_images(log: Log, topics: ImageTopics, ledger: Ledger) -> Iterator[LogImage]:
    """Yield the images of both topics as they lie in the log; messages that cannot be read are counted."""
    by_name = {topic.name: topic for topic in (topics.color, topics.depth)}
    for message in log.messages(by_name):
        topic = by_name[message.topic]
        try:
            yield image_of(topic, deserialize(topic, message.data))
        except UnreadableMessageError:
            ledger.count("unreadable_message")


def _decode(setup: LogSetup, pair: Pair, index: int, world_from_camera: NDArray[np.float64], ledger: Ledger) -> Frame:
    """Return the decoded frame: rectified colour, and rectified depth registered into it."""
    try:
        rgb, depth_m = color_of(pair.color), depth_of(pair.depth)
        _check_size(rgb.shape, setup.color_lens, pair.color)
        _check_size(depth_m.shape, setup.depth_lens, pair.depth)
    except RecordingError:
        ledger.count("unreadable_image")
        raise
    if not np.isfinite(depth_m).any():
        ledger.count("depth_without_returns")
    return Frame(
        index=index,
        stamp_ns=pair.stamp_ns,
        rgb=setup.color_lens.rectified_color(rgb),
        depth_m=register_depth(setup.depth_lens.rectified_depth(depth_m), setup.registration),
        camera=setup.registration.color_camera,
        world_from_camera=world_from_camera,
    )


def _check_size(shape: tuple[int, ...], lens: Lens, image: LogImage) -> None:
    """Refuse an image whose header was torn and whose pixels have another size."""
    if shape[:2] != (lens.camera.height, lens.camera.width):
        expected = f"{lens.camera.width}x{lens.camera.height}"
        raise RecordingError(f"{image} has {shape[1]}x{shape[0]} pixels; expected {expected}")


def _has_size(image: LogImage, lens: Lens) -> bool:
    """Return whether an image has its calibration's size; of a torn header, decoding will tell."""
    return image.size is None or image.size == (lens.camera.width, lens.camera.height)


def _fate_of(leftover: Leftover) -> str:
    if leftover.is_late:
        return f"late_{leftover.stream}"
    return "color_without_depth" if leftover.stream == "color" else "depth_without_color"


def _fewer(a: int | None, b: int | None) -> int | None:
    return None if a is None or b is None else min(a, b)


def _span_text(span_ns: tuple[int, int]) -> str:
    return f"{span_ns[0] / 1e9:.3f} s to {span_ns[1] / 1e9:.3f} s"
