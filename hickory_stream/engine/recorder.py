"""Writes to the disk while a run goes on: the pixels of kept views, then the step of the journal that needs them.

One thread does it all, in the order in which it was asked for: a step that is in the journal has its views beside it,
and what it drops is removed only after it is there.
"""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from hickory_stream.engine.journal_writer import JournalWriter
    from hickory_stream.engine.map_folder import MapFolder
    from hickory_stream.engine.shape_queue import ShapeQueue
    from hickory_stream.engine.step import Checkpoint, FramePose, JournalEntry, Told
    from hickory_stream.events import Event
    from hickory_stream.records import MapSnapshot


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
