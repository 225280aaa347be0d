"""Sinks on threads of their own, each behind a bounded queue.

The sink that keeps the map is essential: when it fails, the run must stop and say so. Any other is for looking: when it
fails, it is set aside with a warning and the mapping goes on.
"""

from __future__ import annotations

import asyncio
import logging
import queue
import threading
from typing import TYPE_CHECKING

from hickory_stream.errors import OutputError

if TYPE_CHECKING:
    from hickory_stream.ports import Sink
    from hickory_stream.records import FrameReport

logger = logging.getLogger(__name__)

_CAPACITY = 16
_CLOSE_TIMEOUT_S = 5.0


class SinkThread:
    """Runs one sink; `show` waits while its queue is full (playback loses nothing), or counts in `num_dropped`."""

    def __init__(self, sink: Sink, *, is_essential: bool) -> None:
        self._sink = sink
        self.is_essential = is_essential
        self._queue: queue.Queue[FrameReport | None] = queue.Queue(_CAPACITY)
        self._error: BaseException | None = None
        self.num_dropped = 0
        self._thread = threading.Thread(target=self._work, name=f"sink-{type(sink).__name__}", daemon=True)
        self._thread.start()

    async def show(self, report: FrameReport, *, waits: bool = True) -> None:
        """Hand a report over; unless it `waits`, a sink for looking that is behind does not get it.

        Raises:
            HickoryError: an essential sink has failed.
        """
        self._raise_if_failed()
        try:
            self._queue.put_nowait(report)
        except queue.Full:
            if not waits and not self.is_essential:
                self.num_dropped += 1
                return
            await asyncio.to_thread(self._queue.put, report)

    async def close(self) -> None:
        """Let the sink finish what it was given; a sink for looking is given up after 5 s.

        Raises:
            HickoryError: an essential sink has failed.
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
        """Why a file that was asked for is not there to its end; None where nothing was lost."""
        return str(self._error) if isinstance(self._error, OutputError) else None

    @property
    def backlog(self) -> int:
        """How many reports wait."""
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
