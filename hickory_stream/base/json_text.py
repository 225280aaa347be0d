"""JSON for every reader, without NaN and infinity; the only place where JSON is written.

Characters beyond ASCII are escaped, so that none of them commands a terminal.
"""

import json
import math
from typing import Any

from hickory_stream.base.terminal import UNSAFE


def dumps(data: Any, *, indent: int | None = None, sort_keys: bool = False) -> str:
    """Return JSON for people and programs; NaN and infinity become null, numpy's values plain ones."""
    return json.dumps(_with_nulls(data), indent=indent, sort_keys=sort_keys, allow_nan=False)


def dumps_exactly(data: Any, *, indent: int | None = None) -> str:
    """Return JSON that is read back unchanged. Raises `ValueError`: a number is NaN or infinite."""
    return json.dumps(data, indent=indent, allow_nan=False)


def _with_nulls(data: Any) -> Any:
    if hasattr(data, "dtype") and hasattr(data, "tolist"):
        data = data.tolist()
    if isinstance(data, float):
        return data if math.isfinite(data) else None
    if isinstance(data, dict):
        return {key: _with_nulls(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_with_nulls(item) for item in data]
    return data


def toml_string(text: str) -> str:
    """Return text as a basic string of TOML, which has JSON's escapes except surrogate pairs."""
    quoted = json.dumps(text, ensure_ascii=False)
    return UNSAFE.sub(lambda found: f"\\u{ord(found[0]):04x}", quoted)
