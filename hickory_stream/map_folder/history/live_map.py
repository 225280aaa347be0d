"""The map of a live run that continues or was cut off, as of the newest step of its journal.

A robot avoids everything seen, sure or not: beside the map is the surface that keyframes saw.
"""

from pathlib import Path

from hickory_stream.events import FrameObserved
from hickory_stream.journal.reader import Journal
from hickory_stream.map_folder.history.core_replay import Replay
from hickory_stream.map_folder.history.recorded_config import recorded_config
from hickory_stream.map_folder.history.time_travel import step_at
from hickory_stream.map_folder.saved_map import SavedMap
from hickory_stream.navigation.stand_ins import SeenSurface
from hickory_stream.records import MapSnapshot


def is_live(saved: SavedMap) -> bool:
    """Return whether a map is of a live run that has not ended."""
    return saved.manifest.run.get("mode") == "live" and not saved.manifest.finished_cleanly


def live_map(path: Path, stamp_ns: int | None = None) -> tuple[MapSnapshot, SeenSurface] | None:
    """Return map and seen surface at a stamp (None: the newest); None before the first keyframe.

    Raises `MapFolderError`: there is no journal, or it is damaged or of another version.
    """
    with Journal(path) as journal:
        index = len(journal) - 1 if stamp_ns is None else step_at(journal.stamps_ns, stamp_ns)
        if index is None or index < 0:
            return None
        replay = Replay(journal, recorded_config(path).mapping, reads_later=True)
        replay.seek(index)
        snapshot = replay.snapshot()
        seen = SeenSurface()
        for i in range(index + 1):
            entry = journal.entry(i)
            for event in entry.events:
                if isinstance(event, FrameObserved) and entry.told is not None:
                    seen.add_to(entry.told.submap_id, event.space, snapshot.submaps[-1].observed_space.voxel_m)
        return snapshot, seen
