"""The whole configuration file: sections of the mapper and of the sinks."""

from dataclasses import dataclass, field

from hickory_stream.config import MapperConfig
from hickory_stream.sinks.disk_sink import DiskSinkConfig
from hickory_stream.sinks.rerun.config import RerunConfig

SET_OFTEN = (
    "mapper.keyframes",
    "mapper.sensor",
    "mapper.perception",
    "mapper.shapes",
    "mapper.shapes.inflate",
    "mapper.run",
    "rerun",
)
"""The sections that users set, which `config dump` prints first; the README of the command line explains them."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Settings:
    """`mapper` decides the map; `disk` how often it is saved; `rerun` what is shown of it."""

    mapper: MapperConfig = field(default_factory=MapperConfig)
    disk: DiskSinkConfig = field(default_factory=DiskSinkConfig)
    rerun: RerunConfig = field(default_factory=RerunConfig)
