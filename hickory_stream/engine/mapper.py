"""The mapper as a Python object, and the end of its run.

`async with Mapper(config) as mapper: async for snapshot in mapper.run(source): ...`
"""

import asyncio
import dataclasses
import shutil
import tempfile
import threading
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from hickory_stream.base import caches
from hickory_stream.config import MapperConfig, RunConfig
from hickory_stream.engine.first_run import are_compiled
from hickory_stream.engine.modes import Mode, Progress
from hickory_stream.engine.publisher import SinkThread
from hickory_stream.engine.run import Run, RunParts
from hickory_stream.engine.shape_jobs.choose import make_workers
from hickory_stream.engine.shape_jobs.local_workers import LocalWorkers, ShapeWorkers
from hickory_stream.engine.shape_jobs.processor import processor_kind, processor_of_run
from hickory_stream.engine.warm_up import rehearse
from hickory_stream.errors import EmptyMapError, InputError, MapFolderError
from hickory_stream.journal.writer import JournalWriter
from hickory_stream.map_folder.history.recorded_config import resumed_config
from hickory_stream.map_folder.history.resume import ResumePoint, reopen
from hickory_stream.map_folder.writer import MapFolder, create_map_folder
from hickory_stream.mapping.core import MapperCore
from hickory_stream.perception.choose import make_extractor, make_segmenter
from hickory_stream.perception.surface import lab_of
from hickory_stream.ports import FeatureExtractor, Segmenter, Sink, Source, continue_from, poses_by
from hickory_stream.records import MapSnapshot


class MapSaver:
    """Saves the newest snapshot at the end: the sink of a mapper without sinks."""

    def __init__(self, folder: MapFolder) -> None:
        self._folder = folder
        self._newest: MapSnapshot | None = None

    def show(self, report: Any) -> None:
        """Keep the snapshot of a report."""
        self._newest = report.snapshot or self._newest

    def close(self) -> None:
        """Save the newest snapshot."""
        if self._newest is not None:
            self._folder.save(self._newest)


async def close_run(
    run: Run, folder: MapFolder, journal: JournalWriter, threads: Sequence[SinkThread], *, is_clean: bool
) -> None:
    """Close sinks and journal, and finish the map folder.

    Essential sinks come first: a viewer that hangs cannot keep the map unfinished. The first error of an essential sink
    or of the journal is raised after everything is closed.
    """
    failed: BaseException | None = None
    for thread in threads:
        if thread.is_essential:
            try:
                await thread.close()
            except Exception as error:  # noqa: BLE001 -- kept, and raised once every sink is closed
                failed = error
    try:
        await asyncio.to_thread(journal.close)
    except MapFolderError as error:
        failed = failed or error
    if failed is None or not is_clean:
        # The run's counters belong to the event loop.
        ledger, timings, is_reproducible = run.ledger(), run.timings(), run.is_reproducible
        is_finished = is_clean and failed is None
        await asyncio.to_thread(_finish, folder, ledger, timings, is_clean=is_finished, is_reproducible=is_reproducible)
    await asyncio.gather(*(thread.close() for thread in threads if not thread.is_essential))
    if failed is not None:
        raise failed


def why_empty(source: Source, run: Run) -> str | None:
    """Return why a completely played source gave no map, else None."""
    uri, counts = source.info.uri, run.counts
    if not run.is_complete:
        return None
    if run.num_keyframes == 0:
        found = ", ".join(f"{name} {count}" for name, count in sorted({**source.ledger(), **counts}.items()))
        needed = "it must hold colour, depth and poses that overlap in time"
        return f"{uri} gave no usable frame ({found or 'nothing'}); {needed}"
    if counts.get("keyframes_without_depth", 0) == run.num_keyframes:
        return f"{uri} has no depth in any of {run.num_keyframes} keyframes; mapping needs depth in metres above 0"
    return None


def _finish(
    folder: MapFolder, ledger: Mapping[str, Any], timings: Mapping[str, float], *, is_clean: bool, is_reproducible: bool
) -> None:
    folder.write_json("ledger.json", ledger)
    folder.write_json("timings.json", timings)
    if is_clean:
        shutil.rmtree(folder.jobs, ignore_errors=True)
    folder.finish(finished_cleanly=is_clean, is_reproducible=is_reproducible)
    if is_clean:
        caches.prune()


_LIVE_NICENESS = 10


class Mapper:
    """Maps one source into one map folder.

    Args:
        config: the whole configuration.
        out: the map folder to make; None makes a temporary one.
        overwrite: replace a map in `out`.
        segmenter, extractor: perception in place of the configured one.
        core: a new core in place of the configured one.
        workers: shape workers in place of child processes.

    Entering starts the shape workers. Leaving ends them, and an unfinished run: like `stop`, with the map saved, unless
    an error or a temporary folder makes that useless. Meanwhile BLAS has one thread in this process: other splits of a
    sum differ in the last bits.

    Raises `ConfigError`: the configuration asks for something that is missing; `ModelError`: a network is missing,
    damaged, or cannot run here.
    """

    def __init__(
        self,
        config: MapperConfig | None = None,
        *,
        out: Path | str | None = None,
        overwrite: bool = False,
        segmenter: Segmenter | None = None,
        extractor: FeatureExtractor | None = None,
        core: MapperCore | None = None,
        workers: ShapeWorkers | None = None,
    ) -> None:
        self.config = config or MapperConfig()
        self._out = Path(out) if out is not None else None
        self._overwrite = overwrite
        # OpenCV makes its tables for Lab at the first use, in a tenth of a second, for which no keyframe shall wait.
        lab_of(np.zeros((1, 1, 3), np.uint8))
        self._segmenter = segmenter or make_segmenter(self.config.perception)
        self._extractor = extractor or make_extractor(self.config.perception)
        self._is_own = segmenter is None and extractor is None
        # What a generator computes depends on the machine as perception of a caller's own does.
        is_shown = self._is_own and self.config.shapes.reconstructor != "external"
        is_lossy = self.config.run.view_colors != "png"
        self._processor = processor_of_run(self.config.perception, is_own=is_shown, has_lossy_views=is_lossy)
        self._core = core or MapperCore(self.config.mapping)
        self._workers = workers or make_workers(self.config)
        self._rehearsing = threading.Lock()
        self._is_rehearsed = self._resumes = False
        self._temporary: Path | None = None
        self._threads: threadpool_limits | None = None
        self._run: Run | None = None
        self._task: asyncio.Task[None] | None = None
        self.folder: MapFolder | None = None
        #: Why requested files beside the map are incomplete, at the end of the run.
        self.lost_outputs: tuple[str, ...] = ()

    @classmethod
    def resuming(
        cls,
        out: Path | str,
        *,
        machine: RunConfig | None = None,
        ignores_recorded_workers: bool = False,
        segmenter: Segmenter | None = None,
        extractor: FeatureExtractor | None = None,
        workers: ShapeWorkers | None = None,
    ) -> "Mapper":
        """Return a mapper that continues the interrupted playback of a map folder; `run` it with the same source.

        The configuration is the folder's; interpreter and cluster of the workers are `machine`'s. If the folder names
        others, that is refused unless `ignores_recorded_workers`.

        Raises `MapFolderError`: there is no map, or nothing to continue; `ConfigError`: other workers were recorded.
        """
        config = resumed_config(Path(out), machine or RunConfig(), ignores_recorded=ignores_recorded_workers)
        mapper = cls(config, out=out, segmenter=segmenter, extractor=extractor, workers=workers)
        mapper._resumes = True
        return mapper

    @property
    def extractor_name(self) -> str:
        """The name of the feature extractor."""
        return self._extractor.name

    async def __aenter__(self) -> "Mapper":
        await self._workers.__aenter__()
        self._threads = threadpool_limits(limits=1, user_api="blas")
        return self

    async def __aexit__(self, kind: type[BaseException] | None, *error: object) -> None:
        try:
            await self._end_run(is_in_order=kind is None and self._temporary is None)
        finally:
            await self._workers.__aexit__(kind, *error)
            if self._threads is not None:
                self._threads.restore_original_limits()
            if self._temporary is not None:
                shutil.rmtree(self._temporary, ignore_errors=True)

    async def _end_run(self, *, is_in_order: bool) -> None:
        if self._task is None or self._task.done():
            return
        if is_in_order:
            self.stop()
            await self._task
        else:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    def rehearse(self) -> None:
        """Run perception and core on a small scene, so that the first frame takes no longer than others.

        A live run does it once, or its caller while waiting for a robot, on another thread. Perception of the caller
        and kernels that are not compiled yet are left out.
        """
        with self._rehearsing:
            if self._is_own and not self._is_rehearsed and are_compiled():
                rehearse(self._segmenter, self._extractor, self.config)
                self._is_rehearsed = True

    @property
    def was_stopped(self) -> bool:
        """Whether `stop` ended the run."""
        return self._run is not None and not self._run.is_complete

    def stop(self) -> None:
        """End the run after the current frame, and save, like the first Ctrl-C."""
        if self._run is not None:
            self._run.stop()

    def correct_poses(self, world_from_submap: Mapping[int, NDArray[np.float64]]) -> None:
        """Place submaps at new poses, e.g. of a pose graph: rigid (4, 4) transforms by id (of `snapshot.submaps`).

        It takes effect before the next frame or before the map is finished, and is recorded in the journal. All content
        of a submap moves with it; identities undo it to the last byte. The map is then not reproducible from the log
        alone.

        Raises `InputError`: there is no such submap, a transform is not rigid, or nothing is being mapped; nothing is
        moved.
        """
        if self._run is None:
            raise InputError("there are no poses to correct: `run` has not begun")
        self._run.correct_poses(world_from_submap)

    async def run(
        self,
        source: Source,
        *,
        sinks: Callable[[MapFolder], list[tuple[Sink, bool]]] | None = None,
        rate: float | None = None,
        mode: Mode = "playback",
        loops: int = 1,
        progress: Callable[[Progress], None] = lambda _: None,
        source_note: Mapping[str, Any] | None = None,
    ) -> AsyncIterator[MapSnapshot]:
        """Yield the map after every keyframe, and last the finished one; a slow consumer sees only the newest.

        `sinks` makes the sinks for the map folder, each with whether it is essential; by default the map is saved.
        `rate` 1.0 is real time, None as fast as possible. `mode` "playback" waits for everything: one log, one map.
        "live" never waits: it maps the newest keyframe, takes shapes on arrival, and counts skipped frames in the
        ledger. `source_note` goes into the manifest, to open the source again. A resuming mapper takes `mode` and
        `loops` from the folder.

        Raises `HickoryError`: the source, the disk or the core failed; the folder holds the map so far.
        """
        asked = {"mode": mode, "loops": loops, "source": dict(source_note or {})}
        folder, journal, continued = await asyncio.to_thread(self._open, source, asked)
        mode, loops = folder.manifest.run["mode"], folder.manifest.run["loops"]
        if mode == "live" and isinstance(self._workers, LocalWorkers):
            # A robot waits for keyframes, not for shapes.
            self._workers.niceness = _LIVE_NICENESS
        if continued is not None:
            continue_from(source, continued.last_frame.stamp_ns, continued.last_frame.world_from_camera)
        newest: asyncio.Queue[MapSnapshot | None] = asyncio.Queue(maxsize=1)

        def publish(snapshot: MapSnapshot) -> None:
            if newest.full():
                newest.get_nowait()
            newest.put_nowait(snapshot)

        async def play() -> None:
            try:
                parts = RunParts(
                    config=self.config,
                    mode=mode,
                    source=source,
                    core=continued.core if continued is not None else self._core,
                    segmenter=self._segmenter,
                    extractor=self._extractor,
                    workers=self._workers,
                    folder=folder,
                    journal=journal,
                    sinks=self._make_sinks(folder, sinks),
                    publish=publish,
                    progress=progress,
                    resumes=continued,
                    rehearse=self.rehearse if mode == "live" else None,
                )
                run = self._run = Run(parts)
                await self._play(run, parts, rate, loops)
            finally:
                journal.abandon()
                folder.close()

        task = self._task = asyncio.create_task(play(), name="run")
        task.add_done_callback(lambda _: None if newest.full() else newest.put_nowait(None))
        try:
            while not (task.done() and newest.empty()):
                snapshot = await newest.get()
                if snapshot is not None:
                    yield snapshot
            await task
        except GeneratorExit:
            # The loop was left: the run ends in order, and `__aexit__` waits for it.
            self.stop()
            raise
        except BaseException:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
            raise

    async def _play(self, run: Run, parts: RunParts, rate: float | None, loops: int) -> None:
        is_clean = False
        try:
            await run.run(rate=rate, loops=loops)
            is_clean = run.is_complete
        finally:
            try:
                await close_run(run, parts.folder, parts.journal, parts.sinks, is_clean=is_clean)
            finally:
                lost = (thread.lost_output for thread in parts.sinks)
                self.lost_outputs = tuple(reason for reason in lost if reason is not None)
        reason = why_empty(parts.source, run)
        if reason is not None:
            await asyncio.to_thread(shutil.rmtree, parts.folder.path, ignore_errors=True)
            raise EmptyMapError(reason)

    def _make_sinks(
        self, folder: MapFolder, sinks: Callable[[MapFolder], list[tuple[Sink, bool]]] | None
    ) -> list[SinkThread]:
        try:
            made = sinks(folder) if sinks is not None else [(MapSaver(folder), True)]
        except Exception:
            if not self._resumes:
                shutil.rmtree(folder.path, ignore_errors=True)
            raise
        return [SinkThread(sink, is_essential=essential) for sink, essential in made]

    def _open(self, source: Source, asked: Mapping[str, Any]) -> tuple[MapFolder, JournalWriter, ResumePoint | None]:
        caches.cap_mb()  # an invalid value is refused before anything is played
        if self._resumes:
            assert self._out is not None
            self.folder, journal, continued = reopen(self._out, source.info, self.config, self.extractor_name)
            return self.folder, journal, continued
        place = self._out
        if place is None:
            place = self._temporary = Path(tempfile.mkdtemp(prefix="hickory-"))
        self.folder = create_map_folder(
            place,
            config=dataclasses.asdict(self.config),
            source=dataclasses.asdict(source.info),
            run=asked,
            extractor=self.extractor_name,
            # Odometry's sums are compiled for the processor's vector units.
            processor=self._processor or (processor_kind() if poses_by(source) else ""),
            overwrite=self._overwrite,
        )
        try:
            return self.folder, JournalWriter(place, flush_s=self.config.journal.flush_s), None
        except MapFolderError:
            shutil.rmtree(place, ignore_errors=True)
            self.folder.close()
            raise
