"""Roles of topics by type and name; `SourceOptions` overrides them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from hickory_stream.errors import NoPosesError, RecordingError
from players.logs.containers import Topic
from players.logs.robots import shared_parts
from players.messages.records import CAMERA_INFO, COMPRESSED_IMAGE, IMAGE, POSE_TYPES, TF
from players.options import NO_TOPIC, SourceOptions

_COLOR_POINTS = {"rgb": 8, "color": 8, "colour": 8, "left": 2, "rect": 2, "image": 1, "compressed": 1}
_DEPTH_POINTS = {"aligned": 8, "registered": 8, "rect": 2, "compresseddepth": 1, "compressed": -2}
_NEITHER = frozenset(
    "confidence disparity fisheye infra infra1 infra2 ir label labels mask normals overlay right segmentation semantic "
    "thermal theora".split()
)


@dataclass(frozen=True, kw_only=True, slots=True)
class ImageTopics:
    """The topics of colour and depth."""

    color: Topic
    depth: Topic


def choose_images(
    path: object, topics: Sequence[Topic], options: SourceOptions, listed: Mapping[str, Sequence[str]] | None = None
) -> ImageTopics:
    """Return the topics of colour and depth: those `listed` by role, else the best names of one camera.

    Raises `RecordingError`: there is none, or the log lacks the one that was named; the message lists those it has.
    """
    images = [topic for topic in topics if topic.type_name in (IMAGE, COMPRESSED_IMAGE) and topic.num_messages != 0]
    colors = [topic for topic in images if "depth" not in topic.name.lower() and not _words(topic) & _NEITHER]
    depths = [topic for topic in images if "depth" in topic.name.lower() and not _words(topic) & _NEITHER]
    listed = listed or {}
    color = (
        _named(path, images, options.color_topic, "--color-topic")
        or _first_of(images, listed.get("color", ()))
        or max(colors, key=_color_rank, default=None)
    )
    depth = (
        _named(path, images, options.depth_topic, "--depth-topic")
        or _first_of(images, listed.get("depth", ()))
        or max(depths, key=lambda topic: _depth_rank(topic, color), default=None)
    )
    if color is None or depth is None:
        if any(topic.name == "svo_header" for topic in topics):
            raise RecordingError(
                f"{path} is a recording of a ZED camera (SVO2): depth and poses are not in it, the ZED SDK makes them; "
                f"with the SDK installed: hickory-stream live zed:{path}"
            )
        if not images:
            raise RecordingError(f"{path} has no images, neither colour nor depth; {_listed('topics', topics)}")
        role, option = ("colour", "--color-topic") if color is None else ("depth", "--depth-topic")
        raise RecordingError(f"{path} has no {role} topic; {_listed('image topics', images)}. Name it with {option}")
    return ImageTopics(color=color, depth=depth)


def pose_topics(
    path: object, topics: Sequence[Topic], options: SourceOptions, listed: Sequence[str] = ()
) -> list[Topic]:
    """Return the topics that may hold the camera's pose: the one that was named or listed, else all, except TF.

    Raises `NoPosesError`: there is neither pose nor TF; `RecordingError`: the topic that was named is not there.
    """
    if options.pose_topic == NO_TOPIC:
        raise NoPosesError(f"{path} is to be played without its poses (--pose-topic {NO_TOPIC})")
    posed = [topic for topic in topics if topic.type_name in (*POSE_TYPES, *TF) and topic.num_messages != 0]
    if not posed:
        raise NoPosesError(
            f"{path} has no poses: no topic of {', '.join((*POSE_TYPES, TF[0]))}; {_listed('topics', topics)}. "
            "--odometry depth estimates them"
        )
    named = _named(path, posed, options.pose_topic, "--pose-topic") or _first_of(posed, listed)
    return [named] if named else [topic for topic in posed if topic.type_name in POSE_TYPES]


def tf_topics(topics: Sequence[Topic]) -> list[Topic]:
    """Return the topics of transforms."""
    return [topic for topic in topics if topic.type_name in TF]


def camera_infos(topics: Sequence[Topic]) -> list[Topic]:
    """Return the topics of calibrations."""
    return [topic for topic in topics if topic.type_name == CAMERA_INFO]


def info_names(image: Topic) -> tuple[str, str]:
    """Return the two usual names of the calibration of an image topic: NAMESPACE/camera_info and TOPIC/camera_info."""
    base = re.sub(r"/(compressed|compressedDepth)$", "", image.name)
    return f"{base.rsplit('/', 1)[0]}/camera_info", f"{base}/camera_info"


def is_rectified(image: Topic) -> bool:
    """Return whether images are rectified according to the topic's name (`image_rect`, `color/rect/image`)."""
    return any(word.startswith("rect") for word in _words(image))


def _first_of(topics: Iterable[Topic], names: Sequence[str]) -> Topic | None:
    by_name = {topic.name: topic for topic in topics}
    return next((by_name[name] for name in names if name in by_name), None)


def _words(topic: Topic) -> set[str]:
    return set(re.split(r"[/_]+", topic.name.lower()))


def _color_rank(topic: Topic) -> tuple[int, int, str]:
    points = sum(_COLOR_POINTS.get(word, 0) for word in _words(topic))
    return points, topic.num_messages or 0, _reversed(topic.name)


def _depth_rank(topic: Topic, color: Topic | None) -> tuple[int, int, int, str]:
    shared = shared_parts(topic.name, color.name) if color else 0
    points = sum(_DEPTH_POINTS.get(word, 0) for word in _words(topic))
    return shared, points, topic.num_messages or 0, _reversed(topic.name)


def _reversed(name: str) -> str:
    return "".join(chr(0x10FFFF - ord(letter)) for letter in name)


def _named(path: object, topics: Iterable[Topic], name: str | None, option: str) -> Topic | None:
    if name is None:
        return None
    candidates = list(topics)
    found = next((topic for topic in candidates if topic.name == name), None)
    if found is None:
        raise RecordingError(f"{path} has no topic {name} for {option}; {_listed('it has', candidates)}")
    return found


def _listed(label: str, topics: Sequence[Topic]) -> str:
    if not topics:
        return f"{label}: none"
    entries = [
        f"{topic.name} ({topic.type_name or 'no type'}"
        + (f", {topic.num_messages} messages)" if topic.num_messages is not None else ")")
        for topic in topics[:20]
    ]
    more = f" and {len(topics) - 20} more" if len(topics) > 20 else ""
    return f"{label}: {', '.join(entries)}{more}"
