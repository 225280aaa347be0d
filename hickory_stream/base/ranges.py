"""Ranges: what a number of a configuration may be, declared beside it and enforced when it is constructed.

A configuration derives from `Ranged` and declares each number with `number(default, low, high, unit)`. Both ends of a
range belong to it and both are finite, so that NaN and infinity are never accepted.
"""

import dataclasses
from dataclasses import dataclass, field
from typing import Any, TypeVar

from hickory_stream.errors import RangeError

T = TypeVar("T")

_KEY = "range"


@dataclass(frozen=True, kw_only=True, slots=True)
class Range:
    """From `low` to `high`, both included, in `unit`: SI units, "px", "share", "ratio", or what is counted."""

    low: float
    high: float
    unit: str
    is_whole: bool = False

    def __str__(self) -> str:
        """Return the range for people, e.g. "0 to 60 s"."""
        return f"{_text(self.low)} to {_text(self.high)} {self.unit}"

    def check(self, name: str, value: Any) -> None:
        """Raise `RangeError` unless a number, or each of several, lies within; `name` is what the message calls it."""
        for item in value if isinstance(value, tuple | list) else (value,):
            if isinstance(item, bool) or not _lies_within(item, self.low, self.high):
                raise RangeError(f"{name} is {value!r}; expected {self}")
            if self.is_whole and item != int(item):
                raise RangeError(f"{name} is {value!r}; expected a whole number, {self}")


class Ranged:
    """Base of a configuration: refuses numbers outside of their ranges.

    A subclass with a `__post_init__` of its own calls `check_ranges(self)` there.
    """

    __slots__ = ()

    def __post_init__(self) -> None:
        """Raise `RangeError` for the first number outside of its range."""
        check_ranges(self)


def number(default: T, low: float, high: float, unit: str) -> T:
    """Return the field of a number, or of a tuple of them, with its range; None stands for "not given"."""
    told = Range(low=low, high=high, unit=unit, is_whole=isinstance(default, int))
    return field(default=default, metadata={_KEY: told})


def required(low: float, high: float, unit: str) -> Any:
    """Return the field of a number without a default, with its range."""
    return field(metadata={_KEY: Range(low=low, high=high, unit=unit)})


def check_ranges(config: Any) -> None:
    """Raise `RangeError` for the first number of a configuration that is outside of its range."""
    for name, told in ranges_of(type(config)).items():
        value = getattr(config, name)
        if value is not None:
            told.check(name, value)


def check_order(config: Any, low: str, high: str) -> None:
    """Raise `RangeError` where the field that is the lower end of something exceeds its upper end."""
    if getattr(config, low) > getattr(config, high):
        raise RangeError(f"{low} is {getattr(config, low)!r}; expected at most {high}, {getattr(config, high)!r}")


def ranges_of(kind: Any) -> dict[str, Range]:
    """Return the ranges of a configuration's own numbers, by their names."""
    return {f.name: f.metadata[_KEY] for f in dataclasses.fields(kind) if _KEY in f.metadata}


def _lies_within(value: Any, low: float, high: float) -> bool:
    try:
        return bool(low <= value <= high)
    except TypeError:
        return False


def _text(value: float) -> str:
    return str(int(value)) if value == int(value) and abs(value) < 1e12 else f"{value:g}"
