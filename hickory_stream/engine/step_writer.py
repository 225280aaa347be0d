"""Collects what happens between two keyframes, and has it written as one step of the journal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.engine.checkpoint_times import CheckpointTimes
from hickory_stream.engine.recorder import Unwritten
from hickory_stream.engine.step import Checkpoint, JournalEntry, Step, StepKind, Told
from hickory_stream.ports import num_seeks

if TYPE_CHECKING:
    from collections.abc import Callable

    from hickory_stream.engine.history.rewind import Rewound
    from hickory_stream.engine.recorder import Recorder
    from hickory_stream.engine.run_clock import RunClock
    from hickory_stream.engine.shape_queue import ShapeQueue
    from hickory_stream.engine.step import FramePose
    from hickory_stream.events import Event, Publish
    from hickory_stream.mapping.core import MapperCore
    from hickory_stream.ports import Source
    from hickory_stream.records import MapSnapshot

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
