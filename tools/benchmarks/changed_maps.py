"""Maps of recordings of worlds that change, without shapes: made once, and kept."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.config import MapperConfig, read_config
from hickory_stream.engine.mapper import Mapper
from hickory_stream.engine.play import play
from hickory_stream.engine.saved_map import open_map
from hickory_stream.settings import Settings
from hickory_stream.sinks.disk_sink import DiskSink
from hickory_stream.worlds.cache import cached_recording
from players import open_source

if TYPE_CHECKING:
    from pathlib import Path

    from hickory_stream.engine.saved_map import SavedMap
    from hickory_stream.evaluation.truth import Truth
    from hickory_stream.worlds.recording_config import RecordingConfig

_NO_SHAPES = ("mapping.requests.max_failures=0",)


def mapped(config: RecordingConfig, folder: Path) -> tuple[Truth, SavedMap]:
    """Return the truth and the map of a recording, which is played anew into the folder."""
    log, truth = cached_recording(config)
    folder.parent.mkdir(parents=True, exist_ok=True)
    source = open_source(str(log))
    try:
        mapper = Mapper(read_config(MapperConfig, None, _NO_SHAPES), out=folder, overwrite=True)
        play(
            mapper,
            source,
            sinks=lambda made: [(DiskSink(made, Settings().disk), True)],
            rate=None,
            loops=1,
            progress=lambda _: None,
        )
    finally:
        source.close()
    return truth, open_map(folder)
