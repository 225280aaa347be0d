"""Triangle meshes as plain arrays, and their GLB files.

The GLB says by the attribute `_SEEN` which vertices were seen. Only one mesh of triangles in one buffer is read: a
reader of all of glTF opens other files, and takes the memory that a foreign file claims.
"""

import hashlib
import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.arrays import freeze

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
    """Return the vertex attributes, (V,) or (V, n), of the one mesh in a GLB by their names, and `indices` (F, 3).

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
    # (N,) or (N, n); an accessor's claim must lie in the buffer.
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


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Mesh:
    """A coloured triangle mesh in metres."""

    #: (V, 3)
    vertices: NDArray[np.float32]
    #: (F, 3), counter-clockwise seen from outside
    faces: NDArray[np.int32]
    #: (V, 3) RGB
    colors: NDArray[np.uint8]
    #: (V,), False where a reconstructor continued or closed the surface
    is_seen: NDArray[np.bool_]

    def __post_init__(self) -> None:
        freeze(self, "vertices", np.float32, (None, 3))
        freeze(self, "faces", np.int32, (None, 3))
        freeze(self, "colors", np.uint8, (len(self.vertices), 3))
        freeze(self, "is_seen", np.bool_, (len(self.vertices),))


def face_areas_m2(mesh: Mesh) -> NDArray[np.float64]:
    """Return the (F,) areas of the faces."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]].astype(np.float64) for i in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def volume_m3(mesh: Mesh) -> float:
    """Return the signed enclosed volume: meaningful for a closed mesh, positive when its faces look outwards."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]].astype(np.float64) for i in range(3))
    return float((a * np.cross(b, c)).sum() / 6.0)


def is_closed(mesh: Mesh) -> bool:
    """Return whether every directed edge has its opposite exactly once."""
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]).astype(np.int64)
    n = len(mesh.vertices)
    forward, backward = np.sort(edges[:, 0] * n + edges[:, 1]), np.sort(edges[:, 1] * n + edges[:, 0])
    return len(edges) > 0 and bool(np.array_equal(forward, backward)) and bool((np.diff(forward) > 0).all())


def sample_surface(mesh: Mesh, count: int, rng: np.random.Generator) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Return (count, 3) points spread evenly by area, and the (count,) face that each lies on."""
    areas = face_areas_m2(mesh)
    chosen = rng.choice(len(areas), size=count, p=areas / areas.sum())
    u, v = rng.random((2, count))
    flip = u + v > 1
    u[flip], v[flip] = 1 - u[flip], 1 - v[flip]
    a, b, c = (mesh.vertices[mesh.faces[chosen, i]] for i in range(3))
    points = a + u[:, None] * (b - a) + v[:, None] * (c - a)
    return points.astype(np.float32), chosen


def write_glb(mesh: Mesh, path: Path) -> None:
    """Write a GLB with vertex colours and the `_SEEN` attribute; equal meshes give equal bytes."""
    path.write_bytes(glb_bytes(mesh))


def glb_bytes(mesh: Mesh) -> bytes:
    """Return what `write_glb` writes."""
    import trimesh

    shown = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    shown.visual = trimesh.visual.ColorVisuals(
        mesh=shown, vertex_colors=np.column_stack([mesh.colors, np.full(len(mesh.colors), 255, dtype=np.uint8)])
    )
    shown.vertex_attributes["_SEEN"] = mesh.is_seen.astype(np.float32)
    return shown.export(file_type="glb")


def mesh_of_glb(data: bytes) -> Mesh:
    """Return the mesh in the content of a GLB file; seen everywhere without `_SEEN`, grey without colours.

    Raises:
        ValueError: it is no GLB of one mesh of triangles, or its vertices are not finite.
    """
    arrays = glb_arrays(data)
    vertices, colors, seen = arrays["POSITION"], arrays.get("COLOR_0"), arrays.get("_SEEN")
    if vertices.dtype != np.float32 or vertices.ndim != 2 or not np.isfinite(vertices).all():
        raise ValueError("its vertices are no finite float32 numbers")
    if colors is not None and (colors.dtype != np.uint8 or colors.ndim != 2 or colors.shape[1] < 3):
        raise ValueError("its colours are no bytes")
    count = len(vertices)
    return Mesh(
        vertices=vertices,
        faces=arrays["indices"],
        colors=np.full((count, 3), 180, dtype=np.uint8) if colors is None else colors[:, :3],
        is_seen=np.ones(count, dtype=bool) if seen is None else np.asarray(seen).reshape(-1) > 0.5,
    )


def sha256_of(mesh: Mesh) -> str:
    """Return the hash of a mesh's arrays: what a map's digest is made of, independent of the file format."""
    digest = hashlib.sha256()
    for array in (mesh.vertices, mesh.faces, mesh.colors, mesh.is_seen):
        digest.update(str(array.shape).encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
