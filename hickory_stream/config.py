"""Configuration: TOML into checked, frozen dataclasses.

Every algorithm declares its own configuration beside itself; this module only puts them together, and reads and writes
any of them. A key that nobody declared is refused with the nearest one that somebody did.
"""

from __future__ import annotations

import dataclasses
import difflib
import tomllib
import types
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from hickory_stream.errors import ConfigError, RangeError
from hickory_stream.geometry.depth_sensor import SensorConfig
from hickory_stream.graph.config import GraphConfig
from hickory_stream.json_text import toml_string
from hickory_stream.loops.config import LoopConfig
from hickory_stream.mapping.keyframes import KeyframeConfig
from hickory_stream.mapping.mapping_config import MappingConfig
from hickory_stream.perception.perceive import PerceptionConfig
from hickory_stream.poses.registration_config import RegistrationConfig
from hickory_stream.ranges import Ranged, number, ranges_of
from hickory_stream.shapes.build import ShapeConfig

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

T = TypeVar("T")

_ONE_LATTICE = "the one lattice of perception and mapping"
_MOVED = {
    "perception.observe.voxel_m": ("mapping.lattice.points_m", _ONE_LATTICE),
    "mapping.track.voxel_m": ("mapping.lattice.points_m", _ONE_LATTICE),
    "perception.space.voxel_m": ("mapping.lattice.space_m", _ONE_LATTICE),
    "mapping.space_voxel_m": ("mapping.lattice.space_m", _ONE_LATTICE),
    "perception.geometric.shades": ("perception.geometric.color_split", "its new name"),
    "perception.geometric.hidden_area_px": ("perception.geometric.occluded_area_px", "its new name"),
    "perception.geometric.hidden_share": ("perception.geometric.occluded_share", "its new name"),
    "perception.geometric.structure.relief": ("perception.geometric.structure.raised_patches", "its new name"),
    "perception.geometric.join.hidden": ("perception.geometric.join.bridging", "its new name"),
    "perception.masks.hidden_share": ("perception.masks.occluded_share", "its new name"),
    "mapping.parts": ("mapping.split", "its new name"),
    "mapping.floating": ("mapping.unsupported", "its new name"),
}
"""Keys of earlier versions: what to set instead, and why."""

_PRIOR = "what the map says of a frame is perception.geometric.join.map_prior"
_LEARNED = "trees that have learned what the network's odds are worth join fragments"
_SEEN = "what is filled follows from what was seen around it"
_GONE = {
    "perception.map_guided_merge": _PRIOR,
    "perception.known": _PRIOR,
    **dict.fromkeys(
        (
            f"perception.affinities.{name}"
            for name in ("join", "least_odds", "far_weight", "trees_weight", "near_weight", "far_odds_weight")
        ),
        _LEARNED,
    ),
    "perception.affinities.odds_shift": _LEARNED,
    "perception.affinities.structure_odds": "what is structure is seen by geometry",
    "perception.affinities.thing_odds": "what is structure is seen by geometry",
    **dict.fromkeys(
        (f"shapes.fused.completion.{name}" for name in ("full_share", "min_hidden_m", "max_hidden_m")), _SEEN
    ),
}
"""Keys of earlier versions without a successor, or the sections of such, and why."""


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
        checkpoint_keyframes: the state of the core is kept every so many keyframes: fewer make looking back quicker.
        keep_images: the images of keyframes are kept, for `replay --rrd`; `jpeg_quality` where the log has none.
    """

    flush_s: float = number(2.0, 0, 86400, "s")
    checkpoint_keyframes: int = number(12, 1, 1_000_000_000, "keyframes")
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


def read_config(kind: type[T], path: Path | None, overrides: tuple[str, ...] = ()) -> T:
    """Return the configuration of a TOML file, with `section.key=value` overrides; the defaults where `path` is None.

    Raises:
        ConfigError: no such file, not TOML, an unknown key, a value of the wrong type, or one that its owner refuses.
    """
    data: dict[str, Any] = {}
    if path is not None:
        try:
            data = tomllib.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise ConfigError(f"cannot read the configuration {path}: {error.strerror}") from error
        except (ValueError, RecursionError) as error:  # beside TOMLDecodeError: too many digits, too deep
            raise ConfigError(f"{path} is not TOML: {error}") from error
    for override in overrides:
        _override(data, override)
    return from_dict(kind, data)


def from_dict(kind: type[T], data: dict[str, Any], where: str = "") -> T:
    """Return a configuration dataclass from nested dicts; missing keys keep their defaults.

    Raises:
        ConfigError: naming the key, what was found and what is expected.
    """
    hints = _type_hints(kind)  # type: ignore[arg-type] # a class is hashable
    fields = {f.name for f in dataclasses.fields(kind)}  # type: ignore[arg-type]
    for key in data:
        if key not in fields:
            old = f"{where}{key}".removeprefix("mapper.")
            if old in _GONE:
                raise ConfigError(f"{where}{key} is no setting any more: {_GONE[old]}")
            if (moved := _MOVED.get(old)) is not None:
                root = "mapper." if where.startswith("mapper.") else ""
                raise ConfigError(f"{where}{key} is no setting any more: set {root}{moved[0]}, {moved[1]}")
            near = difflib.get_close_matches(key, fields, n=1)
            hint = f"did you mean {where}{near[0]}?" if near else f"known keys: {', '.join(sorted(fields))}"
            raise ConfigError(f"unknown configuration key {where}{key}; {hint}")
    values = {key: _converted(hints[key], value, f"{where}{key}") for key, value in data.items()}
    try:
        return kind(**values)
    except RangeError as error:
        raise ConfigError(f"{where}{error}") from error
    except ValueError as error:
        raise ConfigError(f"configuration {where.rstrip('.') or 'of the mapper'}: {error}") from error


def as_far_as_known(kind: type[T], data: Mapping[str, Any]) -> T:
    """Return the configuration that another version wrote, as far as this one knows it; the rest has its defaults."""
    values: dict[str, Any] = {}
    for name, hint in _type_hints(kind).items():  # type: ignore[arg-type] # a class is hashable
        if name not in data:
            continue
        value = _with_lattice(data[name]) if hint is MappingConfig else data[name]
        if dataclasses.is_dataclass(hint) and isinstance(value, dict):
            values[name] = as_far_as_known(hint, value)  # type: ignore[arg-type]
            continue
        try:
            values[name] = _converted(hint, value, name)
        except ConfigError:
            pass  # it means something else there
    try:
        return kind(**values)
    except ValueError:
        return kind()


def _with_lattice(mapping: Any) -> Any:
    """Return what a manifest says of the mapping, of which versions without a lattice had the numbers elsewhere."""
    if not isinstance(mapping, dict) or "lattice" in mapping:
        return mapping
    track = mapping.get("track")
    points_m = track.get("voxel_m") if isinstance(track, dict) else None
    found = {"points_m": points_m, "space_m": mapping.get("space_voxel_m")}
    return mapping | {"lattice": {name: value for name, value in found.items() if value is not None}}


@cache
def _type_hints(kind: type[Any]) -> Mapping[str, Any]:
    """Return the declared types of a dataclass's fields: a worker reads the same configuration in each job."""
    return get_type_hints(kind)


def to_toml(config: Any) -> str:
    """Return a configuration as TOML, sections in the order of their declaration; comments say what may be there."""
    lines: list[str] = []
    _write_section(config, "", lines)
    return "\n".join(lines).strip() + "\n"


def _write_section(config: Any, name: str, lines: list[str]) -> None:
    values = [(f.name, getattr(config, f.name)) for f in dataclasses.fields(config)]
    plain = [(key, value) for key, value in values if not dataclasses.is_dataclass(value) and value is not None]
    unset = [key for key, value in values if value is None]
    if plain or unset:
        if name:
            summary = (type(config).__doc__ or "").partition("\n")[0]
            lines += ["", f"# {summary}", f"[{name}]"]
        allowed = _allowed(type(config))
        lines += [f"{key} = {_toml_value(value)}" + allowed.get(key, "") for key, value in plain]
        lines += [f"# {key} is not set" + allowed.get(key, "").replace("  # ", ": ") for key in unset]
    for key, value in values:
        if dataclasses.is_dataclass(value):
            _write_section(value, f"{name}.{key}" if name else key, lines)


def _allowed(kind: Any) -> dict[str, str]:
    """Return the comments that say which numbers and which words may be there."""
    told = {key: f"  # {found}" for key, found in ranges_of(kind).items()}
    words = {key: get_args(hint) for key, hint in _type_hints(kind).items() if get_origin(hint) is Literal}
    return told | {key: f"  # {' or '.join(map(_toml_value, found))}" for key, found in words.items()}


def _toml_value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return toml_string(value)
    if isinstance(value, tuple | list):
        return "[" + ", ".join(_toml_value(v) for v in value) + "]"
    return repr(value)


def _override(data: dict[str, Any], override: str) -> None:
    """Put `a.b.c=value` into nested dicts; the value is TOML, or a bare string."""
    path, equals, text = override.partition("=")
    if not equals or not path.strip():
        raise ConfigError(f"found the override {override!r}; expected SECTION.KEY=VALUE")
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        value = text
    *sections, key = path.strip().split(".")
    for section in sections:
        data = data.setdefault(section, {})
        if not isinstance(data, dict):
            raise ConfigError(f"override {override!r}: {section} is a value, not a section")
    data[key] = value


def _converted(hint: Any, value: Any, where: str) -> Any:
    """Return `value` as the declared type: numbers widen to float, lists become tuples, tables dataclasses."""
    origin = get_origin(hint)
    if dataclasses.is_dataclass(hint):
        if not isinstance(value, dict):
            raise ConfigError(f"{where} is a section, found {value!r}")
        return from_dict(hint, value, f"{where}.")  # type: ignore[arg-type]
    if origin is Literal:
        if value not in get_args(hint):
            raise ConfigError(f"{where} is {value!r}; expected one of {', '.join(map(repr, get_args(hint)))}")
        return value
    if origin in (Union, types.UnionType):
        if value is None and type(None) in get_args(hint):  # as a map's manifest has what is not set; TOML has no null
            return None
        return next((_converted(part, value, where) for part in get_args(hint) if part is not type(None)), None)
    if origin is tuple:
        if not isinstance(value, list | tuple):
            raise ConfigError(f"{where} is {value!r}; expected a list")
        return tuple(_converted(get_args(hint)[0], item, where) for item in value)
    if hint is float and isinstance(value, int | float) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError as error:
            raise ConfigError(f"{where} is a number of {len(str(value))} digits; expected float") from error
    if isinstance(hint, type) and isinstance(value, hint) and isinstance(value, bool) == (hint is bool):
        return value
    raise ConfigError(f"{where} is {value!r}; expected {getattr(hint, '__name__', hint)}")
