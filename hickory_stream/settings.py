"""The whole configuration file: sections of the mapper and of the sinks."""

from __future__ import annotations

from dataclasses import dataclass, field

from hickory_stream.config import MapperConfig
from hickory_stream.sinks.disk_sink import DiskSinkConfig
from hickory_stream.sinks.rerun.config import RerunConfig


@dataclass(frozen=True, kw_only=True, slots=True)
class Settings:
    """`mapper` decides the map; `disk` how often it is saved; `rerun` what is shown of it."""

    mapper: MapperConfig = field(default_factory=MapperConfig)
    disk: DiskSinkConfig = field(default_factory=DiskSinkConfig)
    rerun: RerunConfig = field(default_factory=RerunConfig)
