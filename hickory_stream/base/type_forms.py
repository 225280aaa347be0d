"""Type hints of records by their form; configurations, journals and JSON schemas read hints here alone."""

import dataclasses
import types
from collections.abc import Mapping
from enum import Enum, auto
from typing import Any, Literal, NotRequired, Union, get_args, get_origin, is_typeddict


class Form(Enum):
    """What a hint is built as."""

    ANY = auto()
    PLAIN = auto()
    LITERAL = auto()
    UNION = auto()
    MAPPING = auto()
    LIST = auto()
    #: `tuple[X, ...]`
    TUPLE_OF = auto()
    TUPLE = auto()
    SET = auto()
    ARRAY = auto()
    ENUM = auto()
    RECORD = auto()


def form_of(hint: Any) -> tuple[Form, tuple[Any, ...]]:
    """Return the form of a hint, and its parts: words of a literal, types of members, keys and items, or a class.

    Raises:
        TypeError: no record may hold it.
    """
    origin, parts = get_origin(hint), get_args(hint)
    if hint is Any or hint is object:
        return Form.ANY, ()
    if origin is NotRequired:
        return form_of(parts[0])
    if origin is Literal:
        return Form.LITERAL, parts
    if origin in (Union, types.UnionType):
        return Form.UNION, parts
    if origin in (dict, Mapping):
        return Form.MAPPING, parts
    if origin is list:
        return Form.LIST, parts
    if origin is tuple:
        return (Form.TUPLE_OF, parts[:1]) if parts[-1] is Ellipsis else (Form.TUPLE, parts)
    if origin in (set, frozenset):
        return Form.SET, parts
    if getattr(origin, "__name__", "") == "ndarray":
        return Form.ARRAY, ()
    if dataclasses.is_dataclass(hint) or is_typeddict(hint):
        return Form.RECORD, (hint,)
    if isinstance(hint, type):
        return (Form.ENUM if issubclass(hint, Enum) else Form.PLAIN), (hint,)
    raise TypeError(f"a record declares {hint!r}, which has no known form")
