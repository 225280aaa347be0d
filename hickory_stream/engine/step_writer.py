"""Collects the events between two keyframes, and writes them as one step of the journal, on a thread.

Writes keep their order: a step in the journal has its views, and dropped files are removed after it.
"""

import asyncio
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

from hickory_stream.engine.frame_accounting import RunClock
from hickory_stream.engine.shape_jobs.queue import ShapeQueue
from hickory_stream.events import Event, Publish
from hickory_stream.journal.step import Checkpoint, FramePose, JournalEntry, Step, StepKind, Told
from hickory_stream.journal.writer import JournalWriter
from hickory_stream.map_folder.history.rewind import Rewound
from hickory_stream.map_folder.writer import MapFolder
from hickory_stream.mapping.core import MapperCore
from hickory_stream.ports import Source, num_seeks
from hickory_stream.records import MapSnapshot

_LONGEST_WAIT = 2


class CheckpointTimes:
    """Counts keyframes since the last checkpoint, due after `keyframes`.

    An open search for loops refers to the whole map: in a building thirty times the changes. So a checkpoint waits for
    its answer, at most twice as long.
    """

    def __init__(self, keyframes: int) -> None:
        self._keyframes = keyframes
        self._since = 0

    def is_due(self, *, searches: bool) -> bool:
        """Return whether a checkpoint is due after one more keyframe; `searches`: a search is open."""
        self._since += 1
        is_due = self._since >= self._keyframes * (_LONGEST_WAIT if searches else 1)
        if is_due:
            self._since = 0
        return is_due


@dataclass(slots=True)
class Unwritten:
    """Events, frames and decisions since the last step, and files to remove after it.

    `goes_back_to` and `lost_views` as of `Step`.
    """

    events: list[Event] = field(default_factory=list)
    frames: list[FramePose] = field(default_factory=list)
    dropped_views: list[str] = field(default_factory=list)
    ended_jobs: list[int] = field(default_factory=list)
    goes_back_to: int | None = None
    lost_views: tuple[str, ...] = ()
    told: Told | None = None


class Recorder:
    """Writes on a thread; each method waits for the writes before, and raises their errors."""

    def __init__(self, folder: MapFolder, journal: JournalWriter) -> None:
        self._folder = folder
        self._journal = journal
        self._thread = ThreadPoolExecutor(1, "write")
        self._writing: asyncio.Future[None] | None = None

    async def write_views(self, write: Callable[[], None]) -> None:
        """Write the pixels of views."""
        await self._begin(write)

    async def commit(
        self,
        entry: JournalEntry,
        *,
        color: Callable[[], bytes | None],
        known: MapSnapshot,
        checkpoint: Checkpoint | None,
        dropped_views: list[str],
        ended_jobs: list[int],
        shapes: ShapeQueue,
    ) -> None:
        """Write a step with the image of `color`, then remove dropped views and ended jobs; `known` is the map."""

        def write() -> None:
            self._journal.append(entry, color(), known)
            if checkpoint is not None:
                self._journal.checkpoint(checkpoint, entry.step.stamp_ns)
            for name in dropped_views:
                self._folder.drop_view(name)
            shapes.forget(ended_jobs)

        await self._begin(write)

    async def written(self) -> None:
        """Return when everything is written."""
        if self._writing is not None:
            writing, self._writing = self._writing, None
            await writing

    def close(self) -> None:
        """Wait for the thread to end."""
        self._thread.shutdown(wait=True)

    async def _begin(self, write: Callable[[], None]) -> None:
        await self.written()
        self._writing = asyncio.get_running_loop().run_in_executor(self._thread, write)
        # A run that ends for another reason ignores its failure.
        self._writing.add_done_callback(lambda writing: writing.cancelled() or writing.exception())


Metrics = tuple[tuple[str, float], ...]


class StepWriter:
    """Collects frames, events and files to remove; `commit` writes a step."""

    def __init__(self, recorder: Recorder, shapes: ShapeQueue, source: Source, *, checkpoint_keyframes: int) -> None:
        self._recorder = recorder
        self._shapes = shapes
        self._source = source
        self._checkpoints = CheckpointTimes(checkpoint_keyframes)
        self._unwritten = Unwritten()

    def add_frame(self, frame: FramePose) -> None:
        """Add a frame."""
        self._unwritten.frames.append(frame)

    def add_event(self, event: Event) -> None:
        """Add an event."""
        self._unwritten.events.append(event)

    def add_published(self, published: Publish) -> None:
        """Add the core's decisions."""
        submap_id = published.snapshot.submaps[-1].id
        self._unwritten.told = Told(decisions=published.decisions, submap_id=submap_id)

    def drop_view(self, name: str) -> None:
        """Remove the pixels of a view after the step."""
        self._unwritten.dropped_views.append(name)

    def end_job(self, ticket: int) -> None:
        """Remove the folder of a finished job after the step."""
        self._unwritten.ended_jobs.append(ticket)

    def rewind(self, rewound: Rewound, given_up: list[int]) -> None:
        """Discard unwritten events; the next step records from which step the core continues."""
        done = self._unwritten
        done.events.clear()
        done.goes_back_to, done.lost_views = rewound.num_steps, rewound.lost_views
        kept = rewound.core.view_names()
        done.dropped_views = [name for name in (*done.dropped_views, *rewound.unused_views) if name not in kept]
        done.ended_jobs += given_up

    async def commit(
        self,
        kind: StepKind,
        stamp_ns: int,
        clock: RunClock,
        core: MapperCore,
        *,
        counts: Mapping[str, int],
        metrics: Metrics = (),
        color: Callable[[], bytes | None] = lambda: None,
    ) -> None:
        """Write everything since the last step as one step; after a keyframe also a checkpoint if one is due."""
        assert clock.camera is not None and clock.first_ns is not None
        done, self._unwritten = self._unwritten, Unwritten()
        step = Step(
            kind=kind,
            stamp_ns=stamp_ns,
            camera=clock.camera,
            frames=tuple(done.frames),
            round_index=clock.round_index,
            first_index=clock.first_index,
            first_ns=clock.first_ns,
            num_frames=clock.num_frames,
            num_keyframes=clock.num_keyframes,
            counts=dict(counts),
            shape_counts=self._shapes.total_counts(),
            metrics=metrics,
            goes_back_to=done.goes_back_to,
            lost_views=done.lost_views,
            num_seeks=num_seeks(self._source),
        )
        checkpoint: Checkpoint | None = None
        if kind is StepKind.KEYFRAME and self._checkpoints.is_due(searches=len(core.searches) > 0):
            checkpoint = Checkpoint(core=core.state(), open_jobs=self._shapes.open_jobs)
        await self._recorder.commit(
            JournalEntry(step=step, events=tuple(done.events), told=done.told),
            color=color,
            known=core.snapshot(),
            checkpoint=checkpoint,
            dropped_views=done.dropped_views,
            # After a stop the jobs stay for a resumed run.
            ended_jobs=[] if kind is StepKind.CLOSING else done.ended_jobs,
            shapes=self._shapes,
        )
