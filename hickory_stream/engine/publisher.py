"""Publishes reports to sinks, snapshots to the consumer, and progress to the bar.

Each sink has a thread behind a bounded queue. If an essential sink fails, the run stops; any other is dropped with
a warning.
"""

import asyncio
import logging
import queue
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace

from hickory_stream.engine.frame_accounting import RunClock
from hickory_stream.engine.modes import Progress
from hickory_stream.engine.shape_jobs.queue import ShapeQueue
from hickory_stream.errors import OutputError
from hickory_stream.map_folder.history.frame_reports import in_map_frame
from hickory_stream.ports import Sink
from hickory_stream.records import Decision, FrameReport, MapSnapshot

logger = logging.getLogger(__name__)


class ReportPublisher:
    """Publishes the newest `snapshot`, by which it corrects the poses of reports; `waits`: for full sinks."""

    def __init__(
        self,
        sinks: "Sequence[SinkThread]",
        publish: Callable[[MapSnapshot], None],
        progress: Callable[[Progress], None],
        *,
        waits: bool,
    ) -> None:
        self._sinks = sinks
        self._publish = publish
        self._progress = progress
        self._waits = waits
        self.snapshot: MapSnapshot | None = None
        self.total: int | None = None

    @property
    def num_not_shown(self) -> int:
        """Number of reports that slow sinks did not get."""
        return sum(sink.num_dropped for sink in self._sinks)

    @property
    def backlogs(self) -> list[int]:
        """Number of reports that wait for each sink."""
        return [sink.backlog for sink in self._sinks]

    def publish(self, snapshot: MapSnapshot) -> None:
        """Publish the current map."""
        self.snapshot = snapshot
        self._publish(snapshot)

    async def show(self, report: FrameReport, *, is_last: bool = False) -> None:
        """Send a report to every sink, the last one with patience; raises `HickoryError`: an essential one failed."""
        placed = in_map_frame(report, self.snapshot)
        timeout_s = None if self._waits else _CLOSE_TIMEOUT_S if is_last else 0.0
        for sink in self._sinks:
            await sink.show(placed, timeout_s=timeout_s)

    def progress(self, phase: str, clock: RunClock, shapes: ShapeQueue, *, kernels: tuple[int, int]) -> None:
        """Report the progress of the run; `kernels` are the numbers compiled and estimated while some are missing."""
        self._progress(
            Progress(
                phase=phase,
                num_compiled=kernels[0],
                num_kernels=kernels[1],
                frames=clock.num_frames,
                total=self.total,
                keyframes=clock.num_keyframes,
                objects=len(self.snapshot.objects) if self.snapshot is not None else 0,
                open_shapes=shapes.num_open,
            )
        )


_CAPACITY = 16
# Where a sink is slow, frames between keyframes are missed first.
_CAPACITY_BETWEEN = 8
_CLOSE_TIMEOUT_S = 5.0


class SinkThread:
    """Runs one sink; `show` waits while its queue is full (playback), or counts the report in `num_dropped`.

    The decisions of a report that a sink misses come with the next one: what happened to an object is never lost.
    """

    def __init__(self, sink: Sink, *, is_essential: bool) -> None:
        self._sink = sink
        self.is_essential = is_essential
        self._queue: queue.Queue[FrameReport | None] = queue.Queue(_CAPACITY)
        self._error: BaseException | None = None
        self._missed: tuple[Decision, ...] = ()
        self.num_dropped = 0
        self._thread = threading.Thread(target=self._work, name=f"sink-{type(sink).__name__}", daemon=True)
        self._thread.start()

    async def show(self, report: FrameReport, *, timeout_s: float | None = None) -> None:
        """Queue a report; a slow sink that is not essential misses it after the timeout, None: never.

        Raises `HickoryError`: an essential sink has failed.
        """
        self._raise_if_failed()
        if self._missed:
            report = replace(report, decisions=(*self._missed, *report.decisions))
        patience_s = None if self.is_essential else timeout_s
        capacity = _CAPACITY if patience_s is None or report.keyframe_index is not None else _CAPACITY_BETWEEN
        try:
            if self.backlog < capacity:
                self._queue.put_nowait(report)
            elif patience_s == 0:
                raise queue.Full
            else:
                await asyncio.to_thread(self._queue.put, report, timeout=patience_s)
        except queue.Full:
            self.num_dropped += 1
            self._missed = report.decisions
        else:
            self._missed = ()

    async def close(self) -> None:
        """Let the sink finish its queue, for at most 5 s unless it is essential.

        Raises `HickoryError`: an essential sink has failed.
        """
        timeout_s = None if self.is_essential else _CLOSE_TIMEOUT_S
        try:
            await asyncio.to_thread(self._queue.put, None, timeout=timeout_s)
        except queue.Full:
            logger.warning("%s hangs and is left behind", type(self._sink).__name__)
            return
        await asyncio.to_thread(self._thread.join, timeout_s)
        self._raise_if_failed()

    @property
    def lost_output(self) -> str | None:
        """Why a requested file is incomplete; None if nothing was lost."""
        return str(self._error) if isinstance(self._error, OutputError) else None

    @property
    def backlog(self) -> int:
        """Number of waiting reports."""
        return self._queue.qsize()

    def _raise_if_failed(self) -> None:
        if self._error is not None and self.is_essential:
            raise self._error

    def _work(self) -> None:
        while True:
            report = self._queue.get()
            if self._error is not None and report is not None:
                continue
            try:
                if report is None:
                    return self._sink.close()
                self._sink.show(report)
            except Exception as error:  # noqa: BLE001 -- a sink is foreign code: its failure is kept and judged above
                self._error = self._error or error
                if not self.is_essential:
                    logger.warning("%s failed and is set aside: %s", type(self._sink).__name__, error)
                if report is None:
                    return None
