"""One playback: the asyncio event loop of the system.

    read ──frames──> map ──reports──> sinks (a thread each)
                      │ └──jobs──> shape workers (child processes)
                      └<──answers, by due stamp

`read` decides which frames are keyframes and decodes those ahead; `map` perceives a keyframe against the map as it is
after the one before, lets the core decide, and carries its effects out. Whatever takes longer than a millisecond runs
on a thread or in a child.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter, defaultdict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar, assert_never

import numpy as np

from hickory_stream.engine.channel import Channel, ChannelClosed
from hickory_stream.engine.crops import write_crop
from hickory_stream.engine.message_ledger import message_ledger
from hickory_stream.engine.pump import Pump
from hickory_stream.engine.shape_queue import ShapeQueue
from hickory_stream.errors import RecordingError
from hickory_stream.events import (
    CancelShape,
    ComputeFeatures,
    DropView,
    Effect,
    Event,
    FeaturesReady,
    FrameObserved,
    KeepView,
    PoseJumped,
    Publish,
    RequestShape,
    ShapeFailed,
    ShapeReady,
    SourceEnded,
    TimeJumped,
)
from hickory_stream.mapping.keyframes import Keyframe, is_keyframe
from hickory_stream.perception.perceive import Perceived, features_of, perceive
from hickory_stream.ports import Crop
from hickory_stream.records import Frame, FrameReport, MapSnapshot, RawFrame

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from hickory_stream.config import MapperConfig
    from hickory_stream.engine.session import MapFolder
    from hickory_stream.engine.sink_threads import SinkThread
    from hickory_stream.engine.workers import LocalWorkers
    from hickory_stream.mapping.core import MapperCore
    from hickory_stream.ports import FeatureExtractor, Segmenter, Source
    from hickory_stream.records import Decision, Observation

logger = logging.getLogger(__name__)
T = TypeVar("T")

_DECODED_AHEAD = 3


@dataclass(frozen=True, kw_only=True, slots=True)
class Progress:
    """Where a run is: for the bar. `frames` of `total` (None: unknown), `stamp_ns` of the log, `phase` in a word."""

    phase: str
    frames: int
    total: int | None
    keyframes: int
    objects: int
    open_shapes: int


@dataclass(frozen=True, kw_only=True, slots=True)
class _Read:
    """One frame on its way: `frame` and what was `prepared` where it is a keyframe.

    `jump` where time or the odometry jumped before it.
    """

    raw: RawFrame
    frame: Frame | None
    prepared: object
    jump: TimeJumped | PoseJumped | None


class Run:
    """Carries one source through the core. `run()` once; `stop()` from any task ends it early, in order."""

    def __init__(
        self,
        *,
        config: MapperConfig,
        core: MapperCore,
        segmenter: Segmenter,
        extractor: FeatureExtractor,
        folder: MapFolder,
        workers: LocalWorkers,
        sinks: Sequence[SinkThread],
        publish: Callable[[MapSnapshot], None],
        progress: Callable[[Progress], None],
    ) -> None:
        self._config = config
        self._core = core
        self._segmenter = segmenter
        self._extractor = extractor
        self._folder = folder
        self._sinks = sinks
        self._publish = publish
        self._progress = progress
        self._shapes = ShapeQueue(folder, workers, config.shapes)
        self._channel: Channel[_Read] = Channel(_DECODED_AHEAD)
        # One thread reads ahead, one perceives and decides, one writes views: what must come in order stays in order.
        self._reader = ThreadPoolExecutor(1, "read")
        self._thinker = ThreadPoolExecutor(1, "think")
        self._writer = ThreadPoolExecutor(1, "write")
        self._writing: asyncio.Future[None] | None = None
        self._stopped = asyncio.Event()
        self._stopped_s = 0.0
        self._snapshot: MapSnapshot | None = None
        self._num_frames = 0
        self._num_keyframes = 0
        self._total: int | None = None
        self._fates: Callable[[], Mapping[str, int]] = dict
        self.counts: Counter[str] = Counter()
        self.timings_s: defaultdict[str, float] = defaultdict(float)

    @property
    def num_keyframes(self) -> int:
        """How many keyframes were mapped."""
        return self._num_keyframes

    @property
    def is_complete(self) -> bool:
        """Whether the source was played to its end."""
        return not self._stopped.is_set()

    def ledger(self, source: Source) -> dict[str, dict[str, Any]]:
        """Return what became of every message, frame and job."""
        frames = {"read": self._num_frames, "keyframes": self._num_keyframes, **self.counts}
        messages = message_ledger(source, frames)
        counts = {"source": dict(source.ledger()), "frames": frames, "shapes": dict(self._shapes.counts)}
        return {**counts, "messages": messages} if messages else counts

    def timings(self) -> dict[str, float]:
        """Return seconds of work: by layer as in the paper's table of storage and time, and by stage."""
        steps = self._shapes.timings_s
        layers = {
            "layer1_s": self.timings_s["perceive"] + self.timings_s["decide"],
            "layer2_s": steps["reconstruct"],
            "layer3_s": steps["fit"],
            "layer4_s": steps["inflate"],
        }
        return {**layers, **{f"{stage}_s": seconds for stage, seconds in sorted(self.timings_s.items())}}

    def stop(self) -> None:
        """End the run after the frame at hand: no further frames, and no shape that takes longer than the grace."""
        if not self._stopped.is_set():
            self._stopped_s = time.monotonic()
            self._stopped.set()

    async def run(self, source: Source, *, rate: float | None, loops: int) -> None:
        """Play a source `loops` times.

        Raises:
            HickoryError: the source, the disk or the core failed; what was mapped so far was shown to the sinks.
        """
        info = source.info
        self._total = info.num_frames * loops if info.num_frames is not None else None
        self._fates = source.ledger
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self._read(source, Pump(rate), loops), name="read")
                group.create_task(self._map(), name="map")
        except ExceptionGroup as errors:
            raise errors.exceptions[0] from errors
        finally:
            self._reader.shutdown(wait=True)
            self._thinker.shutdown(wait=True)
            self._writer.shutdown(wait=True)

    # ---- read --------------------------------------------------------------------------------------------------------

    async def _read(self, source: Source, pump: Pump, loops: int) -> None:
        last: Keyframe | None = None
        last_ns: int | None = None
        offset = 0
        try:
            for _ in range(loops):
                frames = source.frames()
                index = offset
                while self.is_complete and (raw := await self._in(self._reader, next, frames, None)) is not None:
                    index = offset + raw.index
                    jump = self._jump(last_ns, raw)
                    last, last_ns = (None if jump else last), raw.stamp_ns
                    await pump.wait(raw.stamp_ns)
                    frame, prepared = None, None
                    if is_keyframe(last, raw.stamp_ns, raw.world_from_camera, self._config.keyframes):
                        frame = await self._decoded(raw, index)
                    if frame is not None:
                        last = Keyframe(stamp_ns=raw.stamp_ns, world_from_camera=raw.world_from_camera)
                        prepared = await self._in(self._reader, self._segmenter.prepare, frame)
                    raw = replace(raw, index=index)
                    await self._channel.send(_Read(raw=raw, frame=frame, prepared=prepared, jump=jump))
                offset = index + 1
        finally:
            await self._channel.close()

    def _jump(self, last_ns: int | None, raw: RawFrame) -> TimeJumped | PoseJumped | None:
        if last_ns is not None and not 0 <= raw.stamp_ns - last_ns <= self._config.run.time_jump_s * 1e9:
            self.counts["time_jumps"] += 1
            return TimeJumped(from_ns=last_ns, to_ns=raw.stamp_ns)
        if raw.after_from_before is not None:
            self.counts["pose_jumps"] += 1
            return PoseJumped(stamp_ns=raw.stamp_ns, after_from_before=raw.after_from_before)
        return None

    async def _decoded(self, raw: RawFrame, index: int) -> Frame | None:
        """Return the frame, None where its images are torn: counted, and the next frame is tried as keyframe."""
        started = time.perf_counter()
        try:
            frame = await self._in(self._reader, raw.decode)
        except RecordingError as error:
            self.counts["frames_undecodable"] += 1
            logger.warning("frame %d cannot be decoded: %s", index, error)
            return None
        self.timings_s["decode"] += time.perf_counter() - started
        return replace(frame, index=index)

    # ---- map ---------------------------------------------------------------------------------------------------------

    async def _map(self) -> None:
        last: RawFrame | None = None
        while True:
            try:
                read = await self._channel.receive()
            except ChannelClosed:
                break
            last = read.raw
            self._num_frames += 1
            if read.jump is not None:
                await self._commit_shapes(None)
                await self._handle(read.jump)
            if read.frame is None:
                await self._show(_plain_report(read.raw))
            else:
                await self._keyframe(read.raw, read.frame, read.prepared)
            self._tell("mapping")
        if last is not None:
            await self._end(last)

    async def _keyframe(self, raw: RawFrame, frame: Frame, prepared: object) -> None:
        self._num_keyframes += 1
        started = time.perf_counter()
        await self._commit_shapes(frame.stamp_ns)
        waited = time.perf_counter()
        prior = self._snapshot.submaps[0].observed_space if self._snapshot is not None else None
        perceived = await self._in(
            self._thinker, perceive, frame, prior, prepared, self._segmenter, self._config.perception
        )
        if not np.isfinite(frame.depth_m).any():
            self.counts["keyframes_without_depth"] += 1
        seen = time.perf_counter()
        event = FrameObserved(
            frame_index=frame.index,
            stamp_ns=frame.stamp_ns,
            world_from_camera=frame.world_from_camera,
            observations=perceived.observations,
            space=perceived.space,
            rejected=perceived.rejected,
        )
        published = await self._handle(event, frame, perceived.observations)
        ended = time.perf_counter()
        times = {"wait_for_shapes": waited - started, "perceive": seen - waited, "decide": ended - seen}
        for stage, seconds in times.items():
            self.timings_s[stage] += seconds
        if published is not None:
            await self._show(self._report(raw, frame, perceived, published, times))

    async def _handle(
        self, event: Event, frame: Frame | None = None, observations: Sequence[Observation] = ()
    ) -> Publish | None:
        """Let the core decide, carry out what it wants until it wants nothing more; return what it published."""
        published: Publish | None = None
        effects = await self._in(self._thinker, self._core.handle, event)
        while effects:
            answer: FeaturesReady | None = None
            # Pixels first: a job may need them.
            await self._keep_views([e for e in effects if isinstance(e, KeepView)], frame, observations)
            for effect in effects:
                if isinstance(effect, ComputeFeatures):
                    answer = await self._features(effect, frame, observations)
                elif isinstance(effect, Publish):
                    published = effect
                else:
                    await self._carry_out(effect)
            effects = await self._in(self._thinker, self._core.handle, answer) if answer is not None else []
        if published is not None:
            self._snapshot = published.snapshot
            self._publish(published.snapshot)
        return published

    async def _carry_out(self, effect: Effect) -> None:
        match effect:
            case KeepView() | ComputeFeatures() | Publish():
                return
            case DropView():
                self._folder.drop_view(effect.name)
            case RequestShape():
                await self._written()
                await self._shapes.request(effect)
            case CancelShape():
                self._shapes.cancel(effect.ticket)
            case _:
                assert_never(effect)

    async def _features(
        self, effect: ComputeFeatures, frame: Frame | None, observations: Sequence[Observation]
    ) -> FeaturesReady:
        assert frame is not None, "features are asked for while the frame is at hand"
        features = await self._in(
            self._thinker, features_of, frame, observations, effect.observation_indices, self._extractor
        )
        return FeaturesReady(frame_index=effect.frame_index, features=features)

    async def _keep_views(
        self, keeps: Sequence[KeepView], frame: Frame | None, observations: Sequence[Observation]
    ) -> None:
        if not keeps:
            return
        assert frame is not None, "views are kept while the frame is at hand"
        margin = self._config.run.crop_margin

        def write() -> None:
            for keep in keeps:
                write_crop(
                    self._folder.views, keep.view.name, crop_of(frame, observations[keep.observation_index], margin)
                )

        await self._written()
        self._writing = asyncio.get_running_loop().run_in_executor(self._writer, write)
        # A run that ends for another reason does not wait for it: its failure then is no news.
        self._writing.add_done_callback(lambda writing: writing.cancelled() or writing.exception())

    async def _written(self) -> None:
        """Return when the pixels of all views that were kept are written; raise what went wrong with them."""
        if self._writing is not None:
            writing, self._writing = self._writing, None
            await writing

    async def _commit_shapes(self, stamp_ns: int | None) -> None:
        """Tell the core of the shapes that are due at a stamp, None: of all that are open."""
        old = {o.id: o.shape for o in self._snapshot.objects} if self._snapshot is not None else {}
        while (event := await self._next_shape(stamp_ns)) is not None:
            await self._handle(event)
            replaced = old.get(event.object_id)
            if replaced is not None:
                self._folder.drop_shape(replaced.mesh_name)
            if stamp_ns is None:
                self._tell("shapes")

    async def _next_shape(self, stamp_ns: int | None) -> ShapeReady | ShapeFailed | None:
        """Return the next shape that is due; None where none is, or where a stop has no patience left for it."""
        due = asyncio.create_task(self._shapes.next_due(stamp_ns), name="next-shape")
        stopped = asyncio.create_task(self._stopped.wait(), name="stopped")
        try:
            await asyncio.wait({due, stopped}, return_when=asyncio.FIRST_COMPLETED)
            if not due.done():
                left_s = self._stopped_s + self._config.run.grace_s - time.monotonic()
                await asyncio.wait({due}, timeout=max(0.0, left_s))
            return due.result() if due.done() else None
        finally:
            due.cancel()
            stopped.cancel()
            await asyncio.gather(due, stopped, return_exceptions=True)

    async def _end(self, last: RawFrame) -> None:
        """Ask for and wait for the last shapes, and show the finished map as one more keyframe."""
        decisions: tuple[Decision, ...] = ()
        await self._written()
        if self.is_complete:
            published = await self._handle(SourceEnded(stamp_ns=last.stamp_ns))
            decisions = published.decisions if published is not None else ()
        await self._commit_shapes(None)
        self._snapshot = await self._in(self._thinker, self._core.snapshot)
        self._publish(self._snapshot)
        self._tell("saving")
        await self._show(
            replace(
                _plain_report(last),
                index=last.index + 1,
                keyframe_index=self._num_keyframes,
                color_bytes=None,
                decisions=decisions,
                snapshot=self._snapshot,
            )
        )

    # ---- what others are told ----------------------------------------------------------------------------------------

    async def _show(self, report: FrameReport) -> None:
        for sink in self._sinks:
            await sink.show(report)

    def _report(
        self, raw: RawFrame, frame: Frame, perceived: Perceived, published: Publish, times: dict[str, float]
    ) -> FrameReport:
        queues = [("queue/frames", self._channel.statistics().length), ("queue/shapes", self._shapes.num_open)]
        return replace(
            _plain_report(raw),
            keyframe_index=self._num_keyframes - 1,
            frame=frame,
            segmentation=perceived.segmentation,
            observations=perceived.observations,
            object_ids=published.object_ids,
            decisions=published.decisions,
            snapshot=published.snapshot,
            metrics=(
                *((f"time/{name}", seconds) for name, seconds in times.items()),
                *((name, float(length)) for name, length in queues),
                *((f"ledger/{fate}", float(number)) for fate, number in self._fates().items()),
                *published.metrics,
            ),
        )

    def _tell(self, phase: str) -> None:
        self._progress(
            Progress(
                phase=phase,
                frames=self._num_frames,
                total=self._total,
                keyframes=self._num_keyframes,
                objects=len(self._snapshot.objects) if self._snapshot is not None else 0,
                open_shapes=self._shapes.num_open,
            )
        )

    async def _in(self, executor: ThreadPoolExecutor, function: Callable[..., T], *arguments: object) -> T:
        return await asyncio.get_running_loop().run_in_executor(executor, function, *arguments)


def crop_of(frame: Frame, observation: Observation, margin: float) -> Crop:
    """Return the cut-out of a frame around an observation, with `margin` of its box more on every side."""
    x0, y0, x1, y1 = observation.box_px
    dx, dy = round((x1 - x0) * margin) + 2, round((y1 - y0) * margin) + 2
    left, top = max(0, x0 - dx), max(0, y0 - dy)
    right, bottom = min(frame.camera.width, x1 + dx), min(frame.camera.height, y1 + dy)
    mask = np.zeros((bottom - top, right - left), dtype=bool)
    mask[y0 - top : y1 - top, x0 - left : x1 - left] = observation.mask
    return Crop(
        rgb=frame.rgb[top:bottom, left:right],
        depth_m=frame.depth_m[top:bottom, left:right],
        mask=mask,
        camera=frame.camera.cropped(left, top, right, bottom),
        world_from_camera=frame.world_from_camera,
    )


def _plain_report(raw: RawFrame) -> FrameReport:
    return FrameReport(
        index=raw.index,
        stamp_ns=raw.stamp_ns,
        keyframe_index=None,
        camera=raw.camera,
        world_from_camera=raw.world_from_camera,
        color_bytes=raw.color_bytes,
    )
