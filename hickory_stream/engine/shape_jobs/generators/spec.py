"""A generator as its TOML describes it: program, requirements and licence."""

import hashlib
import os
import shutil
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hickory_stream.base.config_text import from_dict
from hickory_stream.base.ranges import Ranged, number
from hickory_stream.errors import ConfigError

FOLDER_VARIABLE = "HICKORY_GENERATORS"
CHOICE_VARIABLE = "HICKORY_GENERATOR"
"""Names the TOML to shape workers: a job never names a program, since it may come from anybody."""

_CHUNK = 1 << 20


@dataclass(frozen=True, kw_only=True, slots=True)
class GeneratorSpec(Ranged):
    """A generator."""

    #: The map names it as the maker of a shape.
    name: str
    #: Started in the folder of the TOML; paths are relative to it.
    command: tuple[str, ...]
    environment: tuple[tuple[str, str], ...] = ()
    #: Of a cluster's worker, e.g. GPU = 1.
    resources: tuple[tuple[str, str], ...] = ()
    licence: str = "not stated"
    #: Text that `run.accept_licence` must repeat, "" for none.
    acceptance: str = ""
    #: TOML, beside this one, of a pose refiner; "" for none.
    refiner: str = ""
    #: Files whose content decides shapes.
    weights: tuple[str, ...] = ()
    #: Number of views that it uses, the best first.
    views: int = number(1, 1, 64, "views")
    start_s: float = number(300.0, 0.01, 86400, "s")
    time_s: float = number(120.0, 0.01, 86400, "s")
    #: Of its processes together; `start_s` and `time_s` limit its start and one object.
    memory_mb: float = number(16_000.0, 1, 1e7, "MB")
    folder: Path = field(default_factory=Path)


def read_spec(path: Path) -> GeneratorSpec:
    """Return the generator of a TOML. Raises `ConfigError`: no such file, not TOML, or an unknown key."""
    try:
        data: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"cannot read the generator {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is not TOML: {error}") from error
    for missing in {"name", "command"} - set(data):
        raise ConfigError(f"{path} lacks {missing}; a generator has a name and a command")
    for table in ("environment", "resources"):
        found = data.pop(table, {})
        if not isinstance(found, dict):
            raise ConfigError(f"{path}: {table} is {found!r}; expected a table")
        data[table] = [[str(key), str(value)] for key, value in sorted(found.items())]
    tables = {name: tuple((key, value) for key, value in data.pop(name)) for name in ("environment", "resources")}
    if "folder" in data:
        raise ConfigError(f"{path}: folder is no key of a generator")
    spec = from_dict(GeneratorSpec, data, where=f"{path.name}: ")
    if not spec.command or not spec.name:
        raise ConfigError(f"{path}: name and command must not be empty")
    values = {name: getattr(spec, name) for name in GeneratorSpec.__dataclass_fields__}
    return GeneratorSpec(**{**values, **tables, "folder": path.resolve().parent})


def refiner_of(spec: GeneratorSpec) -> GeneratorSpec | None:
    """Return the pose refiner of a generator, None without one. Raises `ConfigError` like `read_spec`."""
    if not spec.refiner:
        return None
    found = read_spec(spec.folder / spec.refiner)
    if found.refiner:
        raise ConfigError(f"the refiner {found.name} of {spec.name} names a refiner of its own; it can have none")
    return found


def cluster_resources(spec: GeneratorSpec) -> dict[str, float]:
    """Return the resources that a job needs of a cluster's worker, e.g. {"GPU": 1.0}.

    Raises `ConfigError`: a resource is no positive number.
    """
    found = {}
    for name, text in spec.resources:
        try:
            amount = float(text)
        except ValueError:
            amount = 0.0
        if not 0 < amount < float("inf"):
            raise ConfigError(f"the generator {spec.name}: [resources] {name} is {text!r}; expected a number above 0")
        found[name] = amount
    return found


def generators_folder() -> Path:
    """Return the folder of generators by name: $HICKORY_GENERATORS, else a folder of the user's."""
    return Path(os.environ.get(FOLDER_VARIABLE) or Path.home() / ".config" / "hickory-stream" / "generators")


def find_spec(name: str) -> Path:
    """Return the TOML of a generator, given by path or by name. Raises `ConfigError`: there is none."""
    path = Path(name)
    if path.suffix == ".toml":
        if not path.is_file():
            raise ConfigError(f"there is no generator {path}; name its TOML, or one of `generators list`")
        return path.resolve()
    kept = generators_folder() / f"{name}.toml"
    if not name or not kept.is_file():
        found = f"run.generator is {name!r}, and {kept} is not there"
        raise ConfigError(f"{found}; name a TOML, or one of `generators list`")
    return kept.resolve()


def check_licence(spec: GeneratorSpec, accepted: str) -> None:
    """Raise `ConfigError` unless the licence's text was accepted word by word; semicolons separate several."""
    if spec.acceptance and spec.acceptance not in (part.strip() for part in accepted.split(";")):
        raise ConfigError(
            f"the generator {spec.name} is under {spec.licence}; if you accept that, "
            f'say run.accept_licence = "{spec.acceptance}" (found {accepted!r})'
        )


def missing_of(spec: GeneratorSpec) -> list[str]:
    """Return missing parts: program, scripts and weights."""
    missing = []
    if program_of(spec) is None:
        missing.append(f"the program {spec.command[0]} (install its environment, see its script)")
    scripts = [spec.folder / argument for argument in spec.command[1:] if argument.endswith(".py")]
    missing += [f"the script {path}" for path in scripts if not path.is_file()]
    missing += [f"the weights {spec.folder / name}" for name in spec.weights if not (spec.folder / name).exists()]
    return missing


def program_of(spec: GeneratorSpec) -> str | None:
    """Return the program, None if it is missing."""
    first = spec.command[0]
    if os.sep in first:
        path = spec.folder / first
        return str(path) if os.access(path, os.X_OK) and path.is_file() else None
    return shutil.which(first)


def fingerprint(spec: GeneratorSpec) -> str:
    """Return the hash of everything that decides its shapes: TOML, scripts, weights."""
    said = (spec.name, spec.command, spec.environment, spec.licence, spec.views)
    digest = hashlib.sha256(repr(said).encode())
    if (refiner := refiner_of(spec)) is not None:
        digest.update(fingerprint(refiner).encode())
    files = [spec.folder / argument for argument in spec.command if (spec.folder / argument).is_file()]
    for path in [*files, *(spec.folder / name for name in spec.weights)]:
        for part in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if part.is_file():
                digest.update(part.name.encode())
                with part.open("rb") as content:
                    while chunk := content.read(_CHUNK):
                        digest.update(chunk)
    return digest.hexdigest()
