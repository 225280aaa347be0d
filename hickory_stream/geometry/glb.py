"""The arrays of a GLB file, as far as `write_glb` makes one: one mesh of triangles, in its own frame, in one buffer.

A reader of all of glTF opens other files that a file names, and takes the memory that it claims: neither may happen
with a folder that came from somebody else. What is more than one mesh of ours is refused.
"""

from __future__ import annotations

import json
import struct
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_HEADER = struct.Struct("<4sII")
_CHUNK = struct.Struct("<I4s")
_TYPES: dict[int, np.dtype[Any]] = {
    5121: np.dtype("u1"),
    5123: np.dtype("<u2"),
    5125: np.dtype("<u4"),
    5126: np.dtype("<f4"),
}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_TRIANGLES = 4
_PLACES = ("matrix", "translation", "rotation", "scale", "children", "skin")


def glb_arrays(data: bytes) -> dict[str, NDArray[Any]]:
    """Return the vertex attributes of the one mesh in a GLB by their names, and `indices` (F, 3).

    Attributes are (V,) or (V, n). Indices name vertices that there are.

    Raises:
        ValueError: it is no GLB, is damaged, or holds other things than one mesh of triangles.
    """
    try:
        document, binary = _chunks(data)
        for node in document.get("nodes", []):
            if any(name in node for name in _PLACES):
                raise ValueError("a node moves its mesh, expected a mesh in its own frame")
        (mesh,) = document["meshes"]
        (primitive,) = mesh["primitives"]
        if primitive.get("mode", _TRIANGLES) != _TRIANGLES:
            raise ValueError("its mesh is not made of triangles")
        arrays = {str(name): _accessor(document, binary, i) for name, i in primitive["attributes"].items()}
        indices = _accessor(document, binary, primitive["indices"])
        count = len(arrays["POSITION"])
    except (KeyError, TypeError, IndexError, AttributeError, struct.error, RecursionError) as error:
        raise ValueError(f"no GLB of one mesh: {error!r}") from error
    if indices.dtype.kind != "u" or indices.ndim != 1 or len(indices) % 3 or len(indices) == 0:
        raise ValueError("it holds no triangles")
    if int(indices.max()) >= count or any(len(array) != count for array in arrays.values()):
        raise ValueError(f"its triangles or attributes name other vertices than the {count} that there are")
    return {**arrays, "indices": indices.reshape(-1, 3)}


def _chunks(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the document and the buffer."""
    magic, version, length = _HEADER.unpack_from(data)
    if magic != b"glTF" or version != 2 or length != len(data):
        raise ValueError(f"it is no whole GLB of version 2: {len(data)} bytes, {length} announced")
    found: dict[bytes, bytes] = {}
    at = _HEADER.size
    while at < len(data):
        size, kind = _CHUNK.unpack_from(data, at)
        at += _CHUNK.size
        if at + size > len(data):
            raise ValueError(f"a chunk of {size} bytes reaches beyond the end")
        found[kind] = data[at : at + size]
        at += size
    document = json.loads(found[b"JSON"])
    if document.get("extensionsRequired") or document.get("images"):
        raise ValueError("it needs extensions or images, which no mesh of ours has")
    (buffer,) = document["buffers"]
    if "uri" in buffer:
        raise ValueError("its buffer is another file")
    return document, found[b"BIN\0"]


def _accessor(document: dict[str, Any], binary: bytes, index: int) -> NDArray[Any]:
    """Return the (N,) or (N, n) array of an accessor; what it claims must lie in the buffer."""
    accessor = _item(document["accessors"], index)
    view = _item(document["bufferViews"], accessor["bufferView"])
    dtype, width = _TYPES[accessor["componentType"]], _WIDTHS[accessor["type"]]
    if "byteStride" in view or "sparse" in accessor:
        raise ValueError("an array is interleaved or sparse, expected one after the other")
    count, start, size = accessor["count"], view.get("byteOffset", 0), view["byteLength"]
    start += accessor.get("byteOffset", 0)
    if not all(type(n) is int and 0 <= n <= len(binary) for n in (count, start, size)):
        raise ValueError("an array lies outside of the buffer")
    if start + count * width * dtype.itemsize > len(binary):
        raise ValueError(f"an array of {count} x {width} reaches beyond the buffer")
    flat = np.frombuffer(binary, dtype, count=count * width, offset=start)
    return flat if width == 1 else flat.reshape(count, width)


def _item(items: list[Any], index: Any) -> Any:
    if type(index) is not int or not 0 <= index < len(items):
        raise ValueError(f"there is no array {index!r}")
    return items[index]
