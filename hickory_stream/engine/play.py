"""One run from outside the event loop: blocking, with signals."""

from __future__ import annotations

import asyncio
import signal
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hickory_stream.ports import Sink, Source, interrupt

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Mapping

    from hickory_stream.engine.mapper import Mapper
    from hickory_stream.engine.modes import Mode, Progress
    from hickory_stream.map_folder.writer import MapFolder
    from hickory_stream.records import MapSnapshot


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Played:
    """The result of a run."""

    #: The last one, None if the run was stopped before the first.
    snapshot: MapSnapshot | None
    finished_cleanly: bool
    was_stopped: bool
    is_reproducible: bool
    processor: str
    digest: str | None
    #: Why requested files beside the map are incomplete.
    lost_outputs: tuple[str, ...] = ()


def play(
    mapper: Mapper,
    source: Source,
    *,
    sinks: Callable[[MapFolder], list[tuple[Sink, bool]]],
    progress: Callable[[Progress], None],
    rate: float | None = None,
    mode: Mode = "playback",
    loops: int = 1,
    source_note: Mapping[str, Any] | None = None,
) -> Played:
    """Map a source. The first SIGINT or SIGTERM ends the run in order and saves it, the second cancels it.

    Arguments as of `Mapper.run`; the caller closes the source.

    Raises `HickoryError`: the source, the disk or the core failed; the folder holds the map so far;
    `KeyboardInterrupt`: a second signal cancelled the run.
    """
    try:
        snapshots = mapper.run(
            source, sinks=sinks, rate=rate, mode=mode, loops=loops, progress=progress, source_note=source_note
        )
        return asyncio.run(_play(mapper, snapshots, source))
    except asyncio.CancelledError:
        raise KeyboardInterrupt from None


async def _play(mapper: Mapper, snapshots: AsyncIterator[MapSnapshot], source: Source) -> Played:
    snapshot: MapSnapshot | None = None
    async with mapper:
        with _Signals(mapper, source):
            async for newest in snapshots:
                snapshot = newest
        assert mapper.folder is not None
        manifest = mapper.folder.manifest
    return Played(
        snapshot=snapshot,
        finished_cleanly=manifest.finished_cleanly,
        was_stopped=mapper.was_stopped,
        is_reproducible=manifest.is_reproducible,
        processor=manifest.processor,
        digest=manifest.digest,
        lost_outputs=mapper.lost_outputs,
    )


class _Signals:
    def __init__(self, mapper: Mapper, source: Source) -> None:
        self._mapper = mapper
        self._source = source
        self._task = asyncio.current_task()
        self._loop = asyncio.get_running_loop()
        self._count = 0

    def __enter__(self) -> None:
        if sys.platform != "win32":
            for number in (signal.SIGINT, signal.SIGTERM):
                self._loop.add_signal_handler(number, self._handle)

    def __exit__(self, *_: object) -> None:
        if sys.platform != "win32":
            for number in (signal.SIGINT, signal.SIGTERM):
                self._loop.remove_signal_handler(number)

    def _handle(self) -> None:
        self._count += 1
        if self._count == 1:
            self._mapper.stop()
            interrupt(self._source)
        elif self._task is not None:
            self._task.cancel()
