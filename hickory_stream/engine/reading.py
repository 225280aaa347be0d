"""From a source to the loop: frames on their way, decoded ahead in a playback, the newest ones in a live run."""

from __future__ import annotations

import logging
import time
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from hickory_stream.engine.channel import Channel, ChannelClosed
from hickory_stream.errors import RecordingError
from hickory_stream.events import TimeJumped
from hickory_stream.mapping.keyframes import Keyframe, is_keyframe

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Awaitable, Callable, Mapping

    from hickory_stream.config import MapperConfig
    from hickory_stream.engine.pacing import Pacer
    from hickory_stream.engine.step import FramePose
    from hickory_stream.geometry.depth_sensor import SensorConfig
    from hickory_stream.ports import Segmenter, Source
    from hickory_stream.records import Frame, RawFrame

logger = logging.getLogger(__name__)

_DECODED_AHEAD = 3
_LIVE_FRAMES = 32


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Read:
    """One frame on its way.

    `is_candidate`: stamps and poses make it a keyframe. In a playback it then comes with its `frame`, decoded, and what
    was `prepared` of it; a candidate that is torn is none. `counts` is what was lost since the frame before.
    `arrived_s` is when it was there (monotonic).
    """

    raw: RawFrame
    round_index: int
    first_index: int
    is_candidate: bool
    frame: Frame | None = None
    prepared: object = None
    counts: Mapping[str, int] = field(default_factory=dict)
    arrived_s: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Position:
    """Where reading goes on: after the frame `last_index` of a round, whose last keyframe was `keyframe`."""

    round_index: int = 0
    first_index: int = 0
    last_index: int = -1
    keyframe: Keyframe | None = None
    last_ns: int | None = None


def time_jump(
    last: FramePose | None, read: Read, *, round_index: int, first_ns: int | None, most_s: float
) -> TimeJumped | None:
    """Return the jump of time before a frame, None where its stamp follows that of the frame before.

    `round_index` is that of the frame before, `first_ns` the first stamp of all; a gap of up to `most_s` is none.
    """
    if last is None or first_ns is None:
        return None
    from_ns, to_ns = last.stamp_ns, read.raw.stamp_ns
    if read.round_index != round_index:
        return TimeJumped(from_ns=from_ns, to_ns=to_ns, kind="loop")
    if 0 <= to_ns - from_ns <= most_s * 1e9:
        return None
    return TimeJumped(from_ns=from_ns, to_ns=to_ns, kind="restart" if to_ns < first_ns else "seek")


def playback_channel() -> Channel[Read]:
    """Return the channel of a playback: few frames, decoded, none lost."""
    return Channel(_DECODED_AHEAD)


def live_channel() -> Channel[Read]:
    """Return the channel of a live run: a second of frames, still compressed, the newest ones."""
    return Channel(_LIVE_FRAMES, "drop_oldest")


class Reader:
    """Reads a source into a channel until it ends or `stopped` is set; `on_reader` runs a function on its thread."""

    def __init__(
        self,
        config: MapperConfig,
        segmenter: Segmenter,
        channel: Channel[Read],
        stopped: asyncio.Event,
        on_reader: Callable[..., Awaitable[object]],
    ) -> None:
        self._config = config
        self._segmenter = segmenter
        self._channel = channel
        self._stopped = stopped
        self._on_reader = on_reader
        self.decode_s = 0.0
        # Since the last frame that was sent.
        self.lost: Counter[str] = Counter()

    async def play(self, source: Source, pacer: Pacer, loops: int, start: Position) -> None:
        """Read `loops` rounds, from a position on, decoding keyframes ahead; waits while the channel is full."""
        keyframe, last_ns = start.keyframe, start.last_ns
        offset = start.first_index
        index = start.last_index
        lost = self.lost
        try:
            for round_index in range(start.round_index, loops):
                frames = source.frames()
                while not self._stopped.is_set() and (raw := await self._next(frames)) is not None:
                    index = offset + raw.index
                    if index <= start.last_index:
                        continue
                    if raw.goes_back:
                        # The map is another one then: what it has seen last is not this.
                        keyframe, last_ns = None, None
                    if self._is_late(last_ns, raw.stamp_ns):
                        lost["frames_late"] += 1
                        continue
                    last_ns = raw.stamp_ns
                    await pacer.wait(raw.stamp_ns, self._stopped)
                    frame, prepared = None, None
                    if is_keyframe(keyframe, raw.stamp_ns, raw.world_from_camera, self._config.keyframes):
                        frame = await self._decoded(raw, index)
                        lost["frames_undecodable"] += frame is None
                    if frame is not None:
                        keyframe = Keyframe(stamp_ns=raw.stamp_ns, world_from_camera=raw.world_from_camera)
                        prepared = await self._on_reader(self._segmenter.prepare, frame)
                    read = Read(
                        raw=replace(raw, index=index),
                        round_index=round_index,
                        first_index=offset,
                        is_candidate=frame is not None,
                        frame=frame,
                        prepared=prepared,
                        counts={name: count for name, count in lost.items() if count},
                        arrived_s=time.monotonic(),
                    )
                    lost.clear()
                    await self._channel.send(read)
                offset = index + 1
                last_ns = None
        except ChannelClosed:
            pass  # the other side has ended
        finally:
            await self._channel.close()

    async def follow(self, source: Source, pacer: Pacer, loops: int, counts: Counter[str]) -> None:
        """Read a source as it comes: never waits for the map, drops the oldest frames, and counts them."""
        keyframe: Keyframe | None = None
        last_ns: int | None = None
        offset = index = 0
        try:
            for round_index in range(loops):
                frames = source.frames()
                while not self._stopped.is_set() and (raw := await self._next(frames)) is not None:
                    index = offset + raw.index
                    await pacer.wait(raw.stamp_ns, self._stopped)
                    counts["read"] += 1
                    if self._is_late(last_ns, raw.stamp_ns):
                        counts["frames_late"] += 1
                        continue
                    last_ns = raw.stamp_ns
                    wanted = is_keyframe(keyframe, raw.stamp_ns, raw.world_from_camera, self._config.keyframes)
                    if wanted:
                        keyframe = Keyframe(stamp_ns=raw.stamp_ns, world_from_camera=raw.world_from_camera)
                    read = Read(
                        raw=replace(raw, index=index),
                        round_index=round_index,
                        first_index=offset,
                        is_candidate=wanted,
                        arrived_s=time.monotonic(),
                    )
                    if await self._channel.send(read) is not None:
                        counts["frames_dropped"] += 1
                offset = index + 1
                last_ns = None
        except ChannelClosed:
            pass
        finally:
            await self._channel.close()

    async def _next(self, frames: object) -> RawFrame | None:
        raw: RawFrame | None = await self._on_reader(next, frames, None)  # type: ignore[assignment]
        return raw

    def _is_late(self, last_ns: int | None, stamp_ns: int) -> bool:
        """Return whether a frame comes after a younger one, but not so much that the clock must have gone back."""
        return last_ns is not None and 0 < last_ns - stamp_ns <= self._config.run.late_s * 1e9

    async def _decoded(self, raw: RawFrame, index: int) -> Frame | None:
        """Return the frame, None where its images are torn: the next frame is tried as keyframe."""
        started = time.perf_counter()
        try:
            frame: Frame = await self._on_reader(raw.decode)  # type: ignore[assignment]
        except RecordingError as error:
            logger.warning("frame %d cannot be decoded: %s", index, error)
            return None
        self.decode_s += time.perf_counter() - started
        return sensed(frame, index, self._config.sensor)


def sensed(frame: Frame, index: int, config: SensorConfig) -> Frame:
    """Return a decoded frame under its number in the run, its depth as the configured sensor has it."""
    sensor = config.over(frame.sensor)
    if sensor == frame.sensor:
        return replace(frame, index=index)
    # The source took its own bias off.
    beyond = replace(sensor, bias_m=sensor.bias_m - frame.sensor.bias_m)
    return replace(frame, index=index, sensor=sensor, depth_m=beyond.returns(frame.depth_m))
