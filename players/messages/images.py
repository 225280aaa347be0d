"""Image messages: headers, lazy decoding, and the first messages of a topic."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import RecordingError
from players.logs.containers import Topic
from players.messages.image_decoding import (
    COLOR_ENCODINGS,
    DEPTH_ENCODINGS,
    color_of_pixels,
    compressed_size,
    decode_color,
    decode_compressed_depth,
    depth_of_pixels,
    raw_pixels,
    rvl_size,
)
from players.messages.records import COMPRESSED_IMAGE, frame_name, header_stamp_ns

_UNITS_PER_M = 1000.0
"""Integer depth is millimetres (REP 118)."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LogImage:
    """An image message; `size` is (width, height) from its header, None if the header is damaged."""

    topic: str
    stamp_ns: int
    frame: str
    size: tuple[int, int] | None
    is_compressed: bool
    message: Any

    def __str__(self) -> str:
        return f"{self.topic} at {self.stamp_ns / 1e9:.3f} s"

    @property
    def encoding(self) -> str:
        """The encoding of raw pixels, or the format of a compressed image, as stated in the message."""
        return str(self.message.format if self.is_compressed else self.message.encoding)

    def data(self) -> bytes:
        """Return the compressed bytes."""
        return np.asarray(self.message.data, dtype=np.uint8).tobytes()


def image_of(topic: Topic, message: Any, stamp_ns: int | None = None) -> LogImage:
    """Return the image of a message of an image topic; `stamp_ns` replaces that of its header."""
    is_compressed = topic.type_name == COMPRESSED_IMAGE
    return LogImage(
        topic=topic.name,
        stamp_ns=header_stamp_ns(message) if stamp_ns is None else stamp_ns,
        frame=frame_name(message.header.frame_id),
        size=_compressed_size(message) if is_compressed else (int(message.width), int(message.height)),
        is_compressed=is_compressed,
        message=message,
    )


def check_color_encoding(image: LogImage) -> None:
    """Check that colour can be decoded; compressed colour is recognised by its bytes, not by its format string.

    Raises `RecordingError`: the encoding is not known.
    """
    if not image.is_compressed and image.encoding not in COLOR_ENCODINGS:
        raise RecordingError(
            f"{image.topic} is encoded as {image.encoding!r}; colour must be one of {', '.join(COLOR_ENCODINGS)}, "
            "or a CompressedImage of JPEG or PNG; name another topic with --color-topic"
        )


def check_depth_encoding(image: LogImage) -> None:
    """Check that depth can be decoded, to the right unit. Raises `RecordingError`: the encoding is not known."""
    # A compressed image is recognised by its bytes: drivers write the format string in many ways.
    if not image.is_compressed and image.encoding not in DEPTH_ENCODINGS:
        raise RecordingError(
            f"{image.topic} is encoded as {image.encoding!r}; depth must be one of {', '.join(DEPTH_ENCODINGS)}, "
            "or a CompressedImage of 16-bit PNG or RVL; name another topic with --depth-topic"
        )


def color_of(image: LogImage) -> NDArray[np.uint8]:
    """Return the pixels (H, W, 3) uint8 RGB.

    Raises `RecordingError`: the image is empty, torn, or of an encoding that is not known.
    """
    if image.is_compressed:
        return decode_color(image.data(), str(image))
    check_color_encoding(image)
    return color_of_pixels(raw_pixels(image.message, str(image)), image.encoding)


def depth_of(image: LogImage, units_per_m: float = _UNITS_PER_M) -> NDArray[np.float32]:
    """Return the depth (H, W) float32 in metres, NaN = no return; integers are divided by `units_per_m`.

    Raises `RecordingError`: the image is empty, torn, or of an encoding that is not known.
    """
    check_depth_encoding(image)
    if image.is_compressed:
        return decode_compressed_depth(image.data(), image.encoding, units_per_m, str(image))
    return depth_of_pixels(raw_pixels(image.message, str(image)), units_per_m)


def _compressed_size(message: Any) -> tuple[int, int] | None:
    # The size of a JPEG follows its tables and comments, which may be long.
    head = np.asarray(message.data[: 1 << 16], dtype=np.uint8).tobytes()
    return compressed_size(head) or compressed_size(head[12:]) or (rvl_size(head) if any(rvl_size(head)) else None)


_PROBE_IMAGES = 15
"""The number of images of each topic that are read for frame names, encodings and periods."""


@dataclass(slots=True)
class Probe:
    """The first messages of an image topic: the first image, header stamps and log times."""

    topic: Topic
    first: LogImage | None = None
    stamps_ns: list[int] = field(default_factory=list)
    log_ns: list[int] = field(default_factory=list)
    num_unreadable: int = 0

    @property
    def is_full(self) -> bool:
        """Whether enough images were read."""
        number = self.topic.num_messages
        return len(self.stamps_ns) >= (_PROBE_IMAGES if number is None else min(_PROBE_IMAGES, number))
