"""A sink of one's own: one line for each object of each keyframe, for a spreadsheet."""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from hickory_stream.records import FrameReport

COLUMNS = ("stamp_ns", "object_id", "phase", "x_m", "y_m", "z_m", "sightings", "has_shape")


class CsvSink:
    """Writes `path` line by line; a file that cannot be opened is refused when the sink is made."""

    def __init__(self, path: Path) -> None:
        self._stream = path.open("w", encoding="utf-8", newline="")
        self._table = csv.writer(self._stream)
        self._table.writerow(COLUMNS)

    def show(self, report: FrameReport) -> None:
        """Write the objects as the map has them after a keyframe; between keyframes there is nothing to write."""
        if report.snapshot is None:
            return
        for tracked in report.snapshot.objects:
            place = (f"{x:.3f}" for x in tracked.box.center)
            has_shape = int(tracked.shape is not None)
            self._table.writerow((report.stamp_ns, tracked.id, tracked.phase, *place, tracked.sightings, has_shape))
        self._stream.flush()

    def close(self) -> None:
        """Close the file."""
        self._stream.close()
