"""One run: the asyncio event loop of the system, composed of parts that each do one thing.

    Reader ──frames──> Run ──reports──> ReportPublisher ──> sinks (a thread each)
                        │ events
                        v
                  EffectRunner ──jobs──> ShapeQueue ──> shape workers (child processes)
                        │ steps             │ answers, by due stamp (playback) or as they arrive (live)
                        v                   v
                   StepWriter <────── DueShapes
                        └──> Recorder (a thread) ──> journal, views

`Reader` chooses possible keyframes and, in a playback, decodes them ahead. `Run` perceives each against the current
map. Work of more than a millisecond runs on a thread or in a child. A playback waits for everything; a live run maps
the newest keyframe and counts skipped frames.
"""

import asyncio
import logging
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.caches import cache_folder
from hickory_stream.config import MapperConfig
from hickory_stream.engine.accounting import engine_metrics, run_ledger, run_timings
from hickory_stream.engine.async_tools import LoopDelay, StopRequest, on_thread, without_pauses
from hickory_stream.engine.corrections import Corrections, KeyframeRegistrar
from hickory_stream.engine.effects import (
    CurrentKeyframe,
    DueShapes,
    EffectRunner,
    EffectTargets,
    GraceExpired,
    color_of,
)
from hickory_stream.engine.first_run import compile_kernels
from hickory_stream.engine.frame_accounting import FrameOutcome, KeyframeChoice, RunClock
from hickory_stream.engine.loop_closing import LoopCloser
from hickory_stream.engine.modes import Mode, Progress
from hickory_stream.engine.publisher import ReportPublisher, SinkThread
from hickory_stream.engine.reading import Prefetched, QueuedFrame, Reader, sensed
from hickory_stream.engine.shape_jobs.cache import ShapeCache
from hickory_stream.engine.shape_jobs.generators.choose import generator_key
from hickory_stream.engine.shape_jobs.local_workers import ShapeWorkers
from hickory_stream.engine.shape_jobs.queue import ShapeQueue
from hickory_stream.engine.step_writer import Recorder, StepWriter
from hickory_stream.errors import RecordingError
from hickory_stream.events import PoseJumped, SourceEnded, WayEnded
from hickory_stream.journal.step import FramePose, StepKind
from hickory_stream.journal.writer import JournalWriter
from hickory_stream.map_folder.array_spill import FarArrays
from hickory_stream.map_folder.history.frame_reports import final_report, keyframe_report, plain_report
from hickory_stream.map_folder.history.resume import Position, ResumePoint
from hickory_stream.map_folder.history.rewind import rewound_to
from hickory_stream.map_folder.writer import MapFolder
from hickory_stream.mapping.core import MapperCore
from hickory_stream.perception.perceive import Perceived, perceive
from hickory_stream.ports import FeatureExtractor, Segmenter, Source, interrupt, num_seeks, prepared_at
from hickory_stream.records import Decision, Frame, MapSnapshot

logger = logging.getLogger(__name__)


class Run:
    """Maps one source by `run()`, once; `stop()` from any task ends it early, in order."""

    def __init__(self, parts: "RunParts") -> None:
        config, folder = parts.config, parts.folder
        self._parts = parts
        self._stop = StopRequest()
        self._clock = RunClock(config.run.time_jump_s)
        self._reader = Reader(config, parts.segmenter, parts.extractor, self._stop, mode=parts.mode)
        self._choice = KeyframeChoice(parts.mode, config.keyframes)
        cache = ShapeCache(cache_folder("shapes"), generator_key(config)) if config.run.shape_cache else None
        self._shapes = ShapeQueue(folder, parts.workers, config.shapes, cache)
        self._recorder = Recorder(folder, parts.journal)
        checkpoint_keyframes = config.journal.checkpoint_keyframes
        self._steps = StepWriter(self._recorder, self._shapes, parts.source, checkpoint_keyframes=checkpoint_keyframes)
        self._publisher = ReportPublisher(parts.sinks, parts.publish, parts.progress, waits=parts.mode == "playback")
        self._loops = LoopCloser(config.loops, config.graph, extractor=parts.extractor.name, mode=parts.mode)
        # One thread reads ahead, one perceives and decides, so that both keep their order.
        self._mapping_thread = ThreadPoolExecutor(1, "think")
        self._compiling: asyncio.Task[None] | None = None
        self._kernels = (0, 0)
        targets = EffectTargets(
            folder=folder,
            recorder=self._recorder,
            steps=self._steps,
            shapes=self._shapes,
            loops=self._loops,
            patch_px=parts.extractor.patch_px,
            publish=self._publisher.publish,
        )
        self._far = FarArrays(folder.path)
        parts.core.keep_far_arrays(self._far.keep)
        self._effects = EffectRunner(parts.core, targets, self._mapping_thread, config.run)
        self._due = DueShapes(self._effects, targets, self._stop, mode=parts.mode, grace_s=config.run.grace_s)
        self._corrections = Corrections(self._effects, self._loops, self._mapping_thread)
        self._loop_delay = LoopDelay()
        self._seconds: defaultdict[str, float] = defaultdict(float)
        self._registrar = KeyframeRegistrar(config.registration, self._effects, self._mapping_thread)
        if parts.resumes is not None:
            self._clock.resume(parts.resumes)
            self._registrar.places.restore(parts.resumes.registration)
            self._publisher.snapshot = parts.core.snapshot()
            for name in parts.resumes.mesh_names:
                folder.keep_shape(name)

    @property
    def num_keyframes(self) -> int:
        """Number of mapped keyframes."""
        return self._clock.num_keyframes

    @property
    def counts(self) -> Counter[str]:
        """Number of frames by outcome, and of corrections, as each part counts its own."""
        counts = Counter(self._clock.counts)
        for part in (self._reader, self._corrections, self._registrar):
            counts.update(part.counts)
        return counts

    @property
    def is_complete(self) -> bool:
        """Whether the source was played to its end."""
        return not self._stop.is_requested

    @property
    def is_reproducible(self) -> bool:
        """Whether the map depends on log and configuration alone: no limit, seek or correction."""
        by_hand = num_seeks(self._parts.source) + self.counts.get("pose_corrections", 0)
        return self._parts.mode == "playback" and self._shapes.num_limits == 0 and not by_hand

    def ledger(self) -> dict[str, dict[str, Any]]:
        """Return the use of every message, frame and job."""
        return run_ledger(
            self._parts.source,
            num_frames=self._clock.num_frames,
            num_keyframes=self._clock.num_keyframes,
            counts=self.counts,
            shapes=self._shapes.total_counts(),
            num_not_shown=self._publisher.num_not_shown,
        )

    def timings(self) -> dict[str, float]:
        """Return seconds of work: by layer as in the paper's table of storage and time, and by stage."""
        times = {**self._seconds, "decode": self._reader.decode_s}
        if self._registrar.seconds:
            times["register"] = self._registrar.seconds
        return run_timings(times, self._shapes.timings_s, self._loop_delay.quantile_s(0.99))

    def stop(self) -> None:
        """End the run after the current frame; shapes may take the grace period."""
        self._stop.request()

    def correct_poses(self, world_from_submap: Mapping[int, NDArray[np.float64]]) -> None:
        """Place submaps at new poses before the next frame, or before the map is finished.

        Raises `InputError`: there is no such submap, a transform is not rigid, or the map is finished; nothing is
        moved.
        """
        snapshot = self._publisher.snapshot
        self._corrections.give(world_from_submap, [submap.id for submap in snapshot.submaps] if snapshot else [])

    async def run(self, *, rate: float | None, loops: int) -> None:
        """Play the source `loops` times.

        Raises `HickoryError`: the source, the disk or the core failed; sinks have the map so far.
        """
        source, resumes = self._parts.source, self._parts.resumes
        total = source.info.num_frames
        self._publisher.total = total * loops if total is not None else None
        # A log can wait for its shapes; a robot does not wait, and compiling takes the processors that it needs.
        in_background = ("shapes",) if self._parts.mode == "playback" else ()
        report = partial(self._report, "compiling")
        self._compiling = await self._stop.within_grace(compile_kernels(report, in_background=in_background), "compile")
        if self._parts.rehearse is not None and not self._stop.is_requested:
            await on_thread(self._mapping_thread, self._parts.rehearse)
        try:
            with without_pauses():
                async with asyncio.TaskGroup() as group:
                    watching = group.create_task(self._loop_delay.watch(), name="loop-delay")
                    if resumes is not None:
                        self._shapes.resume(resumes.open_jobs, resumes.step.shape_counts)
                        self._loops.restart(resumes.core.searches)
                    if self._is_source_over:
                        await self._reader.end()
                    else:
                        start = resumes.position if resumes is not None else Position()
                        reading = self._reader.read(source, rate=rate, loops=loops, start=start)
                        group.create_task(reading, name="read")
                    await group.create_task(self._map(), name="map")
                    watching.cancel()
        except BaseException as error:
            # The reading thread may wait for a frame that never comes: a robot that is gone.
            interrupt(source)
            if isinstance(error, ExceptionGroup):
                raise error.exceptions[0] from error
            raise
        finally:
            if self._compiling is not None:
                self._compiling.cancel()
                await asyncio.gather(self._compiling, return_exceptions=True)
            self._reader.close()
            self._loops.close()
            self._mapping_thread.shutdown(wait=True)
            self._recorder.close()

    @property
    def _is_source_over(self) -> bool:
        return self._parts.resumes is not None and self._parts.resumes.step.kind is StepKind.ENDED

    async def _map(self) -> None:
        while (reads := await self._reader.take()) is not None:
            try:
                for read, outcome in zip(reads, self._choice.outcomes(reads), strict=True):
                    await self._arrive(read)
                    became = await self._map_keyframe(read) if outcome is FrameOutcome.MAPPED else outcome
                    if became is not FrameOutcome.MAPPED:
                        self._clock.counts[became.value] += 1
                        pose = self._registrar.places.where(read.raw.world_from_camera)
                        await self._publisher.show(plain_report(read.raw, pose))
                    self._report("mapping")
            except GraceExpired:
                await self._reader.end()
                break
        if self._clock.last is not None:
            await self._end(self._clock.last)

    async def _arrive(self, read: QueuedFrame) -> None:
        raw, counts = read.raw, self._clock.counts
        await self._corrections.apply(raw.stamp_ns)
        counts.update(read.counts)
        jump = self._clock.jump_before(read)
        if raw.goes_back and self._parts.mode == "playback":
            await self._rewind(raw.stamp_ns)
            jump = None
        if jump is not None:
            counts["time_jumps"] += 1
            if self._parts.mode == "playback":
                await self._due.commit(None)
            self._registrar.places.jumped(is_loop=jump.kind == "loop")
            await self._effects.handle(jump)
        elif raw.after_from_before is not None:
            counts["pose_jumps"] += 1
            self._registrar.places.jumped()
            await self._effects.handle(PoseJumped(stamp_ns=raw.stamp_ns, after_from_before=raw.after_from_before))
        self._steps.add_frame(self._clock.advance(read))

    async def _rewind(self, stamp_ns: int) -> None:
        self._clock.counts["rewinds"] += 1
        await self._recorder.written()
        folder, config, now = self._parts.folder, self._parts.config, self._effects.core
        rewound = await on_thread(self._mapping_thread, rewound_to, folder, config, stamp_ns, now)
        self._effects.core = rewound.core
        rewound.core.keep_far_arrays(self._far.keep)
        self._registrar.places.restore(rewound.registration)
        self._steps.rewind(rewound, self._shapes.rewind(rewound.open_jobs, rewound.answers))
        self._loops.restart(rewound.core.searches)
        self._corrections.forget()
        self._publisher.publish(await on_thread(self._mapping_thread, rewound.core.snapshot))

    async def _map_keyframe(self, read: QueuedFrame) -> FrameOutcome:
        # A live run decodes the keyframe only now: its images may be torn.
        frame, ahead = read.frame, read.ahead
        if frame is None:
            try:
                decoded = await on_thread(self._mapping_thread, read.raw.decode)
            except RecordingError as error:
                logger.warning("frame %d cannot be decoded: %s", read.raw.index, error)
                return FrameOutcome.UNDECODABLE
            frame = sensed(decoded, read.raw.index, self._parts.config.sensor)
            found = self._reader.accepted(await self._reader.ahead(frame), read.raw.index)
            if found is None:
                return FrameOutcome.FAILED
            ahead = found
        placed = await self._registrar.place(frame, ahead.surface)
        if placed is None:
            return FrameOutcome.KEPT_OUT
        if placed is not frame:
            pose, points = placed.world_from_camera, ahead.keypoints
            prepared = prepared_at(self._parts.segmenter, ahead.prepared, pose)
            points = None if points is None else replace(points, world_from_camera=pose)
            ahead = replace(ahead, prepared=prepared, keypoints=points, free_keys=None)
        await self._keyframe(read, placed, ahead)
        return FrameOutcome.MAPPED

    async def _keyframe(self, read: QueuedFrame, frame: Frame, ahead: Prefetched) -> None:
        self._clock.map_keyframe(read, self._parts.config.keyframes)
        started = time.perf_counter()
        await self._due.commit(frame.stamp_ns)
        await self._corrections.close_loops(frame.stamp_ns)
        waited = time.perf_counter()
        perceived = await on_thread(self._mapping_thread, self._perceived, frame, ahead)
        if not np.isfinite(frame.depth_m).any():
            self._clock.counts["keyframes_without_depth"] += 1
        seen = time.perf_counter()
        current = CurrentKeyframe(frame=frame, observations=perceived.observations, patches=ahead.patches)
        event = replace(perceived.event(frame), keypoints=ahead.keypoints)
        decided = await self._effects.decide(event, current)
        ended = time.perf_counter()
        times = {"wait_for_shapes": waited - started, "perceive": seen - waited, "decide": ended - seen}
        for stage, seconds in times.items():
            self._seconds[stage] += seconds
        metrics = self._metrics({**times, "latency": time.monotonic() - read.arrived_s})
        if decided.published is not None:
            # A sink may save a map that names views.
            await self._recorder.written()
            await self._publisher.show(
                keyframe_report(
                    read.raw,
                    frame,
                    perceived,
                    decided.published,
                    keyframe_index=self._clock.num_keyframes - 1,
                    patches=ahead.patches,
                    metrics=metrics,
                )
            )
        # A robot waits for the map, not for shape jobs and the journal.
        await self._effects.carry_out(decided.effects)
        color = partial(color_of, read.raw, frame, self._parts.config.journal)
        await self._commit(StepKind.KEYFRAME, frame.stamp_ns, metrics=metrics, color=color)

    async def _commit(self, kind: StepKind, stamp_ns: int, **parts: Any) -> None:
        await self._steps.commit(kind, stamp_ns, self._clock, self._effects.core, counts=self.counts, **parts)

    def _perceived(self, frame: Frame, ahead: Prefetched) -> Perceived:
        config, prior = self._parts.config, self._effects.core.prior()
        return perceive(
            frame,
            prior,
            ahead.prepared,
            self._parts.segmenter,
            config.perception,
            lattice=config.mapping.voxels,
            free_keys=ahead.free_keys,
        )

    async def _end(self, last: FramePose) -> None:
        decisions: tuple[Decision, ...] = ()
        self._clock.counts.update(self._reader.lost)
        kind = StepKind.ENDED if self.is_complete else StepKind.CLOSING
        await self._corrections.apply(last.stamp_ns)
        if self.is_complete and not self._is_source_over:
            await self._effects.handle(WayEnded(stamp_ns=last.stamp_ns))
            await self._corrections.close_loops(last.stamp_ns, all_of_them=True)
            published = (await self._effects.handle(SourceEnded(stamp_ns=last.stamp_ns))).published
            decisions = published.decisions if published is not None else ()
        await self._commit(kind, last.stamp_ns)

        async def commit_shape() -> None:
            await self._commit(kind, last.stamp_ns)
            self._report("shapes")

        await self._due.commit_last(commit_shape)
        while len(self._corrections):
            await self._corrections.apply(last.stamp_ns)
            await self._commit(kind, last.stamp_ns)
        self._corrections.close()
        await self._recorder.written()
        snapshot = await on_thread(self._mapping_thread, self._effects.core.snapshot)
        self._publisher.publish(snapshot)
        self._report("saving")
        assert self._clock.camera is not None
        pose, index = self._registrar.places.where(last.world_from_camera), self._clock.num_keyframes
        await self._publisher.show(
            final_report(last, pose, self._clock.camera, snapshot, keyframe_index=index, decisions=decisions),
            is_last=True,
        )

    def _metrics(self, times_s: Mapping[str, float]) -> tuple[tuple[str, float], ...]:
        counts = self.counts
        backlogs = {f"sink-{i}": length for i, length in enumerate(self._publisher.backlogs)}
        return engine_metrics(
            times_s,
            queues={"frames": self._reader.num_waiting, "shapes": self._shapes.num_open, **backlogs},
            loop_delay_s=self._loop_delay.recent_s(),
            num_workers=self._parts.workers.num_alive,
            source_ledger=self._parts.source.ledger(),
            num_dropped=counts["frames_dropped"] + counts["keyframes_dropped"],
        )

    def _report(self, phase: str, num_compiled: int = 0, num_kernels: int = 0) -> None:
        if phase == "compiling":
            self._kernels = (num_compiled, num_kernels)
        elif self._compiling is None or self._compiling.done():
            self._kernels = (0, 0)
        self._publisher.progress(phase, self._clock, self._shapes, kernels=self._kernels)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RunParts:
    """The components of a run: source, perception, core, destination, and receivers."""

    config: MapperConfig
    mode: Mode
    source: Source
    core: MapperCore
    segmenter: Segmenter
    extractor: FeatureExtractor
    workers: ShapeWorkers
    folder: MapFolder
    journal: JournalWriter
    sinks: Sequence[SinkThread]
    publish: Callable[[MapSnapshot], None]
    progress: Callable[[Progress], None]
    #: An interrupted run to continue, with its core.
    resumes: ResumePoint | None = None
    #: Processes a made-up scene before the first frame, which then takes no longer than others.
    rehearse: Callable[[], None] | None = None
