"""Records made of foreign values: every field must hold what its declaration says.

A dataclass checks no types by itself, and a text where a number should be becomes a file's name, or fails far from
where it came in.
"""

from __future__ import annotations

import dataclasses
import types
from collections.abc import Callable, Mapping
from enum import Enum
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray


def checked_record(kind: type, values: Mapping[str, Any], checks: Mapping[str, Callable[[Any], bool]]) -> Any:
    """Return a record of these fields, whose `checks` are `field_checks(kind, ...)`.

    Raises:
        TypeError: there is no such field, one is missing, or holds something else than is declared.
        ValueError: the record refuses the values.
    """
    for name, value in values.items():
        fits = checks.get(name)
        if fits is None:
            raise TypeError(f"{kind.__name__} has no field {name!r}")
        if not fits(value):
            raise TypeError(f"{kind.__name__}.{name} is of {type(value).__name__}")
    return kind(**values)


def field_checks(kind: type, known: Mapping[str, type]) -> dict[str, Callable[[Any], bool]]:
    """Return for each field of a record what tells whether a value fits; `known` are the records that it may name.

    Raises:
        TypeError: it is no record, or declares what is neither known nor a plain value or array.
    """
    if not dataclasses.is_dataclass(kind):
        raise TypeError(f"{kind.__name__} is no record")
    # Declarations name types that are imported for the type checker alone.
    names = {**known, "NDArray": NDArray, "Mapping": Mapping, "Any": Any, "np": np}
    try:
        hints = get_type_hints(kind, localns=names)
    except NameError as error:
        raise TypeError(f"{kind.__name__} is in no journal: {error}") from error
    return {field.name: _fits(hints[field.name]) for field in dataclasses.fields(kind)}


def _fits(hint: Any) -> Callable[[Any], bool]:
    """Return what tells whether a value is of a declared type."""
    origin, arguments = get_origin(hint), get_args(hint)
    if hint is Any or hint is object:
        return lambda _: True
    if hint is float:
        return lambda value: type(value) in (float, int)
    if hint in (int, bool, str, bytes):
        return lambda value: type(value) is hint
    if origin is Literal:
        return lambda value: value in arguments
    if origin in (Union, types.UnionType):
        parts = [_fits(part) for part in arguments]
        return lambda value: any(part(value) for part in parts)
    if origin is tuple:
        return _tuple_fits(arguments)
    if origin in (dict, Mapping):
        key_fits, value_fits = (_fits(part) for part in arguments)
        return lambda value: (
            isinstance(value, dict) and all(key_fits(key) and value_fits(item) for key, item in value.items())
        )
    if origin in (set, frozenset):
        item_fits = _fits(arguments[0])
        return lambda value: isinstance(value, set | frozenset) and all(item_fits(item) for item in value)
    if origin is np.ndarray:
        return lambda value: isinstance(value, np.ndarray)
    if isinstance(hint, type) and (dataclasses.is_dataclass(hint) or issubclass(hint, Enum | types.NoneType)):
        return lambda value: isinstance(value, hint)
    raise TypeError(f"a record declares {hint}, which no journal holds")


def _tuple_fits(arguments: tuple[Any, ...]) -> Callable[[Any], bool]:
    if len(arguments) == 2 and arguments[1] is Ellipsis:
        each = _fits(arguments[0])
        return lambda value: isinstance(value, tuple) and all(each(item) for item in value)
    parts = [_fits(part) for part in arguments]
    return lambda value: (
        isinstance(value, tuple)
        and len(value) == len(parts)
        and all(fits(item) for fits, item in zip(parts, value, strict=True))
    )
