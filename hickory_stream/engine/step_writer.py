"""Collects what happens between two keyframes, and has it written as one step of the journal.

When the state of the core is written: every so many keyframes, and while no search for loops is open.

Writes to the disk while a run goes on: the pixels of kept views, then the step of the journal that needs them.

One thread does it all, in the order in which it was asked for: a step that is in the journal has its views beside it,
and what it drops is removed only after it is there.
"""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from hickory_stream.journal.step import Checkpoint, JournalEntry, Step, StepKind, Told
from hickory_stream.ports import num_seeks

if TYPE_CHECKING:
    from collections.abc import Callable

    from hickory_stream.engine.frame_accounting import RunClock
    from hickory_stream.engine.shape_jobs.queue import ShapeQueue
    from hickory_stream.events import Event, Publish
    from hickory_stream.journal.step import FramePose
    from hickory_stream.journal.writer import JournalWriter
    from hickory_stream.map_folder.history.rewind import Rewound
    from hickory_stream.map_folder.writer import MapFolder
    from hickory_stream.mapping.core import MapperCore
    from hickory_stream.ports import Source
    from hickory_stream.records import MapSnapshot


_LONGEST_WAIT = 2


class CheckpointTimes:
    """Counts the keyframes since the last checkpoint; `keyframes`: one is due after so many.

    A search that is open has the whole map as it was when it was asked for, and the surfaces of all submaps: in a
    building that is thirty times what has changed. So one waits until it is answered, at most twice as long.
    """

    def __init__(self, keyframes: int) -> None:
        self._keyframes = keyframes
        self._since = 0

    def is_due(self, *, searches: bool) -> bool:
        """Return whether the core is to be written after one more keyframe; `searches`: some search is open."""
        self._since += 1
        is_due = self._since >= self._keyframes * (_LONGEST_WAIT if searches else 1)
        if is_due:
            self._since = 0
        return is_due


@dataclass(slots=True)
class Unwritten:
    """What has happened since the last step: events, frames and `told` for the journal, and what to remove after it.

    `goes_back_to` and `lost_views` are those of the `Step`.
    """

    events: list[Event] = field(default_factory=list)
    frames: list[FramePose] = field(default_factory=list)
    dropped_views: list[str] = field(default_factory=list)
    ended_jobs: list[int] = field(default_factory=list)
    goes_back_to: int | None = None
    lost_views: tuple[str, ...] = ()
    told: Told | None = None


class Recorder:
    """Writes behind the run; each method waits for what was asked for before, and raises what went wrong with it."""

    def __init__(self, folder: MapFolder, journal: JournalWriter) -> None:
        self._folder = folder
        self._journal = journal
        self._thread = ThreadPoolExecutor(1, "write")
        self._writing: asyncio.Future[None] | None = None

    async def write_views(self, write: Callable[[], None]) -> None:
        """Have the pixels of views written."""
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
        """Have a step written, with what `color` gives; then remove the views that it dropped and the ended jobs.

        `known` is the map after it.
        """

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
        # A run that ends for another reason does not wait for it: its failure then is no news.
        self._writing.add_done_callback(lambda writing: writing.cancelled() or writing.exception())


Metrics = tuple[tuple[str, float], ...]


class StepWriter:
    """Collects frames, events and what is to be removed after them; `commit` makes a step of it.

    `snapshot` gives the map as the core holds it.
    """

    def __init__(
        self,
        recorder: Recorder,
        clock: RunClock,
        shapes: ShapeQueue,
        source: Source,
        snapshot: Callable[[], MapSnapshot],
        *,
        checkpoint_keyframes: int,
    ) -> None:
        self._recorder = recorder
        self._clock = clock
        self._shapes = shapes
        self._source = source
        self._snapshot = snapshot
        self._checkpoints = CheckpointTimes(checkpoint_keyframes)
        self._unwritten = Unwritten()

    def add_frame(self, frame: FramePose) -> None:
        """Note a frame that was read."""
        self._unwritten.frames.append(frame)

    def add_event(self, event: Event) -> None:
        """Note an event that the core is given."""
        self._unwritten.events.append(event)

    def add_published(self, published: Publish) -> None:
        """Note what the core decided, for people who ask why."""
        submap_id = published.snapshot.submaps[-1].id
        self._unwritten.told = Told(decisions=published.decisions, submap_id=submap_id)

    def drop_view(self, name: str) -> None:
        """Have the pixels of a view removed, once the step is written."""
        self._unwritten.dropped_views.append(name)

    def end_job(self, ticket: int) -> None:
        """Have the folder of a job that is over removed, once the step is written."""
        self._unwritten.ended_jobs.append(ticket)

    def rewind(self, rewound: Rewound, given_up: list[int]) -> None:
        """Discard the events that are not in the journal yet: the next step says from which one the core goes on."""
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
        *,
        metrics: Metrics = (),
        color: Callable[[], bytes | None] = lambda: None,
        core: MapperCore | None = None,
    ) -> None:
        """Have everything that happened since the last step written as one.

        `core`, that of a keyframe, is written too now and then: the journal need not be read from its beginning then.
        """
        clock = self._clock
        assert clock.camera is not None
        assert clock.first_ns is not None
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
            counts=dict(clock.counts),
            shape_counts=self._shapes.total_counts(),
            metrics=metrics,
            goes_back_to=done.goes_back_to,
            lost_views=done.lost_views,
            num_seeks=num_seeks(self._source),
        )
        checkpoint: Checkpoint | None = None
        if core is not None and self._checkpoints.is_due(searches=len(core.searches) > 0):
            checkpoint = Checkpoint(core=core.state(), open_jobs=self._shapes.open_jobs)
        await self._recorder.commit(
            JournalEntry(step=step, events=tuple(done.events), told=done.told),
            color=color,
            known=self._snapshot(),
            checkpoint=checkpoint,
            dropped_views=done.dropped_views,
            # After a stop the jobs stay: a run that is continued commits them when they are due.
            ended_jobs=[] if kind is StepKind.CLOSING else done.ended_jobs,
            shapes=self._shapes,
        )
