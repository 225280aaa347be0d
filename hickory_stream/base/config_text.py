"""TOML into checked, frozen dataclasses, and back; a key that nobody declared is refused with the nearest one that is.

It knows no configuration in particular; `former_keys` has the names that keys had in earlier versions.
"""

import dataclasses
import difflib
import tomllib
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from hickory_stream.base.former_keys import refusal
from hickory_stream.base.json_text import toml_string
from hickory_stream.base.ranges import ranges_of
from hickory_stream.base.type_forms import Form, form_of
from hickory_stream.errors import ConfigError, RangeError

T = TypeVar("T")


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
    hints = type_hints(kind)  # type: ignore[arg-type] # a class is hashable
    fields = {f.name for f in dataclasses.fields(kind)}  # type: ignore[arg-type]
    for key in data:
        if key not in fields:
            if (instead := refusal(f"{where}{key}", data[key])) is not None:
                raise ConfigError(instead)
            near = difflib.get_close_matches(key, fields, n=1)
            hint = f"did you mean {where}{near[0]}?" if near else f"known keys: {', '.join(sorted(fields))}"
            raise ConfigError(f"unknown configuration key {where}{key}; {hint}")
    values = {key: converted(hints[key], value, f"{where}{key}") for key, value in data.items()}
    try:
        return kind(**values)
    except RangeError as error:
        raise ConfigError(f"{where}{error}") from error
    except ValueError as error:
        raise ConfigError(f"configuration {where.rstrip('.') or 'of the mapper'}: {error}") from error


@cache
def type_hints(kind: type[Any]) -> Mapping[str, Any]:
    """Return the declared types of a dataclass's fields: a worker reads the same configuration in each job."""
    return get_type_hints(kind)


def to_toml(config: Any, first: tuple[str, ...] = ()) -> str:
    """Return a configuration as TOML; comments say what each value may be.

    The sections named in `first` stand first, in that order; the others follow as they are declared.
    """
    sections = dict(_sections(config, ""))
    order = [name for name in first if name in sections]
    return "\n\n".join(sections[name] for name in dict.fromkeys([*order, *sections])) + "\n"


def _sections(config: Any, name: str) -> Iterator[tuple[str, str]]:
    values = [(f.name, getattr(config, f.name)) for f in dataclasses.fields(config)]
    plain = [(key, value) for key, value in values if not dataclasses.is_dataclass(value) and value is not None]
    unset = [key for key, value in values if value is None]
    if plain or unset:
        summary = (type(config).__doc__ or "").partition("\n")[0]
        allowed = _allowed(type(config))
        lines = [f"# {summary}", f"[{name}]"] if name else []
        lines += [f"{key} = {_toml_value(value)}" + allowed.get(key, "") for key, value in plain]
        lines += [f"# {key} is not set" + allowed.get(key, "").replace("  # ", ": ") for key in unset]
        yield name, "\n".join(lines)
    for key, value in values:
        if dataclasses.is_dataclass(value):
            yield from _sections(value, f"{name}.{key}" if name else key)


def _allowed(kind: Any) -> dict[str, str]:
    """Return the comments that say which numbers and which words may be there."""
    told = {key: f"  # {found}" for key, found in ranges_of(kind).items()}
    forms = {key: form_of(hint) for key, hint in type_hints(kind).items()}
    words = {key: parts for key, (form, parts) in forms.items() if form is Form.LITERAL}
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


def converted(hint: Any, value: Any, where: str) -> Any:
    """Return `value` as the declared type: numbers widen to float, lists become tuples, tables dataclasses."""
    form, parts = form_of(hint)
    if form is Form.RECORD:
        if not isinstance(value, dict):
            raise ConfigError(f"{where} is a section, found {value!r}")
        return from_dict(hint, value, f"{where}.")
    if form is Form.LITERAL:
        if value not in parts:
            raise ConfigError(f"{where} is {value!r}; expected one of {', '.join(map(repr, parts))}")
        return value
    if form is Form.UNION:
        if value is None and type(None) in parts:  # as a map's manifest has what is not set; TOML has no null
            return None
        return next((converted(part, value, where) for part in parts if part is not type(None)), None)
    if form in (Form.TUPLE_OF, Form.TUPLE):
        if not isinstance(value, list | tuple):
            raise ConfigError(f"{where} is {value!r}; expected a list")
        return tuple(converted(parts[0], item, where) for item in value)
    if hint is float and isinstance(value, int | float) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError as error:
            raise ConfigError(f"{where} is a number of {len(str(value))} digits; expected float") from error
    if isinstance(hint, type) and isinstance(value, hint) and isinstance(value, bool) == (hint is bool):
        return value
    raise ConfigError(f"{where} is {value!r}; expected {getattr(hint, '__name__', hint)}")
