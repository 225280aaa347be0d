"""Opening a log: which topics play which role, how depth gets into the colour image, and where the camera was.

The small messages (poses, transforms, calibrations) are read once, and the first few images for their frame names.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING

from hickory_stream.errors import CalibrationError, RecordingError
from players.calibration import Lens, lens_of
from players.counts import Ledger
from players.discover import (
    ImageTopics,
    camera_infos,
    choose_images,
    info_names,
    is_rectified,
    pose_topics,
    tf_topics,
)
from players.images import LogImage, check_color_encoding, check_depth_encoding
from players.log_source import LogSetup, LogSource, read_images
from players.register import Registration
from players.rig import Rig, camera_poses, read_rig
from players.sync import default_tolerance_ns

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from players.containers import Log, Topic
    from players.options import SourceOptions

_PROBE_MESSAGES = 40
"""Images of each topic that are looked at for frame names, encodings and periods."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Probe:
    """The beginning of an image topic."""

    first: LogImage
    stamps_ns: tuple[int, ...]


def open_log(log: Log, options: SourceOptions) -> LogSource:
    """Return the source of a log.

    Raises:
        RecordingError: colour, depth or poses are missing, or never meet in time.
        CalibrationError: intrinsics or the frames between pose and camera are missing.
    """
    if not any(topic.num_messages != 0 for topic in log.topics):
        raise RecordingError(f"{log.path} ({log.kind}) holds no messages")
    topics = choose_images(log.path, log.topics, options)
    wanted = [*pose_topics(log.path, log.topics, options), *tf_topics(log.topics), *camera_infos(log.topics)]
    color_probe, depth_probe = _probe(log, topics.color), _probe(log, topics.depth)
    color, depth = color_probe.first, depth_probe.first
    check_color_encoding(color)
    check_depth_encoding(depth)
    rig = read_rig(log, wanted, options.max_pose_gap_ns)
    color_info = _info_topic(log, rig, topics.color, color, options.color_info_topic, "--color-info-topic")
    color_lens = _lens(rig, color_info, topics.color, color)
    depth_info, depth_lens = _depth_lens(log, rig, topics.depth, depth, options, (color.frame, color_info, color_lens))
    color_from_depth = _color_from_depth(log, rig, color.frame, depth.frame)
    is_named = options.pose_topic is not None and options.pose_topic not in {
        topic.name for topic in tf_topics(log.topics)
    }
    poses = camera_poses(log.path, rig, color.frame, options.pose_frame, is_named=is_named)
    tolerance_ns = options.sync_tolerance_ns
    if tolerance_ns is None:
        tolerance_ns = default_tolerance_ns(color_probe.stamps_ns, depth_probe.stamps_ns)
    setup = LogSetup(
        topics=topics,
        color_lens=color_lens,
        depth_lens=depth_lens,
        registration=Registration(
            depth_camera=depth_lens.camera, color_camera=color_lens.camera, color_from_depth=color_from_depth
        ),
        poses=poses,
        tolerance_ns=tolerance_ns,
        streams=(
            ("color", topics.color.name),
            ("depth", topics.depth.name),
            ("color_info", color_info),
            ("depth_info", depth_info),
            ("pose", poses.source),
            ("frames", poses.path),
            ("sync_tolerance", f"{tolerance_ns / 1e6:.1f} ms"),
        ),
        fates=rig.fates,
    )
    return LogSource(log, setup)


def _probe(log: Log, topic: Topic) -> _Probe:
    """Return the first image of a topic, and the stamps of the first few.

    Raises:
        RecordingError: not one message of the topic can be read.
    """
    ledger = Ledger()
    images = islice(read_images(log, ImageTopics(color=topic, depth=topic), ledger), _PROBE_MESSAGES)
    first = next(images, None)
    if first is None:
        found = f"{ledger.as_dict().get('unreadable_message', 0)} messages that cannot be read"
        raise RecordingError(f"{log.path}: {topic.name} ({topic.type_name}) holds no image; found {found}")
    return _Probe(first=first, stamps_ns=(first.stamp_ns, *(image.stamp_ns for image in images)))


def _info_topic(log: Log, rig: Rig, topic: Topic, image: LogImage, name: str | None, option: str) -> str:
    """Return the topic of an image's calibration: beside it by name, else the only one of the same frame.

    Raises:
        CalibrationError: there is none.
    """
    found = _find_info(rig, topic, image, name)
    if found is None:
        infos = ", ".join(f"{info} (frame {rig.infos[info].frame})" for info in sorted(rig.infos)) or "none"
        asked = name or " or ".join(info_names(topic))
        raise CalibrationError(
            f"{log.path}: no intrinsics for {topic.name}: no CameraInfo on {asked}, nor one of frame {image.frame}; "
            f"CameraInfo topics: {infos}. Name one with {option}"
        )
    return found


def _find_info(rig: Rig, topic: Topic, image: LogImage, name: str | None) -> str | None:
    """Return the topic of an image's calibration, or None where there is none."""
    if name is not None:
        return name if name in rig.infos else None
    for candidate in info_names(topic):
        if candidate in rig.infos:
            return candidate
    same_frame = [info for info in sorted(rig.infos) if rig.infos[info].frame == image.frame]
    return same_frame[0] if len(same_frame) == 1 else None


def _lens(rig: Rig, info: str, topic: Topic, image: LogImage) -> Lens:
    return lens_of(rig.infos[info], topic=info, image_size=image.size, is_rectified=is_rectified(topic))


def _depth_lens(
    log: Log, rig: Rig, topic: Topic, image: LogImage, options: SourceOptions, color: tuple[str, str, Lens]
) -> tuple[str, Lens]:
    """Return the depth's calibration: its own, or the colour's where frame and size are the same."""
    color_frame, color_info, color_lens = color
    if options.depth_info_topic is None and _find_info(rig, topic, image, None) is None:
        size = (color_lens.camera.width, color_lens.camera.height)
        if image.frame == color_frame and image.size == size:
            return color_info, color_lens
    info = _info_topic(log, rig, topic, image, options.depth_info_topic, "--depth-info-topic")
    return info, _lens(rig, info, topic, image)


def _color_from_depth(log: Log, rig: Rig, color_frame: str, depth_frame: str) -> NDArray[np.float64]:
    """Return the transform between the two cameras.

    Raises:
        CalibrationError: TF does not connect them rigidly.
    """
    chain = rig.tree.chain(color_frame, depth_frame)
    color_from_depth = chain.at(0) if chain is not None and chain.is_static else None
    if color_from_depth is None:
        raise CalibrationError(
            f"{log.path}: no static transform from the depth's frame {depth_frame} to the colour's {color_frame}; "
            f"frames of TF: {', '.join(sorted(rig.tree.edges)) or 'none'}. Record /tf_static, or name depth that is "
            "registered to the colour with --depth-topic"
        )
    return color_from_depth
