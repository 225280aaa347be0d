"""JSON Schema (draft 2020-12) of typed records: dataclasses and typed dicts, as `json_text.dumps` writes them."""

import ast
import dataclasses
import inspect
from functools import cache
from importlib import import_module
from typing import Any, NotRequired, get_origin, get_type_hints

from hickory_stream.base.ranges import ranges_of
from hickory_stream.base.type_forms import Form, form_of

_PLAIN = {str: "string", int: "integer", bool: "boolean", type(None): "null"}


def schema_of(kind: Any) -> dict[str, Any]:
    """Return the schema of a type; keys that it does not declare are not allowed.

    Args:
        kind: a record, or what its fields may be. A float without a value is null.
    """
    form, parts = form_of(kind)
    match form:
        case Form.ANY:
            return {}
        case Form.PLAIN if parts[0] is float:
            return {"type": ["number", "null"]}
        case Form.PLAIN if parts[0] in _PLAIN:
            return {"type": _PLAIN[parts[0]]}
        case Form.LITERAL:
            return {"enum": list(parts)}
        case Form.UNION:
            return {"anyOf": [schema_of(part) for part in parts]}
        case Form.MAPPING:
            return {"type": "object", "additionalProperties": schema_of(parts[1])}
        case Form.LIST | Form.TUPLE_OF:
            return {"type": "array", "items": schema_of(parts[0])}
        case Form.TUPLE:
            items = [schema_of(part) for part in parts]
            return {"type": "array", "prefixItems": items, "items": False, "minItems": len(items)}
        case Form.ENUM:
            return {"enum": [member.value for member in parts[0]]}
        case Form.RECORD:
            return _record_schema(parts[0])
    raise TypeError(f"no JSON is known for {kind!r}")


def _record_schema(kind: Any) -> dict[str, Any]:
    hints = get_type_hints(kind, localns=_checkers_names(kind.__module__), include_extras=True)
    properties = {name: schema_of(hint) for name, hint in hints.items()}
    if dataclasses.is_dataclass(kind):
        for name, told in ranges_of(kind).items():
            properties[name] = {**properties[name], "minimum": told.low, "maximum": told.high, "$comment": told.unit}
    summary = (kind.__doc__ or "").partition("\n")[0]
    return {
        "type": "object",
        "description": summary,
        "properties": properties,
        "required": [name for name, hint in hints.items() if get_origin(hint) is not NotRequired],
        "additionalProperties": False,
    }


@cache
def _checkers_names(module: str) -> dict[str, Any]:
    """Return what a module imports for the type checker alone: annotations of its records name it."""
    names: dict[str, Any] = {}
    for node in ast.parse(inspect.getsource(import_module(module))).body:
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            for found in node.body:
                if isinstance(found, ast.ImportFrom) and found.module is not None:
                    source = import_module(found.module)
                    names |= {alias.asname or alias.name: getattr(source, alias.name) for alias in found.names}
    return names
