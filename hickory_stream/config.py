"""Configuration of the mapper, composed of the configurations beside each algorithm."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from hickory_stream.base.config_text import converted, type_hints
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

if TYPE_CHECKING:
    from collections.abc import Mapping

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True, slots=True)
class RunConfig(Ranged):
    """How a run is carried out; of this only lossy `view_colors` change the map of a playback: the colours of meshes.

    Attributes:
        workers: child processes that build shapes.
        cluster: the address of a Dask scheduler, which then has the shapes built instead; `cluster_gpus` is the
            share of the resource GPU that a job needs there.
        shape_cache: shapes that were built from the same input before are not built again.
        generator: the program of the reconstructor "external", by its TOML or its name; `i_accept` is what its licence
            asks to be said.
        worker_python: their interpreter, where it is not ours: one in which the chosen reconstructor can run.
        job_timeout_s, job_memory_mb: a shape job that takes longer or more is tried once more, then given up; that
            depends on the machine, so that such a run is marked as not reproducible. So is one whose worker died.
        crop_margin: a kept view shows this share of its box more on every side.
        view_colors: kept views have their colours as PNG, or lossy and smaller; their masks and depths are exact.
        view_quality: how good those are that are lossy.
        time_jump_s: stamps that go forward by more than this are a jump of time.
        late_s: a frame whose stamp is behind the one before by no more than this is late, and left out.
        grace_s: after a stop, this long is waited for jobs that are running.
    """

    workers: int = number(2, 1, 1024, "processes")
    cluster: str = ""
    cluster_gpus: float = number(0.0, 0, 64, "GPUs")
    shape_cache: bool = True
    worker_python: str = ""
    generator: str = ""
    i_accept: str = ""
    job_timeout_s: float = number(60.0, 1e-9, 1e6, "s")
    job_memory_mb: float = number(4000.0, 1, 1e7, "MB")
    crop_margin: float = number(0.08, 0, 10, "share")
    view_colors: Literal["png", "jpeg", "webp"] = "png"
    view_quality: int = number(90, 1, 100, "percent")
    time_jump_s: float = number(60.0, 0.001, 1e9, "s")
    late_s: float = number(1.0, 0, 1e9, "s")
    grace_s: float = number(5.0, 0, 1e6, "s")


@dataclass(frozen=True, kw_only=True, slots=True)
class JournalConfig(Ranged):
    """What is kept of a run; nothing here changes the map.

    Attributes:
        flush_s: a lost power supply costs at most the events of so many seconds; a killed process costs none.
        checkpoint_keyframes: the state of the core is kept every so many keyframes, later while loops are searched:
            fewer make looking back, and going on after a kill, quicker, and the journal larger.
        keep_images: the images of keyframes are kept, for `replay --rrd`; `jpeg_quality` where the log has none.
    """

    flush_s: float = number(2.0, 0, 86400, "s")
    checkpoint_keyframes: int = number(40, 1, 1_000_000_000, "keyframes")
    keep_images: bool = True
    jpeg_quality: int = number(80, 1, 100, "percent")


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


def as_far_as_known(kind: type[T], data: Mapping[str, Any]) -> T:
    """Return the configuration of another version, as far as this one knows it; defaults for the rest."""
    values: dict[str, Any] = {}
    for name, hint in type_hints(kind).items():  # type: ignore[arg-type] # a class is hashable
        if name not in data:
            continue
        value = _with_lattice(data[name]) if hint is MappingConfig else data[name]
        if dataclasses.is_dataclass(hint) and isinstance(value, dict):
            values[name] = as_far_as_known(hint, value)  # type: ignore[arg-type]
            continue
        try:
            values[name] = converted(hint, value, name)
        except ConfigError:
            pass  # it means something else there
    try:
        return kind(**values)
    except ValueError:
        return kind()


def _with_lattice(mapping: Any) -> Any:
    if not isinstance(mapping, dict) or "lattice" in mapping:
        return mapping
    track = mapping.get("track")
    points_m = track.get("voxel_m") if isinstance(track, dict) else None
    found = {"points_m": points_m, "space_m": mapping.get("space_voxel_m")}
    return mapping | {"lattice": {name: value for name, value in found.items() if value is not None}}
