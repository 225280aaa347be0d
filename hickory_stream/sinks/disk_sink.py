"""Saves snapshots into the map folder at intervals; a save costs as much as the objects that changed since the last."""

from dataclasses import dataclass

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.map_folder.writer import MapFolder
from hickory_stream.records import FrameReport, MapSnapshot


@dataclass(frozen=True, kw_only=True, slots=True)
class DiskSinkConfig(Ranged):
    """How often the map is saved.

    `every_keyframes`: a save at most every so many keyframes; a killed run loses no more than these.
    """

    every_keyframes: int = number(20, 1, 1_000_000_000, "keyframes")


class DiskSink:
    """Saves the map while it grows, and once more at the end.

    `show` and `close` raise `MapFolderError` on a disk error; the folder then opens as of the previous save.
    """

    def __init__(self, folder: MapFolder, config: DiskSinkConfig | None = None) -> None:
        self._folder = folder
        self._every = (config or DiskSinkConfig()).every_keyframes
        self._unsaved: MapSnapshot | None = None
        self._keyframes_since_save = 0

    def show(self, report: FrameReport) -> None:
        """Keep the report's snapshot, and save it when it is due."""
        if report.snapshot is None:
            return
        self._unsaved = report.snapshot
        self._keyframes_since_save += 1
        if self._keyframes_since_save >= self._every:
            self._save()

    def close(self) -> None:
        """Save the last snapshot if it is not saved yet."""
        self._save()

    def _save(self) -> None:
        if self._unsaved is not None:
            self._folder.save(self._unsaved)
            self._unsaved = None
            self._keyframes_since_save = 0
