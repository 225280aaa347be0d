"""One run: the asyncio event loop of the system.

    read ──frames──> map ──reports──> sinks (a thread each)
                      │ │└──jobs──> shape workers (child processes)
                      │ └<──answers, by due stamp (playback) or as they arrive (live)
                      └──steps──> journal (a thread)

`read` decides which frames are keyframes and, in a playback, decodes those ahead; `map` perceives a keyframe against
the map as it is after the one before, lets the core decide, and carries its effects out. Whatever takes longer than a
millisecond runs on a thread or in a child. A playback waits wherever something is full; a live run never does: it maps
the newest keyframe and counts what it left out.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter, defaultdict, deque
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Literal, TypeVar, assert_never

import numpy as np
import psutil

from hickory_stream.caches import cache_folder
from hickory_stream.engine.channel import ChannelClosed
from hickory_stream.engine.corrections import checked_places
from hickory_stream.engine.crops import write_crop
from hickory_stream.engine.first_run import compile_kernels
from hickory_stream.engine.frame_reports import final_report, keyframe_report, plain_report
from hickory_stream.engine.history.rewind import rewound_to
from hickory_stream.engine.keyframe_images import color_of, crop_of
from hickory_stream.engine.loop_delay import LoopDelay
from hickory_stream.engine.pacing import Pacer
from hickory_stream.engine.reading import Position, Read, Reader, live_channel, playback_channel, sensed, time_jump
from hickory_stream.engine.recorder import Recorder, Unwritten
from hickory_stream.engine.report_poses import in_map_frame
from hickory_stream.engine.run_accounts import run_ledger, run_timings
from hickory_stream.engine.run_progress import Progress
from hickory_stream.engine.shape_cache import ShapeCache
from hickory_stream.engine.shape_queue import ShapeQueue
from hickory_stream.engine.step import Checkpoint, FramePose, JournalEntry, Step, StepKind, Told
from hickory_stream.errors import InputError, RecordingError
from hickory_stream.events import (
    CancelShape,
    ComputeFeatures,
    DropView,
    Effect,
    Event,
    FeaturesReady,
    KeepView,
    PoseJumped,
    PosesCorrected,
    Publish,
    RequestShape,
    ShapeFailed,
    ShapeReady,
    SourceEnded,
)
from hickory_stream.mapping.keyframes import Keyframe, is_keyframe
from hickory_stream.perception.perceive import Perceived, features_of, perceive
from hickory_stream.ports import interrupt

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from hickory_stream.config import MapperConfig
    from hickory_stream.engine.history.resume_point import ResumePoint
    from hickory_stream.engine.journal import JournalWriter
    from hickory_stream.engine.map_folder import MapFolder
    from hickory_stream.engine.sink_threads import SinkThread
    from hickory_stream.engine.workers import ShapeWorkers
    from hickory_stream.geometry.camera import Camera
    from hickory_stream.mapping.core import MapperCore
    from hickory_stream.ports import FeatureExtractor, Segmenter, Source
    from hickory_stream.records import Decision, Frame, FrameReport, MapSnapshot, Observation, RawFrame

logger = logging.getLogger(__name__)
T = TypeVar("T")

Mode = Literal["playback", "live"]
_PROCESS = psutil.Process()


class Run:
    """Carries one source through the core. `run()` once; `stop()` from any task ends it early, in order."""

    def __init__(
        self,
        *,
        config: MapperConfig,
        mode: Mode,
        core: MapperCore,
        segmenter: Segmenter,
        extractor: FeatureExtractor,
        folder: MapFolder,
        journal: JournalWriter,
        workers: ShapeWorkers,
        sinks: Sequence[SinkThread],
        publish: Callable[[MapSnapshot], None],
        progress: Callable[[Progress], None],
        continued: ResumePoint | None = None,
    ) -> None:
        self._config = config
        self._mode = mode
        self._core = core
        self._segmenter = segmenter
        self._extractor = extractor
        self._folder = folder
        self._workers = workers
        self._sinks = sinks
        self._publish = publish
        self._progress = progress
        cache = ShapeCache(cache_folder("shapes")) if config.run.shape_cache else None
        self._shapes = ShapeQueue(folder, workers, config.shapes, cache)
        self._recorder = Recorder(folder, journal)
        self._unwritten = Unwritten()
        self._corrections: deque[dict[int, NDArray[np.float64]]] = deque()
        self._channel = live_channel() if mode == "live" else playback_channel()
        # One thread reads ahead, one perceives and decides: what must come in order stays in order.
        self._reading = ThreadPoolExecutor(1, "read")
        self._thinker = ThreadPoolExecutor(1, "think")
        self._stopped = asyncio.Event()
        self._stopped_s = 0.0
        self._reader = Reader(config, segmenter, self._channel, self._stopped, self._on_reader)
        self._snapshot: MapSnapshot | None = None
        self._start = Position()
        self._continued = continued
        self._place = (0, 0)
        self._is_source_over = False
        self._is_over = False
        self._camera: Camera | None = None
        self._last: FramePose | None = None
        self._mapped: Keyframe | None = None
        self._patches: NDArray[np.float32] | None = None
        self._first_ns: int | None = None
        self._num_frames = 0
        self._num_keyframes = 0
        self._total: int | None = None
        self._loop_delay = LoopDelay()
        self._source_ledger: Callable[[], Mapping[str, int]] = dict
        self.counts: Counter[str] = Counter()
        self.timings_s: defaultdict[str, float] = defaultdict(float)
        if continued is not None:
            self._continue(continued)

    def _continue(self, continued: ResumePoint) -> None:
        """Take over the state of an interrupted run."""
        step = continued.step
        self._snapshot = self._core.snapshot()
        self._start = continued.position
        self._place = (step.round_index, step.first_index)
        self._is_source_over = step.kind is StepKind.ENDED
        self._camera = step.camera
        self._last = continued.last_frame
        self._first_ns = step.first_ns
        self._num_frames, self._num_keyframes = step.num_frames, step.num_keyframes
        self.counts.update(step.counts)
        self._shapes.counts.update(step.shape_counts)
        for name in continued.mesh_names:
            self._folder.keep_shape(name)

    @property
    def num_keyframes(self) -> int:
        """How many keyframes were mapped."""
        return self._num_keyframes

    @property
    def is_complete(self) -> bool:
        """Whether the source was played to its end."""
        return not self._stopped.is_set()

    @property
    def is_reproducible(self) -> bool:
        """Whether the map depends on the log and the configuration alone: no limit was hit, no seek or correction."""
        by_hand = self._source_ledger().get("seeks", 0) + self.counts["pose_corrections"]
        return self._mode == "playback" and self._num_limits() == 0 and not by_hand

    def ledger(self, source: Source) -> dict[str, dict[str, Any]]:
        """Return what became of every message, frame and job."""
        return run_ledger(
            source,
            num_frames=self._num_frames,
            num_keyframes=self._num_keyframes,
            counts=self.counts,
            shapes=self._shape_counts(),
            num_not_shown=sum(sink.num_dropped for sink in self._sinks),
        )

    def timings(self) -> dict[str, float]:
        """Return seconds of work: by layer as in the paper's table of storage and time, and by stage."""
        times = {**self.timings_s, "decode": self._reader.decode_s}
        return run_timings(times, self._shapes.timings_s, self._loop_delay.quantile_s(0.99))

    def stop(self) -> None:
        """End the run after the frame at hand: no further frames, and no shape that takes longer than the grace."""
        if not self._stopped.is_set():
            self._stopped_s = time.monotonic()
            self._stopped.set()

    def correct_poses(self, world_from_submap: Mapping[int, NDArray[np.float64]]) -> None:
        """Have submaps placed anew before the next frame; once all frames are mapped, before the map is finished.

        Raises:
            InputError: there is no such submap, a transform is not rigid, or the map is finished; nothing is moved.
        """
        if self._is_over:
            raise InputError("the map is finished: poses can be corrected while it is being made")
        known = [submap.id for submap in self._snapshot.submaps] if self._snapshot is not None else []
        self._corrections.append(checked_places(world_from_submap, known))

    async def run(self, source: Source, *, rate: float | None, loops: int) -> None:
        """Play a source `loops` times.

        Raises:
            HickoryError: the source, the disk or the core failed; what was mapped so far was shown to the sinks.
        """
        info = source.info
        self._total = info.num_frames * loops if info.num_frames is not None else None
        self._source_ledger = source.ledger
        await self._compile()
        try:
            async with asyncio.TaskGroup() as group:
                watching = group.create_task(self._loop_delay.watch(), name="loop-delay")
                if self._continued is not None:
                    for job in self._continued.open_jobs:
                        self._shapes.adopt(job)
                if self._is_source_over:
                    await self._channel.close()
                elif self._mode == "live":
                    group.create_task(self._reader.follow(source, Pacer(rate), loops, self.counts), name="read")
                else:
                    group.create_task(self._reader.play(source, Pacer(rate), loops, self._start), name="read")
                await group.create_task(self._map(), name="map")
                watching.cancel()
        except BaseException as error:
            # The thread that reads may be waiting for a frame that never comes: a robot that is gone.
            interrupt(source)
            if isinstance(error, ExceptionGroup):
                raise error.exceptions[0] from error
            raise
        finally:
            self._reading.shutdown(wait=True)
            self._thinker.shutdown(wait=True)
            self._recorder.close()

    async def _compile(self) -> None:
        """Compile the kernels where this is the first run after an installation; a stopped run does not wait for it."""
        compiling = asyncio.create_task(compile_kernels(self._tell_compiling), name="compile")
        stopped = asyncio.create_task(self._stopped.wait(), name="stopped")
        try:
            await asyncio.wait({compiling, stopped}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in (compiling, stopped):
                task.cancel()
            results = await asyncio.gather(compiling, stopped, return_exceptions=True)
        if isinstance(results[0], Exception):
            raise results[0]

    def _num_limits(self) -> int:
        before = self._continued.step.shape_counts.get("limits", 0) if self._continued is not None else 0
        return before + self._workers.num_limits

    def _shape_counts(self) -> dict[str, int]:
        return {name: n for name, n in {**self._shapes.counts, "limits": self._num_limits()}.items() if n}

    async def _on_reader(self, function: Callable[..., T], *arguments: object) -> T:
        return await self._in(self._reading, function, *arguments)

    # ---- map ---------------------------------------------------------------------------------------------------------

    async def _map(self) -> None:
        """Map what is read, frame by frame in a playback, the newest keyframe of what has come in a live run."""
        while True:
            try:
                reads = await self._channel.receive_all() if self._mode == "live" else [await self._channel.receive()]
            except ChannelClosed:
                break
            chosen = self._choose(reads)
            try:
                for i, read in enumerate(reads):
                    await self._arrive(read)
                    if i == chosen:
                        await self._map_keyframe(read)
                    else:
                        self.counts["between_keyframes"] += 1
                        await self._show(plain_report(read.raw))
                    self._tell("mapping")
            except _OutOfPatienceError:
                await self._channel.close()
                break
        if self._last is not None:
            await self._end(self._last)

    def _choose(self, reads: Sequence[Read]) -> int | None:
        """Return which of the frames that have come is mapped: in a live run the newest that makes a keyframe.

        Those that would have been keyframes had the map not been behind are counted as dropped.
        """
        candidates = [i for i, read in enumerate(reads) if read.is_candidate]
        if self._mode == "playback":
            return candidates[0] if candidates else None
        wanted = (i for i in range(len(reads) - 1, -1, -1) if self._makes_keyframe(reads[i].raw))
        chosen = next(wanted, None)
        num_dropped = max(0, len(candidates) - (chosen is not None))
        self.counts["keyframes_dropped"] += num_dropped
        self.counts["between_keyframes"] -= num_dropped
        if chosen is not None:
            raw = reads[chosen].raw
            self._mapped = Keyframe(stamp_ns=raw.stamp_ns, world_from_camera=raw.world_from_camera)
        return chosen

    def _makes_keyframe(self, raw: RawFrame) -> bool:
        return is_keyframe(self._mapped, raw.stamp_ns, raw.world_from_camera, self._config.keyframes)

    async def _arrive(self, read: Read) -> None:
        """Note a frame, and tell the core where its stamp or the odometry has jumped."""
        raw = read.raw
        await self._correct(raw.stamp_ns)
        self.counts.update(read.counts)
        self.counts["between_keyframes"] -= read.counts.get("frames_undecodable", 0)
        jump = time_jump(
            self._last,
            read,
            round_index=self._place[0],
            first_ns=self._first_ns,
            most_s=self._config.run.time_jump_s,
        )
        if raw.goes_back and self._mode == "playback":
            await self._rewind(raw.stamp_ns)
            jump = None
        if jump is not None:
            self.counts["time_jumps"] += 1
            if self._mode == "playback":
                await self._commit_due(None)
            await self._handle(jump)
        elif raw.after_from_before is not None:
            self.counts["pose_jumps"] += 1
            await self._handle(PoseJumped(stamp_ns=raw.stamp_ns, after_from_before=raw.after_from_before))
        self._num_frames += 1
        self._place = (read.round_index, read.first_index)
        self._camera = raw.camera
        self._first_ns = raw.stamp_ns if self._first_ns is None else self._first_ns
        self._last = FramePose(index=raw.index, stamp_ns=raw.stamp_ns, world_from_camera=raw.world_from_camera)
        self._unwritten.frames.append(self._last)

    async def _rewind(self, stamp_ns: int) -> None:
        """Restore the core's state before a stamp; events after it that are not in the journal yet are discarded."""
        self.counts["rewinds"] += 1
        await self._recorder.written()
        rewound = await self._in(self._thinker, rewound_to, self._folder, self._config.mapping, stamp_ns, self._core)
        self._core = rewound.core
        done = self._unwritten
        done.events.clear()
        done.goes_back_to, done.lost_views = rewound.num_steps, rewound.lost_views
        kept = rewound.core.view_names()
        done.dropped_views = [name for name in (*done.dropped_views, *rewound.unused_views) if name not in kept]
        done.ended_jobs += self._shapes.rewind(rewound.open_jobs, rewound.answers)
        self._snapshot = await self._in(self._thinker, self._core.snapshot)
        if self._corrections:
            # Their submaps may not be there yet.
            logger.warning("%d corrections of poses were for what somebody went back from", len(self._corrections))
            self._corrections.clear()
        self._publish(self._snapshot)

    async def _correct(self, stamp_ns: int) -> None:
        """Place submaps where they were said to lie since the last frame."""
        while self._corrections:
            places = self._corrections.popleft()
            self.counts["pose_corrections"] += 1
            await self._handle(
                PosesCorrected(
                    stamp_ns=stamp_ns,
                    submap_ids=tuple(places),
                    world_from_submap=np.array(list(places.values())).reshape(-1, 4, 4),
                )
            )

    async def _map_keyframe(self, read: Read) -> None:
        """Map a keyframe; in a live run it is decoded only now, and may be torn."""
        frame, prepared = read.frame, read.prepared
        if frame is None:
            try:
                decoded = await self._in(self._thinker, read.raw.decode)
                frame = sensed(decoded, read.raw.index, self._config.sensor)
            except RecordingError as error:
                self.counts["frames_undecodable"] += 1
                logger.warning("frame %d cannot be decoded: %s", read.raw.index, error)
                await self._show(plain_report(read.raw))
                return
            prepared = await self._in(self._thinker, self._segmenter.prepare, frame)
        await self._keyframe(read, frame, prepared)

    async def _keyframe(self, read: Read, frame: Frame, prepared: object) -> None:
        self._num_keyframes += 1
        started = time.perf_counter()
        await self._commit_due(frame.stamp_ns)
        waited = time.perf_counter()
        perceived = await self._in(self._thinker, self._perceived, frame, prepared)
        if not np.isfinite(frame.depth_m).any():
            self.counts["keyframes_without_depth"] += 1
        seen = time.perf_counter()
        event = perceived.event(frame)
        self._patches = None
        published = await self._handle(event, frame, perceived.observations)
        ended = time.perf_counter()
        times = {"wait_for_shapes": waited - started, "perceive": seen - waited, "decide": ended - seen}
        for stage, seconds in times.items():
            self.timings_s[stage] += seconds
        times["latency"] = time.monotonic() - read.arrived_s
        metrics, config = self._metrics(times), self._config.journal
        await self._commit(StepKind.KEYFRAME, frame.stamp_ns, metrics, lambda: color_of(read.raw, frame, config))
        if published is not None:
            await self._show(
                keyframe_report(
                    read.raw,
                    frame,
                    perceived,
                    published,
                    keyframe_index=self._num_keyframes - 1,
                    patches=self._patches,
                    metrics=metrics,
                )
            )

    def _perceived(self, frame: Frame, prepared: object) -> Perceived:
        core, config = self._core, self._config
        return perceive(
            frame,
            core.prior(),
            prepared,
            self._segmenter,
            config.perception,
            lattice=config.mapping.lattice,
        )

    async def _commit(
        self,
        kind: StepKind,
        stamp_ns: int,
        metrics: tuple[tuple[str, float], ...] = (),
        color: Callable[[], bytes | None] = lambda: None,
    ) -> None:
        """Have everything that happened since the last step written as one."""
        assert self._camera is not None
        assert self._first_ns is not None
        done, self._unwritten = self._unwritten, Unwritten()
        step = Step(
            kind=kind,
            stamp_ns=stamp_ns,
            camera=self._camera,
            frames=tuple(done.frames),
            round_index=self._place[0],
            first_index=self._place[1],
            first_ns=self._first_ns,
            num_frames=self._num_frames,
            num_keyframes=self._num_keyframes,
            counts=dict(self.counts),
            shape_counts=self._shape_counts(),
            metrics=metrics,
            goes_back_to=done.goes_back_to,
            lost_views=done.lost_views,
            num_seeks=self._source_ledger().get("seeks", 0),
        )
        every = self._config.journal.checkpoint_keyframes
        checkpoint: Checkpoint | None = None
        if kind is StepKind.KEYFRAME and self._num_keyframes % every == 0:
            checkpoint = Checkpoint(core=self._core.state(), open_jobs=self._shapes.open_jobs)
        await self._recorder.commit(
            JournalEntry(step=step, events=tuple(done.events), told=done.told),
            color=color,
            checkpoint=checkpoint,
            dropped_views=done.dropped_views,
            # After a stop the jobs stay: a run that is continued commits them when they are due.
            ended_jobs=[] if kind is StepKind.CLOSING else done.ended_jobs,
            shapes=self._shapes,
        )

    async def _handle(
        self, event: Event, frame: Frame | None = None, observations: Sequence[Observation] = ()
    ) -> Publish | None:
        """Let the core decide, carry out what it wants until it wants nothing more; return what it published."""
        published: Publish | None = None
        self._unwritten.events.append(event)
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
            if answer is None:
                break
            self._unwritten.events.append(answer)
            effects = await self._in(self._thinker, self._core.handle, answer)
        if published is not None:
            self._snapshot = published.snapshot
            self._publish(published.snapshot)
            submap_id = published.snapshot.submaps[-1].id
            self._unwritten.told = Told(decisions=published.decisions, submap_id=submap_id)
        return published

    async def _carry_out(self, effect: Effect) -> None:
        match effect:
            case KeepView() | ComputeFeatures() | Publish():
                return
            case DropView():
                self._unwritten.dropped_views.append(effect.name)
            case RequestShape():
                await self._recorder.written()
                await self._shapes.request(effect)
            case CancelShape():
                self._shapes.cancel(effect.ticket)
                self._unwritten.ended_jobs.append(effect.ticket)
            case _:
                assert_never(effect)

    async def _features(
        self, effect: ComputeFeatures, frame: Frame | None, observations: Sequence[Observation]
    ) -> FeaturesReady:
        assert frame is not None, "features are asked for while the frame is at hand"
        features, self._patches = await self._in(
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

        await self._recorder.write_views(write)

    async def _commit_due(self, stamp_ns: int | None) -> None:
        """Tell the core of the shapes that are due at a stamp, None: of all that are open.

        Raises:
            _OutOfPatienceError: the run was stopped and one of them is not there yet: what came after this would not be
                what an uninterrupted run does.
        """
        while (event := await self._next_shape(stamp_ns)) is not None:
            await self._shape_ended(event)
        if self._mode == "playback" and self._shapes.has_due(stamp_ns):
            raise _OutOfPatienceError

    async def _commit_last(self, kind: StepKind, stamp_ns: int) -> None:
        """Tell the core of the shapes that are open, or those that come within the grace of a stop; each is a step."""
        while (event := await self._next_shape(None)) is not None:
            await self._shape_ended(event)
            await self._commit(kind, stamp_ns)
            self._tell("shapes")

    async def _shape_ended(self, event: ShapeReady | ShapeFailed) -> None:
        await self._handle(event)
        self._unwritten.ended_jobs.append(event.ticket)
        if isinstance(event, ShapeReady):
            self._folder.keep_shape(event.shape.mesh_name)

    async def _next_shape(self, stamp_ns: int | None) -> ShapeReady | ShapeFailed | None:
        """Return the next shape that is due; None where none is, or where a stop has no patience left for it."""
        if self._mode == "live" and stamp_ns is not None:
            return await self._shapes.next_arrived(stamp_ns)
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

    async def _end(self, last: FramePose) -> None:
        """Ask for and wait for the last shapes, and show the finished map as one more keyframe."""
        decisions: tuple[Decision, ...] = ()
        self.counts.update(self._reader.lost)
        kind = StepKind.ENDED if self.is_complete else StepKind.CLOSING
        await self._correct(last.stamp_ns)
        if self.is_complete and not self._is_source_over:
            published = await self._handle(SourceEnded(stamp_ns=last.stamp_ns))
            decisions = published.decisions if published is not None else ()
        await self._commit(kind, last.stamp_ns)
        await self._commit_last(kind, last.stamp_ns)
        while self._corrections:
            await self._correct(last.stamp_ns)
            await self._commit(kind, last.stamp_ns)
        self._is_over = True
        await self._recorder.written()
        self._snapshot = await self._in(self._thinker, self._core.snapshot)
        self._publish(self._snapshot)
        self._tell("saving")
        assert self._camera is not None
        await self._show(
            final_report(last, self._camera, self._snapshot, keyframe_index=self._num_keyframes, decisions=decisions)
        )

    # ---- what others are told ----------------------------------------------------------------------------------------

    async def _show(self, report: FrameReport) -> None:
        report = in_map_frame(report, self._snapshot)
        for sink in self._sinks:
            await sink.show(report, waits=self._mode == "playback")

    def _metrics(self, times: dict[str, float]) -> tuple[tuple[str, float], ...]:
        queues = {"frames": self._channel.statistics().length, "shapes": self._shapes.num_open}
        queues |= {f"sink-{i}": sink.backlog for i, sink in enumerate(self._sinks)}
        return (
            *((f"time/{name}", seconds) for name, seconds in times.items()),
            *((f"queue/{name}", float(length)) for name, length in queues.items()),
            ("engine/loop_delay_ms", 1e3 * self._loop_delay.recent_s()),
            ("engine/workers", float(self._workers.num_alive)),
            ("engine/memory_mb", _PROCESS.memory_info().rss / 1e6),
            *((f"ledger/{bucket}", float(number)) for bucket, number in self._source_ledger().items()),
            ("engine/frames_dropped", float(self.counts["frames_dropped"] + self.counts["keyframes_dropped"])),
        )

    def _tell_compiling(self, num_compiled: int, num_kernels: int) -> None:
        self._tell("compiling", num_compiled, num_kernels)

    def _tell(self, phase: str, num_compiled: int = 0, num_kernels: int = 0) -> None:
        self._progress(
            Progress(
                phase=phase,
                num_compiled=num_compiled,
                num_kernels=num_kernels,
                frames=self._num_frames,
                total=self._total,
                keyframes=self._num_keyframes,
                objects=len(self._snapshot.objects) if self._snapshot is not None else 0,
                open_shapes=self._shapes.num_open,
            )
        )

    async def _in(self, executor: ThreadPoolExecutor, function: Callable[..., T], *arguments: object) -> T:
        return await asyncio.get_running_loop().run_in_executor(executor, function, *arguments)


class _OutOfPatienceError(Exception):
    """A stopped run waits no longer."""
