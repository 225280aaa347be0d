"""Publishes what a run does: to sinks, to the consumer that iterates over the snapshots, and to the progress bar."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.engine.report_poses import in_map_frame
from hickory_stream.engine.run_progress import Progress

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from hickory_stream.engine.run_clock import RunClock
    from hickory_stream.engine.shape_queue import ShapeQueue
    from hickory_stream.engine.sink_threads import SinkThread
    from hickory_stream.records import FrameReport, MapSnapshot


class Announcer:
    """Keeps the newest `snapshot`, whose pose corrections reports are shown with; `waits`: for sinks that are full."""

    def __init__(
        self,
        sinks: Sequence[SinkThread],
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
        """How many reports were left out for sinks that could not keep up."""
        return sum(sink.num_dropped for sink in self._sinks)

    @property
    def backlogs(self) -> list[int]:
        """How many reports wait for each sink."""
        return [sink.backlog for sink in self._sinks]

    def publish(self, snapshot: MapSnapshot) -> None:
        """Hand out the map as it is now."""
        self.snapshot = snapshot
        self._publish(snapshot)

    async def show(self, report: FrameReport) -> None:
        """Hand a report to every sink; raises `HickoryError` where an essential one has failed."""
        placed = in_map_frame(report, self.snapshot)
        for sink in self._sinks:
            await sink.show(placed, waits=self._waits)

    def progress(
        self, phase: str, clock: RunClock, shapes: ShapeQueue, *, num_compiled: int = 0, num_kernels: int = 0
    ) -> None:
        """Say where the run is, of `total` frames."""
        self._progress(
            Progress(
                phase=phase,
                num_compiled=num_compiled,
                num_kernels=num_kernels,
                frames=clock.num_frames,
                total=self.total,
                keyframes=clock.num_keyframes,
                objects=len(self.snapshot.objects) if self.snapshot is not None else 0,
                open_shapes=shapes.num_open,
            )
        )
