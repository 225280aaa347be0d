"""Roles of topics by type and by the content of their first images, then by name; `SourceOptions` overrides them."""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

from hickory_stream.errors import NoPosesError, RecordingError
from players.logs.containers import Topic, topic_name
from players.logs.robots import shared_parts
from players.messages.images import CODECS
from players.messages.records import CAMERA_INFO, COMPRESSED_IMAGE, IMAGE, POSE_TYPES, TF, VIDEOS
from players.options import NO_TOPIC, SourceOptions

_COLOR_POINTS = {"rgb": 8, "color": 8, "colour": 8, "left": 2, "rect": 2, "image": 1, "compressed": 1}
_DEPTH_POINTS = {"aligned": 8, "registered": 8, "rect": 2, "compresseddepth": 1, "compressed": -2}
_NEITHER = frozenset(
    "confidence disparity fisheye infra infra1 infra2 ir label labels mask normals overlay right segmentation semantic "
    "thermal theora".split()
)


class ImageTopics(NamedTuple):
    """The topics of colour and depth."""

    color: Topic
    depth: Topic


class Content(NamedTuple):
    """The content of a topic's first image: `kind` is "color", "depth", a codec, or "" if it is not known."""

    kind: str
    frame: str
    encoding: str = ""


def choose_images(
    path: object,
    topics: Sequence[Topic],
    options: SourceOptions,
    listed: Mapping[str, Sequence[str]] | None = None,
    contents: Mapping[str, Content] | None = None,
) -> ImageTopics:
    """Return the topics of colour and depth: those `listed` by role, else the best pair of one camera.

    Names tell the roles of topics without `contents`, and break ties.

    Raises `RecordingError`: there is none, or the log lacks the one that was named; the message lists those it has.
    """
    images = [topic for topic in topics if topic.type_name in (IMAGE, COMPRESSED_IMAGE) and topic.num_messages != 0]
    listed = listed or {}
    color = _named(path, images, options.color_topic, "--color-topic")
    depth = _named(path, images, options.depth_topic, "--depth-topic")
    color = color or _first_of([topic for topic in images if topic != depth], listed.get("color", ()))
    depth = depth or _first_of([topic for topic in images if topic != color], listed.get("depth", ()))
    is_depth = color is not None
    # If no topic has depth, one that has it in its name is refused by its encoding, later.
    for known in (contents or {}, {}):
        colors = [color] if color else [c for c in images if c != depth and _may_be("color", c, depth, known)]
        pairs = [
            (c, d)
            for c in ([color] if color else images)
            for d in ([depth] if depth else images)
            if c != d and (c == color or _may_be("color", c, d, known))
            if d == depth or _may_be("depth", d, c, known)
        ]
        if pairs:
            return ImageTopics(*max(pairs, key=partial(_rank, known)))
        is_depth |= bool(colors) and depth is None
    if any(topic.name == "svo_header" for topic in topics):
        raise RecordingError(
            f"{path} is a recording of a ZED camera (SVO2): depth and poses are not in it, the ZED SDK makes them; "
            f"with the SDK installed: hickory-stream live zed:{path}"
        )
    if videos := [topic for topic in topics if topic.type_name in VIDEOS]:
        content = (contents or {}).get(videos[0].name)
        is_known = content is None or content.kind
        how = "pip install 'hickory-stream[video]' reads it" if is_known else f"expected {CODECS}"
        encoding = f" ({content.encoding!r})" if content is not None else ""
        raise RecordingError(f"{path}: {videos[0].name} is video{encoding}: {how}")
    if not images:
        raise RecordingError(f"{path} has no images, neither colour nor depth; {_listed('topics', topics)}")
    role, option = ("depth", "--depth-topic") if is_depth else ("colour", "--color-topic")
    raise RecordingError(f"{path} has no {role} topic; {_listed('image topics', images)}. Name it with {option}")


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


def _words(topic: Topic) -> Counter[str]:
    return Counter(re.split(r"[/_]+", topic.name.lower()))


def is_neither(topic: Topic) -> bool:
    """Return whether images are neither colour nor depth according to the topic's name."""
    return bool(_words(topic).keys() & _NEITHER)


def _may_be(role: str, topic: Topic, other: Topic | None, contents: Mapping[str, Content]) -> bool:
    # Words of both topics name their camera, and tell nothing about their roles.
    own = _words(topic) - (_words(other) if other is not None else Counter())
    if own.keys() & _NEITHER:
        return False
    kind = contents[topic.name].kind if topic.name in contents else ""
    if kind in ("color", "depth"):
        return kind == role
    return any("depth" in word for word in own) == (role == "depth")


def _rank(contents: Mapping[str, Content], pair: tuple[Topic, Topic]) -> tuple[bool | int | str, ...]:
    color, depth = pair
    shared = shared_parts(color.name, depth.name)
    frames = {contents[topic.name].frame if topic.name in contents else "" for topic in (color, depth)}
    color_words, depth_words = _words(color), _words(depth)
    color_points = sum(_COLOR_POINTS.get(word, 0) - 4 * ("depth" in word) for word in color_words.elements())
    return (
        shared > 0 or (len(frames) == 1 and "" not in frames),
        any("depth" in word for word in depth_words),
        color_points,
        color.num_messages or 0,
        _reversed(color.name),
        shared,
        sum(_DEPTH_POINTS.get(word, 0) for word in depth_words),
        depth.num_messages or 0,
        _reversed(depth.name),
    )


def _reversed(name: str) -> str:
    return "".join(chr(0x10FFFF - ord(letter)) for letter in name)


def _named(path: object, topics: Iterable[Topic], name: str | None, option: str) -> Topic | None:
    if name is None:
        return None
    candidates = list(topics)
    found = next((topic for topic in candidates if topic.name == topic_name(name)), None)
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
