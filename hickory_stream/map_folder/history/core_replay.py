"""Replay of a recorded run by the core alone, without perception, workers or a clock, to the same map."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hickory_stream.errors import MapFolderError
from hickory_stream.events import CancelShape, Effect, Event, Publish, RequestShape, ShapeFailed, ShapeReady
from hickory_stream.journal.step import JournalEntry, OpenJob, Step
from hickory_stream.mapping.core import MapperCore

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from hickory_stream.journal.reader import Journal
    from hickory_stream.mapping.config import MappingConfig
    from hickory_stream.records import MapSnapshot


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Replayed:
    """A replayed step."""

    index: int
    entry: JournalEntry
    #: Map and decisions of a keyframe, None for other steps.
    published: Publish | None


# Errors of the core on events and states that are well-formed one by one but contradict one another.
_NONSENSE = (ValueError, LookupError, TypeError, AttributeError, AssertionError, ArithmeticError, MemoryError)


class Replay:
    """The core of a recorded run after some step; `steps` advances it, `on_request` receives shape jobs.

    `reads_later`: arrays of the checkpoint are read on first use (`Journal.checkpoint_before`).
    """

    def __init__(
        self,
        journal: Journal,
        config: MappingConfig,
        on_request: Callable[[RequestShape], None] = lambda _: None,
        *,
        reads_later: bool = False,
    ) -> None:
        self._reads_later = reads_later
        self._on_request = on_request
        self._journal = journal
        self._config = config
        self.core = MapperCore(config)
        self.open_jobs: dict[int, OpenJob] = {}
        self.num_steps = 0

    def seek(self, index: int) -> None:
        """Restore the core after a step, from the last checkpoint before it.

        Raises `MapFolderError`: a damaged journal.
        """
        found = self._journal.checkpoint_before(index, reads_later=self._reads_later)
        if found is not None:
            after, checkpoint = found
            try:
                self.core = MapperCore.from_state(self._config, checkpoint.core)
            except _NONSENSE:
                pass  # a checkpoint of another version: the events are all that is needed
            else:
                self.open_jobs = {job.ticket: job for job in checkpoint.open_jobs}
                self.num_steps = after + 1
        for _ in self.steps(index + 1):
            pass

    def steps(self, end: int) -> Iterator[Replayed]:
        """Replay and yield steps up to the step `end`, exclusive."""
        while self.num_steps < end:
            entry = self._journal.entry(self.num_steps)
            self._go_back(entry.step)
            effects = [effect for event in entry.events for effect in self._handle(event)]
            published = next((effect for effect in reversed(effects) if isinstance(effect, Publish)), None)
            self.num_steps += 1
            yield Replayed(index=self.num_steps - 1, entry=entry, published=published)

    def snapshot(self) -> MapSnapshot:
        """Return the current map. Raises `MapFolderError`: a damaged journal."""
        with self._damage():
            return self.core.snapshot()

    @contextmanager
    def _damage(self) -> Iterator[None]:
        # An event that the core cannot process is damage of the journal.
        try:
            yield
        except _NONSENSE as error:
            raise MapFolderError(
                f"{self._journal.path} is damaged or does not fit this version: {error!r}; play the log again"
            ) from error

    def _go_back(self, step: Step) -> None:
        if step.goes_back_to is None:
            return
        then = Replay(self._journal, self._config, reads_later=self._reads_later)
        if step.goes_back_to > 0:
            then.seek(step.goes_back_to - 1)
        with self._damage():
            self.core = then.core.going_on_after(self.core, step.lost_views)
        self.open_jobs = then.open_jobs

    def _handle(self, event: Event) -> list[Effect]:
        with self._damage():
            effects = self.core.handle(event)
        if isinstance(event, ShapeReady | ShapeFailed):
            self.open_jobs.pop(event.ticket, None)
        for effect in effects:
            if isinstance(effect, RequestShape):
                self._on_request(effect)
                job = OpenJob(ticket=effect.ticket, object_id=effect.object_id, due_ns=effect.due_ns)
                self.open_jobs[effect.ticket] = job
            elif isinstance(effect, CancelShape):
                self.open_jobs.pop(effect.ticket, None)
        return effects


def mesh_names(journal: Journal) -> set[str]:
    """Return all meshes that the map ever had."""
    ready = (event for index in range(len(journal)) for event in journal.events(index, "ShapeReady"))
    return {event.shape.mesh_name for event in ready if isinstance(event, ShapeReady)}
