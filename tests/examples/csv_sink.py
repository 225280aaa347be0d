"""Example of a sink: a CSV file with one row for each object of each keyframe."""

import csv

COLUMNS = ("stamp_ns", "object_id", "phase", "x_m", "y_m", "z_m", "sightings", "has_shape")


class CsvSink:
    """Writes `path` row by row; the constructor raises OSError if the file cannot be opened."""

    def __init__(self, path):
        self._stream = path.open("w", encoding="utf-8", newline="")
        self._table = csv.writer(self._stream)
        self._table.writerow(COLUMNS)

    def show(self, report):
        """Write the objects of the map after a keyframe; reports of other frames have no snapshot."""
        if report.snapshot is None:
            return
        for item in report.snapshot.objects:
            place = (f"{x:.3f}" for x in item.box.center)
            self._table.writerow(
                (report.stamp_ns, item.id, item.phase, *place, item.sightings, int(item.shape is not None))
            )
        self._stream.flush()

    def close(self):
        """Close the file."""
        self._stream.close()
