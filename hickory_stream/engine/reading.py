"""Reads a source for the event loop: decoded ahead in a playback, the newest frames in a live run."""

import asyncio
import logging
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hickory_stream.config import MapperConfig
from hickory_stream.engine.async_tools import Channel, ChannelClosed, Pacer, StopRequest, on_thread
from hickory_stream.engine.keyframe_places import keyframe_surface
from hickory_stream.engine.modes import Mode
from hickory_stream.errors import ModelError, RecordingError
from hickory_stream.geometry.depth_sensor import DepthSensor, SensorConfig
from hickory_stream.geometry.rigid import both_jumps
from hickory_stream.map_folder.history.resume import Position
from hickory_stream.mapping.rules.keyframes import Keyframe, is_keyframe
from hickory_stream.perception.space import free_space
from hickory_stream.ports import FeatureExtractor, Segmenter, Source, shared_by
from hickory_stream.poses.surface_image import SurfaceImage
from hickory_stream.poses.visual_motion import keypoints_of
from hickory_stream.records import Frame, Keypoints, RawFrame

logger = logging.getLogger(__name__)

T = TypeVar("T")

_FRAMES_AHEAD = 16
"""More than lie between two keyframes at 30 Hz: with fewer, one is only decoded when that before it is mapped."""
_DECODED_AHEAD = 3
"""Of these one is mapped. Where frames share runs of a network, one run is computed, and the next one fills."""
_LIVE_FRAMES = 32


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Prefetched:
    """Parts of a keyframe that need no map, computed while earlier keyframes are mapped; None if not computed.

    `patches` (h, w, D) are features. `prepared` (of the segmenter), `keypoints` and `free_keys` fit the pose as read.
    """

    prepared: object = None
    patches: NDArray[np.float32] | None = None
    surface: SurfaceImage | None = None
    keypoints: Keypoints | None = None
    free_keys: NDArray[np.int64] | None = None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class QueuedFrame:
    """A queued frame."""

    raw: RawFrame
    round_index: int
    first_index: int
    #: Stamp and pose make it a keyframe; it is not torn.
    is_candidate: bool
    #: Decoded, for a candidate of a playback.
    frame: Frame | None = None
    ahead: Prefetched = field(default_factory=Prefetched)
    #: Computes `ahead`, of a playback.
    pending: asyncio.Task[Prefetched | ModelError] | None = None
    is_corrupt: bool = False
    #: A network failed on it.
    has_failed: bool = False
    #: Losses since the frame before.
    counts: Mapping[str, int] = field(default_factory=dict)
    #: Monotonic time of arrival.
    arrived_s: float = 0.0


class Reader:
    """Reads a source on a thread into a channel, until the source or the run ends.

    A playback queues few frames, fewer of them decoded, and waits. A live run queues the newest second, compressed.
    Masks and features have threads of their own: those of several decoded frames are computed side by side, and may
    share runs of a network. A playback at a rate does the same, so that its map is the same.
    """

    def __init__(
        self, config: MapperConfig, segmenter: Segmenter, extractor: FeatureExtractor, stop: StopRequest, *, mode: Mode
    ) -> None:
        self._config = config
        self._segmenter = segmenter
        self._extractor = extractor
        self._stop = stop
        self._mode = mode
        num_masks, num_features = (1, 1) if mode == "live" else (shared_by(segmenter), shared_by(extractor))
        most = max(num_masks, num_features)
        self._channel: Channel[QueuedFrame] = (
            Channel(_LIVE_FRAMES, "drop_oldest") if mode == "live" else Channel(_FRAMES_AHEAD * most)
        )
        self._room = asyncio.Semaphore(_DECODED_AHEAD if most == 1 else 1 + 2 * most)
        self._thread = ThreadPoolExecutor(1, "read")
        # Not the thread that reads: a source may wait for its next frame.
        self._ahead_thread = ThreadPoolExecutor(1, "ahead")
        self._masks_thread, self._features_thread = _threads(num_masks, "masks"), _threads(num_features, "features")
        self._has_worked = False
        #: The odometry's jumps before dropped frames, for the next one that is taken.
        self._lost_jump: NDArray[np.float64] | None = None
        self.decode_s = 0.0
        #: Losses since the last queued frame (playback).
        self.lost: Counter[str] = Counter()
        #: Read and lost frames (live).
        self.counts: Counter[str] = Counter()

    @property
    def num_waiting(self) -> int:
        """Number of queued frames."""
        return self._channel.statistics().length

    async def read(self, source: Source, *, rate: float | None, loops: int, start: Position) -> None:
        """Read `loops` rounds of a source; a playback begins at a position."""
        try:
            async with asyncio.TaskGroup() as group:
                with suppress(ChannelClosed):  # the other side has ended
                    if self._mode == "live":
                        await self._follow(source, Pacer(rate), loops)
                    else:
                        await self._play(source, Pacer(rate), loops, start, group)
        except ExceptionGroup as error:
            raise error.exceptions[0] from error
        finally:
            await self._channel.close()

    async def take(self) -> list[QueuedFrame] | None:
        """Return queued frames, one in a playback, waiting for the first; None at the end."""
        try:
            if self._mode == "live":
                first, *others = await self._channel.receive_all()
                if self._lost_jump is not None:
                    jump = both_jumps(self._lost_jump, first.raw.after_from_before)
                    first, self._lost_jump = replace(first, raw=replace(first.raw, after_from_before=jump)), None
                return [first, *others]
            read = await self._channel.receive()
        except ChannelClosed:
            return None
        if read.frame is not None:
            self._room.release()
        if read.pending is None:
            return [read]
        ahead = self.accepted(await read.pending, read.raw.index)
        if ahead is None:
            return [replace(read, frame=None, pending=None, is_candidate=False, has_failed=True)]
        return [replace(read, ahead=ahead, pending=None)]

    def accepted(self, found: T | ModelError, index: int) -> T | None:
        """Return what networks found in a frame, None if one failed after others of the run worked.

        Raises `ModelError`: none has worked yet.
        """
        if not isinstance(found, ModelError):
            self._has_worked = True
            return found
        if not self._has_worked:
            raise found
        logger.warning("frame %d is left out: %s", index, found)
        return None

    async def ahead(self, frame: Frame) -> Prefetched | ModelError:
        """Return what a keyframe needs that does not depend on the map, or why a network failed."""
        config = self._config
        surface_of = keyframe_surface if config.registration.enabled else lambda _: None
        points_of = keypoints_of if config.mapping.submaps.searches_loops else lambda _: None
        try:
            # Those of one thread run in this order.
            surface, prepared, patches, keypoints, free_keys = await asyncio.gather(
                on_thread(self._ahead_thread, surface_of, frame),
                on_thread(self._masks_thread, self._segmenter.prepare, frame),
                on_thread(self._features_thread, self._extractor.extract, np.asarray(frame.rgb)),
                on_thread(self._features_thread, points_of, frame),
                on_thread(self._ahead_thread, free_space, frame, config.perception.space, config.mapping.voxels),
            )
        except ModelError as error:
            return error
        return Prefetched(prepared=prepared, patches=patches, surface=surface, keypoints=keypoints, free_keys=free_keys)

    async def end(self) -> None:
        """Accept no more frames."""
        await self._channel.close()
        self._room.release()  # a waiting sender finds the channel closed

    def close(self) -> None:
        """Wait for the threads to end."""
        for thread in (self._thread, self._ahead_thread, self._masks_thread, self._features_thread):
            thread.shutdown(wait=True)

    async def _play(self, source: Source, pacer: Pacer, loops: int, start: Position, group: asyncio.TaskGroup) -> None:
        keyframe, last_ns = start.keyframe, start.last_ns
        offset, index = start.first_index, start.last_index
        for round_index in range(start.round_index, loops):
            frames = source.frames()
            while not self._stop.is_requested and (raw := await self._next(frames)) is not None:
                index = offset + raw.index
                if index <= start.last_index:
                    continue
                if raw.goes_back:
                    # The map goes back, too: it has not seen the last keyframe.
                    keyframe, last_ns = None, None
                if self._is_late(last_ns, raw.stamp_ns):
                    self.lost["frames_late"] += 1
                    continue
                last_ns = raw.stamp_ns
                await pacer.wait(raw.stamp_ns, self._stop.event)
                frame, pending, is_corrupt = None, None, False
                if is_keyframe(keyframe, raw.stamp_ns, raw.world_from_camera, self._config.keyframes):
                    await self._room.acquire()
                    frame = await self._decoded(raw, index)
                    is_corrupt = frame is None
                    if is_corrupt:
                        self._room.release()
                if frame is not None:
                    keyframe = Keyframe(stamp_ns=raw.stamp_ns, world_from_camera=raw.world_from_camera)
                    pending = group.create_task(self.ahead(frame), name=f"ahead-{index}")
                queued = QueuedFrame(
                    raw=replace(raw, index=index, decode=_released),
                    round_index=round_index,
                    first_index=offset,
                    is_candidate=frame is not None,
                    frame=frame,
                    pending=pending,
                    is_corrupt=is_corrupt,
                    counts=dict(self.lost),
                    arrived_s=time.monotonic(),
                )
                self.lost.clear()
                await self._channel.send(queued)
            offset = index + 1
            last_ns = None

    async def _follow(self, source: Source, pacer: Pacer, loops: int) -> None:
        keyframe: Keyframe | None = None
        last_ns: int | None = None
        offset = index = 0
        for round_index in range(loops):
            frames = source.frames()
            while not self._stop.is_requested and (raw := await self._next(frames)) is not None:
                index = offset + raw.index
                await pacer.wait(raw.stamp_ns, self._stop.event)
                self.counts["read"] += 1
                if self._is_late(last_ns, raw.stamp_ns):
                    self.counts["frames_late"] += 1
                    continue
                last_ns = raw.stamp_ns
                wanted = is_keyframe(keyframe, raw.stamp_ns, raw.world_from_camera, self._config.keyframes)
                if wanted:
                    keyframe = Keyframe(stamp_ns=raw.stamp_ns, world_from_camera=raw.world_from_camera)
                queued = QueuedFrame(
                    raw=replace(raw, index=index),
                    round_index=round_index,
                    first_index=offset,
                    is_candidate=wanted,
                    arrived_s=time.monotonic(),
                )
                dropped = await self._channel.send(queued)
                if dropped is not None:
                    self.counts["frames_dropped"] += 1
                    self._lost_jump = both_jumps(self._lost_jump, dropped.raw.after_from_before)
            offset = index + 1
            last_ns = None

    async def _next(self, frames: Iterator[RawFrame]) -> RawFrame | None:
        raw: RawFrame | None = await on_thread(self._thread, next, frames, None)
        return raw

    def _is_late(self, last_ns: int | None, stamp_ns: int) -> bool:
        """Return whether a frame is out of order: older than the one before, but by less than a jump of the clock."""
        return last_ns is not None and 0 < last_ns - stamp_ns <= self._config.run.max_late_s * 1e9

    async def _decoded(self, raw: RawFrame, index: int) -> Frame | None:
        started = time.perf_counter()
        try:
            frame = await on_thread(self._thread, raw.decode)
        except RecordingError as error:
            logger.warning("frame %d cannot be decoded: %s", index, error)
            return None
        self.decode_s += time.perf_counter() - started
        return sensed(frame, index, self._config.sensor)


def _released() -> Frame:
    raise AssertionError("a playback has decoded its keyframes")  # frames in the queue hold no images of the log


def _threads(num_sharing: int, name: str) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1 if num_sharing == 1 else 2 * num_sharing, name)


def sensed(frame: Frame, index: int, config: SensorConfig) -> Frame:
    """Return a decoded frame under its number in the run, with depth by the configured sensor."""
    sensor = _sensor_of(config, frame.sensor)
    if sensor == frame.sensor:
        return replace(frame, index=index)
    # The source took its own bias off.
    beyond = replace(sensor, bias_m=sensor.bias_m - frame.sensor.bias_m)
    return replace(frame, index=index, sensor=sensor, depth_m=beyond.returns(frame.depth_m))


@cache
def _sensor_of(config: SensorConfig, given: DepthSensor) -> DepthSensor:
    # Cached, so that it warns once.
    sensor = config.over(given)
    if sensor.min_m < given.min_m or sensor.max_m > given.max_m:
        text = "mapper.sensor asks for %g to %g m, but the log's profile keeps depth of %g to %g m: change it there"
        logger.warning(text, sensor.min_m, sensor.max_m, given.min_m, given.max_m)
    return sensor
