"""Records made of foreign values: every field must hold what its declaration says.

A dataclass checks no types by itself, and a text where a number should be becomes a file's name, or fails far from
where it came in.
"""

import dataclasses
import types
from collections.abc import Callable, Mapping
from typing import Any, get_type_hints

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.type_forms import Form, form_of

# Fields of records that earlier versions wrote, and which nothing reads.
_FORMER = {"Track": {"doubts"}}


def checked_record(kind: type, values: Mapping[str, Any], checks: Mapping[str, Callable[[Any], bool]]) -> Any:
    """Return a record of these fields, whose `checks` are `field_checks(kind, ...)`.

    Raises:
        TypeError: there is no such field, one is missing, or holds something else than is declared.
        ValueError: the record refuses the values.
    """
    former = _FORMER.get(kind.__name__, set()) & values.keys()
    if former:
        values = {name: value for name, value in values.items() if name not in former}
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
    form, parts = form_of(hint)
    match form:
        case Form.ANY:
            return lambda _: True
        case Form.LITERAL:
            return lambda value: value in parts
        case Form.ARRAY:
            return lambda value: isinstance(value, np.ndarray)
        case Form.ENUM | Form.RECORD:
            return lambda value: isinstance(value, parts[0])
        case Form.PLAIN if parts[0] is float:
            return lambda value: type(value) in (float, int)
        case Form.PLAIN if parts[0] in (int, bool, str, bytes, types.NoneType):
            return lambda value: type(value) is parts[0]
        case Form.PLAIN | Form.LIST:
            raise TypeError(f"a record declares {hint}, which no journal holds")
    fits = [_fits(part) for part in parts]
    match form:
        case Form.UNION:
            return lambda value: any(part(value) for part in fits)
        case Form.TUPLE_OF:
            return lambda value: isinstance(value, tuple) and all(map(fits[0], value))
        case Form.TUPLE:
            return lambda value: (
                isinstance(value, tuple)
                and len(value) == len(fits)
                and all(part(item) for part, item in zip(fits, value, strict=True))
            )
        case Form.SET:
            return lambda value: isinstance(value, set | frozenset) and all(map(fits[0], value))
    return lambda value: isinstance(value, dict) and all(fits[0](key) and fits[1](item) for key, item in value.items())
