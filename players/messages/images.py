"""Image messages: headers, lazy decoding, and the first messages of a topic."""

import re
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import RecordingError
from players.logs.containers import Topic
from players.messages.image_decoding import (
    COLOR_ENCODINGS,
    DEPTH_ENCODINGS,
    JPEG,
    PNG,
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

_LEAST_DEPTH_M, _MOST_DEPTH_M = 0.05, 25.0
"""What a camera's depth may be in the middle."""

_COARSE_M = 0.09
# A temporal delimiter and the head of a sequence.
_AV1_START = b"\x12\x00\x0a\x0a"
_CODECS = {
    "h264": ("264", "avc"), "hevc": ("265", "hevc"), "vp8": ("vp8",), "vp9": ("vp9",), "libdav1d": ("av1",),
    "ffv1": ("ffv1",),
}  # fmt: skip

CODECS = "H.264, H.265, VP8, VP9, AV1, or FFV1 up to version 1"


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

    @property
    def is_picture(self) -> bool:
        """Whether a compressed image is JPEG or PNG, without the header of `compressedDepth`."""
        head = np.asarray(self.message.data[:8], dtype=np.uint8).tobytes()
        return head[:3] == JPEG or head == PNG

    @property
    def has_wide_pixels(self) -> bool:
        """Whether a compressed image is a PNG of one channel of 16 bits, or has the header of `compressedDepth`."""
        head = np.asarray(self.message.data[:64], dtype=np.uint8).tobytes()
        at = 0 if head[:8] == PNG else 12
        if head[at : at + 8] == PNG:
            return head[at + 24 : at + 26] == b"\x10\0"
        return head[:3] != JPEG and any(rvl_size(head))

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
    if image.is_compressed and (codec := codec_of(image.encoding, image.data())):
        raise RecordingError(
            f"{image.topic} is video ({codec}): pip install 'hickory-stream[video]' reads it; "
            "or name another topic with --color-topic"
        )
    is_depth = image.is_compressed and kind_of(image) == "depth"
    if is_depth or (not image.is_compressed and image.encoding not in COLOR_ENCODINGS):
        found = "holds depth" if is_depth else f"is encoded as {image.encoding!r}"
        raise RecordingError(
            f"{image.topic} {found}; colour must be one of {', '.join(COLOR_ENCODINGS)}, "
            "or a CompressedImage of JPEG or PNG; name another topic with --color-topic"
        )


def check_depth_encoding(image: LogImage) -> None:
    """Check that depth can be decoded, to the right unit. Raises `RecordingError`: the encoding is not known."""
    # A compressed image is recognised by its bytes: drivers write the format string in many ways.
    is_narrow = image.is_compressed and not image.has_wide_pixels
    if (is_narrow and image.is_picture) or (not image.is_compressed and image.encoding not in DEPTH_ENCODINGS):
        found = f"{'holds JPEG or PNG of 8 bits,' if is_narrow else 'is'} encoded as {image.encoding!r}"
        raise RecordingError(
            f"{image.topic} {found}; depth must be one of {', '.join(DEPTH_ENCODINGS)}, "
            "or a CompressedImage of 16-bit PNG or RVL; name another topic with --depth-topic"
        )


def codec_of(encoding: str, data: bytes) -> str:
    """Return FFmpeg's decoder of a packet of video, by its message's encoding or its first bytes; "" for others."""
    text = encoding.lower()
    for codec, words in _CODECS.items():
        if any(word in text for word in words):
            return codec
    if data[:4] == _AV1_START:
        return "libdav1d"
    # Annex B: a start code, and the type of its first unit.
    start = re.match(rb"\x00{2,3}\x01(.)", data[:5], re.DOTALL)
    return "" if start is None else "hevc" if start[1] in b"\x40\x42\x44\x46" else "h264"


def kind_of(image: LogImage) -> str:
    """Return "color" or "depth" by an image's encoding and pixels, "" for one that may be either or cannot be read."""
    if not image.is_compressed:
        if image.encoding not in ("16UC1", "32FC1"):  # mono16 is depth with some drivers
            return "color" if image.encoding in COLOR_ENCODINGS and image.encoding != "mono16" else ""
    elif not image.has_wide_pixels:
        return "color" if image.is_picture else ""
    try:
        depth_m = depth_of(image)
    except RecordingError:
        return ""
    # Thermal images have as many bits.
    returns = depth_m[np.isfinite(depth_m)]
    return "depth" if returns.size and _LEAST_DEPTH_M < np.median(returns) < _MOST_DEPTH_M else ""


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
    """The first messages of an image topic: images, header stamps and log times, and the first error."""

    topic: Topic
    images: list[LogImage] = field(default_factory=list)
    stamps_ns: list[int] = field(default_factory=list)
    log_ns: list[int] = field(default_factory=list)
    num_unreadable: int = 0
    error: str = ""

    @property
    def first(self) -> LogImage | None:
        """The first image that could be read."""
        return self.images[0] if self.images else None

    @property
    def size(self) -> tuple[int, int] | None:
        """The most frequent (width, height), the first of several."""
        sizes = Counter(image.size for image in self.images if image.size is not None)
        return sizes.most_common(1)[0][0] if sizes else None

    @property
    def is_full(self) -> bool:
        """Whether enough images were read."""
        number = self.topic.num_messages
        return len(self.stamps_ns) >= (_PROBE_IMAGES if number is None else min(_PROBE_IMAGES, number))


def check_decodes(probe: Probe, decode: Callable[[LogImage], Any], option: str) -> None:
    """Check that one of the first images can be decoded. Raises `RecordingError`: none can; the reason is the last."""
    for i, image in enumerate(probe.images, start=1):
        try:
            decode(image)
            return
        except RecordingError as error:
            if i == len(probe.images):
                number = f"none of the first {i} images" if i > 1 else "the only image"
                raise RecordingError(
                    f"{number} of {image.topic} can be decoded (format {image.encoding!r}): {error}; name another "
                    f"topic with {option}"
                ) from error


def check_depth_unit(probe: Probe, units_per_m: float) -> None:
    """Check the first, middle and last of the first images for depth that was cut to whole metres.

    Raises `RecordingError`: depth has few values in steps of 0.1 m or more, or is nearer than cameras see.
    """
    found = []
    for image in probe.images[:: max(1, len(probe.images) // 2)]:
        with suppress(RecordingError):
            depth_m = depth_of(image, units_per_m)
            found.append(np.unique(depth_m[np.isfinite(depth_m)]))
    values_m = np.unique(np.concatenate(found)) if found else np.zeros(0)
    if not values_m.size:
        return
    expected = "the fractions are lost; expected millimetres in 16UC1, or metres in 32FC1, as the camera measures them"
    step_m = float(np.diff(values_m).min(initial=np.inf))
    if values_m.size > 2 and step_m > _COARSE_M and np.abs(values_m * 10 - np.round(values_m * 10)).max() < 1e-3:
        steps = f"{values_m.size} values in steps of {step_m:g} m, up to {values_m[-1]:g} m"
        raise RecordingError(f"{probe.topic.name}: depth has only {steps}: {expected}")
    if values_m[-1] < _COARSE_M:
        raise RecordingError(
            f"{probe.topic.name}: depth ends at {values_m[-1]:g} m, since {units_per_m:g} units are taken for a metre. "
            f"If its numbers, up to {values_m[-1] * units_per_m:.0f}, are whole metres, {expected}; of any other unit, "
            "set depth_units_per_m in a --profile"
        )
