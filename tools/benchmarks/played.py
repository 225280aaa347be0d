"""A source that is played into a map folder, without a word, as `play` does it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.engine.mapper import Mapper
from hickory_stream.engine.play import play
from hickory_stream.settings import Settings
from hickory_stream.sinks.disk_sink import DiskSink

if TYPE_CHECKING:
    from pathlib import Path

    from hickory_stream.config import MapperConfig
    from hickory_stream.ports import Source


def play_into(folder: Path, source: Source, config: MapperConfig) -> None:
    """Map a source into a folder, replacing what is there, and close it."""
    try:
        play(
            Mapper(config, out=folder, overwrite=True),
            source,
            sinks=lambda made: [(DiskSink(made, Settings().disk), True)],
            progress=lambda _: None,
        )
    finally:
        source.close()
