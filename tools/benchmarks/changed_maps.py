"""Maps of recordings of worlds that change, without shapes: made once, and kept."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.base.config_text import read_config
from hickory_stream.config import MapperConfig
from hickory_stream.errors import MapFolderError
from hickory_stream.map_folder.saved_map import open_map
from players import open_source
from tools.benchmarks.played import play_into
from tools.worlds.cache import cached_recording

if TYPE_CHECKING:
    from pathlib import Path

    from hickory_stream.evaluation.truth import Truth
    from hickory_stream.map_folder.saved_map import SavedMap
    from tools.worlds.recording_config import RecordingConfig

_NO_SHAPES = ("mapping.requests.max_failures=0",)


def mapped(config: RecordingConfig, folder: Path) -> tuple[Truth, SavedMap]:
    """Return the truth and the map of a recording, which is played into the folder if it is not there yet."""
    log, truth = cached_recording(config)
    if not is_finished(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
        play_into(folder, open_source(str(log)), read_config(MapperConfig, None, _NO_SHAPES))
    return truth, open_map(folder)


def is_finished(folder: Path) -> bool:
    """Return whether a map was made to its end; an interrupted one is made anew."""
    try:
        return open_map(folder).manifest.finished_cleanly
    except MapFolderError:
        return False
