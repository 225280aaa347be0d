"""Numbers, texts, poses and small arrays of a JSON document: written exactly, and checked when they are read."""

from __future__ import annotations

import base64
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.geometry.rigid import is_rigid

if TYPE_CHECKING:
    from numpy.typing import NDArray


def json_number(value: float | None) -> float | str | None:
    """Return a float for JSON; JSON knows no infinity, which becomes a string that `float` reads."""
    return None if value is None else float(value) if math.isfinite(value) else str(float(value))


def maybe_float(value: float | str | None) -> float | None:
    """Return a number that `json_number` made."""
    return None if value is None else float(value)


def json_numbers(array: NDArray[np.float64]) -> Any:
    """Return a small array as nested lists; Python writes the shortest text that reads back as the same double."""
    values = array.tolist()
    return values if np.isfinite(array).all() else np.vectorize(json_number, otypes=[object])(array).tolist()


def to_array(values: Any) -> NDArray[np.float64]:
    """Return nested lists as an array."""
    return np.asarray(values, dtype=np.float64)


def finite_array(values: Any) -> NDArray[np.float64]:
    """Return nested lists of finite numbers as an array; raises `ValueError`."""
    array = to_array(values)
    if not np.isfinite(array).all():
        raise ValueError(f"found {values}, expected finite numbers")
    return array


def finite(value: Any) -> float:
    """Return a number of the map; a text, which `float` would take, is refused."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"found {value!r}, expected a finite number")
    return float(value)


def rigid_pose(values: Any) -> NDArray[np.float64]:
    """Return a rigid (4, 4) transform; raises `ValueError`."""
    pose = to_array(values)
    if not is_rigid(pose):
        raise ValueError(f"found {values}, expected a rigid (4, 4) transform")
    return pose


def flag(value: Any) -> bool:
    """Return true or false; raises `ValueError`."""
    if not isinstance(value, bool):
        raise ValueError(f"found {value!r}, expected true or false")
    return value


def plain_text(value: Any) -> str:
    """Return a text; raises `ValueError`."""
    if not isinstance(value, str):
        raise ValueError(f"found {value!r}, expected a text")
    return value


def stamp(value: Any) -> int:
    """Return a stamp, ns: an integer of up to 63 bits; raises `ValueError`."""
    if isinstance(value, bool) or not isinstance(value, int) or abs(value) >= 2**63:
        raise ValueError(f"found the stamp {str(value)[:40]!r}, expected nanoseconds")
    return value


def json_float32s(array: NDArray[np.float32] | None) -> str | None:
    """Return float32 values as base64, None as None."""
    return None if array is None else base64.b64encode(array.astype("<f4").tobytes()).decode()


def float32s(text: str | None) -> NDArray[np.float32] | None:
    """Return what `json_float32s` wrote."""
    return None if text is None else np.frombuffer(base64.b64decode(text, validate=True), "<f4").astype(np.float32)
