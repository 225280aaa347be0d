"""Configuration of the mapper, composed of the configurations beside each algorithm."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar

from hickory_stream.base.config_text import converted, type_hints
from hickory_stream.base.former_keys import with_current_names
from hickory_stream.base.ranges import Ranged, number
from hickory_stream.errors import ConfigError
from hickory_stream.geometry.depth_sensor import SensorConfig
from hickory_stream.graph.config import GraphConfig
from hickory_stream.loops.config import LoopConfig
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.rules.keyframes import KeyframeConfig
from hickory_stream.perception.perceive import PerceptionConfig
from hickory_stream.poses.registration_config import RegistrationConfig
from hickory_stream.shapes.build import ShapeConfig

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True, slots=True)
class RunConfig(Ranged):
    """How a run is carried out; of this only lossy `view_colors` change the map of a playback: the meshes' colours."""

    #: Child processes that build shapes.
    workers: int = number(2, 1, 1024, "processes")
    #: Address of a Dask scheduler, which then has the shapes built instead.
    cluster: str = ""
    #: Share of the resource GPU that a job needs on the cluster.
    cluster_gpus: float = number(0.0, 0, 64, "GPUs")
    #: Program of the reconstructor "external", by its TOML or its name.
    generator: str = ""
    #: The words by which the licence of that program is accepted.
    accept_licence: str = ""
    #: Interpreter of the workers, where it is not this one: one in which the chosen reconstructor can run.
    worker_python: str = ""
    #: Shapes that were built from the same input before are not built again.
    shape_cache: bool = True
    #: A shape job that takes longer is tried once more, then given up; such a run is marked as not reproducible.
    job_timeout_s: float = number(60.0, 1e-9, 1e6, "s")
    #: The same for a job that takes more memory.
    job_memory_mb: float = number(4000.0, 1, 1e7, "MB")
    #: A kept view shows this share of its box more on every side.
    crop_margin: float = number(0.08, 0, 10, "share")
    #: Colours of kept views: exact (`png`), or lossy; their masks and depths are exact.
    view_colors: Literal["png", "jpeg", "webp"] = "png"
    #: Quality of lossy colours.
    view_quality: int = number(90, 1, 100, "percent")
    #: Stamps that go forward by more than this are a jump of time.
    time_jump_s: float = number(60.0, 0.001, 1e9, "s")
    #: A frame whose stamp is behind the one before by no more than this is late, and left out.
    max_late_s: float = number(1.0, 0, 1e9, "s")
    #: How long jobs that are running are waited for after a stop.
    grace_s: float = number(5.0, 0, 1e6, "s")


@dataclass(frozen=True, kw_only=True, slots=True)
class JournalConfig(Ranged):
    """What is kept of a run; nothing here changes the map."""

    #: Maximum time between writes: a lost power supply costs at most the events of so many seconds.
    flush_s: float = number(2.0, 0, 86400, "s")
    #: Keyframes between saved states of the core: fewer make looking back quicker, and the journal larger.
    checkpoint_keyframes: int = number(80, 1, 1_000_000_000, "keyframes")
    #: Whether the images of keyframes are kept, for `replay --rrd`.
    keep_images: bool = True


@dataclass(frozen=True, kw_only=True, slots=True)
class MapperConfig:
    """Everything that the mapper is configured by."""

    sensor: SensorConfig = field(default_factory=SensorConfig)
    keyframes: KeyframeConfig = field(default_factory=KeyframeConfig)
    registration: RegistrationConfig = field(default_factory=RegistrationConfig)
    perception: PerceptionConfig = field(default_factory=PerceptionConfig)
    mapping: MappingConfig = field(default_factory=MappingConfig)
    loops: LoopConfig = field(default_factory=LoopConfig)
    graph: GraphConfig = field(default_factory=GraphConfig)
    shapes: ShapeConfig = field(default_factory=ShapeConfig)
    run: RunConfig = field(default_factory=RunConfig)
    journal: JournalConfig = field(default_factory=JournalConfig)


def as_far_as_known(data: Mapping[str, Any]) -> MapperConfig:
    """Return the configuration that another version wrote, as far as this one knows it; the rest has its defaults."""
    return _known(MapperConfig, with_current_names(data))


def _known(kind: type[T], data: Mapping[str, Any]) -> T:
    values: dict[str, Any] = {}
    for name, hint in type_hints(kind).items():  # type: ignore[arg-type] # a class is hashable
        if name not in data:
            continue
        if dataclasses.is_dataclass(hint) and isinstance(data[name], dict):
            values[name] = _known(hint, data[name])  # type: ignore[arg-type]
            continue
        try:
            values[name] = converted(hint, data[name], name)
        except ConfigError:
            pass  # it means something else there
    try:
        return kind(**values)
    except ValueError:
        return kind()
