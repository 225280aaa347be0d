"""Video in a log as raw images: each packet becomes a `sensor_msgs/Image`, with PyAV (an extra).

All packets are decoded in the order of the log, since pictures depend on earlier ones.
"""

from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from players.logs.containers import Log, LogMessage, UnreadableMessageError, deserialize, first_messages, own_types
from players.logs.joined_log import JoinedLog
from players.logs.log_damage import Flaws
from players.logs.log_parts import parts_of
from players.messages.images import codec_of
from players.messages.records import COMPRESSED_IMAGE, IMAGE, VIDEOS

# Lossless depth; H.264 has its ten bits with colour that is grey everywhere.
_DEPTHS = ("gray10le", "gray12le", "gray16le")
_WITH_COLOR = {"yuv420p10le": 512, "yuv420p12le": 2048}


def with_video(log: Log) -> Log:
    """Return the log with raw images in place of video, or itself, if it has none or PyAV is not installed."""
    packets = {name: packet_of(m) for name, m in first_messages(log, (COMPRESSED_IMAGE, *VIDEOS)).items()}
    codecs = {name: codec for name, packet in packets.items() if (codec := codec_of(packet.encoding, packet.data))}
    if not codecs:
        return log
    try:
        import av
    except ImportError:
        return log
    return VideoLog(log, codecs, av)


class VideoLog(JoinedLog):
    """A `Log` whose topics of video hold raw images; packets that give none are noted as lost."""

    def __init__(self, log: Log, codecs: dict[str, str], av: Any) -> None:
        super().__init__(log.path, log.kind, [log])
        self._codecs, self._av, self._lost = codecs, av, Flaws("video")
        self._sources = {topic.name: topic for topic in log.topics}
        self.topics = tuple(
            replace(t, type_name=IMAGE, wire="cdr", definition_format="none", definition="", foreign_type="")
            if t.name in codecs
            else t
            for t in log.topics
        )

    @property
    def flaws(self) -> Flaws:
        """The flaws of the log, and the packets without a picture."""
        flaws = super().flaws
        for flaw in self._lost:
            flaws.add(flaw)
        return flaws

    def messages(self, topics: Collection[str]) -> Iterator[LogMessage]:
        """Yield the messages of some topics in the order of the log."""
        decoders = {name: _Decoder(self._av, self._codecs[name]) for name in topics if name in self._codecs}
        parts, part = parts_of(self), None
        for message in self.logs[0].messages(topics):
            decoder = decoders.get(message.topic)
            if decoder is None:
                yield message
                continue
            if parts is not None and parts.at(message.log_ns) != part:
                # A part begins in the middle of a video.
                part = parts.at(message.log_ns)
                decoders = {name: _Decoder(self._av, self._codecs[name]) for name in decoders}
                decoder = decoders[message.topic]
            decoder.num_packets += 1
            with suppress(UnreadableMessageError):
                packet = packet_of(deserialize(self._sources[message.topic], message.data))
                for log_ns, data in decoder.pictures(message.log_ns, packet):
                    yield LogMessage(message.topic, log_ns, data)
        for i, (name, decoder) in enumerate(sorted(decoders.items())):
            for log_ns, data in decoder.pictures(0, None):
                yield LogMessage(name, log_ns, data)
            if parts is None and (lost := decoder.num_packets - decoder.num_pictures):
                packets = f"{decoder.num_packets} packets of {name} ({decoder.codec})"
                what = f"{lost} of {packets} give no picture, as before a key frame"
                self._lost.note(i, what, 0, {name: lost})


class _Packet(NamedTuple):
    stamp: Any
    frame: str
    encoding: str
    data: bytes
    size: tuple[int, int] | None


class _Decoder:
    def __init__(self, av: Any, codec: str) -> None:
        self.num_packets, self.num_pictures, self.codec = 0, 0, codec
        self._av = av
        self._waiting: dict[int, tuple[int, _Packet]] = {}
        self._context = av.CodecContext.create(codec, "r")
        self._context.thread_type = "SLICE"  # Threads by frame would delay the pictures.

    def pictures(self, log_ns: int, packet: _Packet | None) -> Iterator[tuple[int, bytes]]:
        # The pictures that a packet completes, with their log times; None ends the stream.
        coded = None
        if packet is not None:
            coded = self._av.Packet(packet.data)
            coded.pts = self.num_packets
            if packet.size is not None and not self._context.is_open:
                self._context.width, self._context.height = packet.size  # FFV1 does not repeat its size
            self._waiting[self.num_packets] = log_ns, packet
        with suppress(self._av.FFmpegError):
            for picture in self._context.decode(coded):
                if picture.pts in self._waiting and not picture.is_corrupt:
                    log_ns, packet = self._waiting.pop(picture.pts)
                    self.num_pictures += 1
                    yield log_ns, _serialized(packet, picture)


def packet_of(message: Any) -> _Packet:
    """Return the packet of a message of video."""
    # Foxglove's video has no header, and the packets of ffmpeg_image_transport have an encoding.
    header = getattr(message, "header", None)
    stamp, frame = (header.stamp, header.frame_id) if header is not None else (message.timestamp, message.frame_id)
    encoding = message.format if hasattr(message, "format") else message.encoding
    size = (message.width, message.height) if hasattr(message, "width") else None
    return _Packet(stamp, frame, encoding, np.asarray(message.data, dtype=np.uint8).tobytes(), size)


def _is_depth(picture: Any) -> bool:
    middle = _WITH_COLOR.get(picture.format.name)
    return picture.format.name in _DEPTHS or (
        middle is not None and all((_plane(picture, i) == middle).all() for i in (1, 2))
    )


def _plane(picture: Any, i: int) -> NDArray[np.uint16]:
    plane = picture.planes[i]
    rows = np.frombuffer(plane, dtype="<u2").reshape(-1, plane.line_size // 2)
    return rows[: plane.height, : plane.width]


def _serialized(packet: _Packet, picture: Any) -> bytes:
    store = own_types("cdr")
    if _is_depth(picture):
        pixels, encoding = _plane(picture, 0), "16UC1"
    else:
        pixels, encoding = picture.to_ndarray(format="rgb24"), "rgb8"
    data = np.ascontiguousarray(pixels).view(np.uint8).ravel()
    stamp = store.types["builtin_interfaces/msg/Time"](sec=packet.stamp.sec, nanosec=packet.stamp.nanosec)
    image = store.types[IMAGE](
        header=store.types["std_msgs/msg/Header"](stamp=stamp, frame_id=packet.frame),
        height=picture.height,
        width=picture.width,
        encoding=encoding,
        is_bigendian=0,
        step=len(data) // picture.height,
        data=data,
    )
    return bytes(store.serialize_cdr(image, IMAGE))
