"""The end of a run: its sinks are closed, and the ledger, the timings and the manifest of its map are written."""

from __future__ import annotations

import asyncio
import shutil
from typing import TYPE_CHECKING, Any

from hickory_stream import caches
from hickory_stream.errors import MapFolderError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from hickory_stream.engine.journal_writer import JournalWriter
    from hickory_stream.engine.map_folder import MapFolder
    from hickory_stream.engine.run import Run
    from hickory_stream.engine.sink_threads import SinkThread
    from hickory_stream.ports import Source
    from hickory_stream.records import MapSnapshot


class MapSaver:
    """Keeps the newest snapshot and saves it at the end: the sink of a mapper that was given none."""

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

    Essential sinks are closed first, so that a viewer that hangs cannot keep the map from being finished.

    Raises:
        Exception: the first error of an essential sink or of the journal, after everything was closed.
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
        # Asked here: what the run counts belongs to the event loop.
        ledger, timings, is_reproducible = run.ledger(), run.timings(), run.is_reproducible
        is_finished = is_clean and failed is None
        await asyncio.to_thread(_finish, folder, ledger, timings, is_clean=is_finished, is_reproducible=is_reproducible)
    await asyncio.gather(*(thread.close() for thread in threads if not thread.is_essential))
    if failed is not None:
        raise failed


def why_empty(source: Source, run: Run) -> str | None:
    """Return why a source that was played to its end has given no map, None if it has or was not played to its end."""
    uri, counts = source.info.uri, run.counts
    if not run.is_complete:
        return None
    if run.num_keyframes == 0:
        told = ", ".join(f"{name} {count}" for name, count in sorted({**source.ledger(), **counts}.items()))
        needed = "it must hold colour, depth and poses that overlap in time"
        return f"{uri} gave no usable frame ({told or 'nothing'}); {needed}"
    if counts.get("keyframes_without_depth", 0) == run.num_keyframes:
        return f"{uri} has no depth in any of {run.num_keyframes} keyframes; mapping needs depth in metres above 0"
    return None


def _finish(
    folder: MapFolder,
    ledger: Mapping[str, Any],
    timings: Mapping[str, float],
    *,
    is_clean: bool,
    is_reproducible: bool,
) -> None:
    folder.write_json("ledger.json", ledger)
    folder.write_json("timings.json", timings)
    if is_clean:
        shutil.rmtree(folder.jobs, ignore_errors=True)
    folder.finish(finished_cleanly=is_clean, is_reproducible=is_reproducible)
    if is_clean:
        caches.prune()
