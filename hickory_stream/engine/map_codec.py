"""A snapshot as one JSON document and the binary files that it names, and back, exactly.

The name of a binary file carries the hash of its content: a document can only refer to files that are complete, and a
file that exists never needs to be written again. Float32 arrays without a file of their own (features) are base64.

What is read may come from anybody: every name is checked before it is opened, every number before it is used.
"""

from __future__ import annotations

import base64
import hashlib
import io
import itertools
import math
import re
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.confined import plain_name, whole_number
from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.geometry.rigid import is_rigid
from hickory_stream.geometry.superquadric import Superquadrics, check_bodies
from hickory_stream.records import (
    Containment,
    MapSnapshot,
    ObjectShape,
    ObservedSpace,
    Phase,
    Submap,
    TrackedObject,
    View,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

POINTS, SPACE = "points", "space"
Json = dict[str, Any]

_MOST_PIXELS = 1 << 20
_NPY_HEADER = re.compile(
    rb"\x93NUMPY\x01\x00..\{'descr': '(?P<descr>[<|][a-z]\d)', 'fortran_order': False, "
    rb"'shape': \((?P<shape>\d{1,15},(?: \d{1,15})?)\), \} *\n",
    re.DOTALL,
)
_PLY_VERTEX = np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3)])
_PLY_HEADER = (
    "ply\nformat binary_little_endian 1.0\nelement vertex {count}\n"
    "property float x\nproperty float y\nproperty float z\n"
    "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
)


def encode_snapshot(snapshot: MapSnapshot) -> tuple[Json, dict[str, bytes]]:
    """Return the document of a snapshot, and the content of every file that it names by its path in the map folder."""
    files: dict[str, bytes] = {}
    document = {
        "revision": int(snapshot.revision),
        "stamp_ns": int(snapshot.stamp_ns),
        "submaps": [_encode_submap(submap, files) for submap in snapshot.submaps],
        "objects": [_encode_object(tracked, files) for tracked in snapshot.objects],
    }
    return document, files


def decode_snapshot(document: Json, read: Callable[[str], bytes]) -> MapSnapshot:
    """Return the snapshot of a document; `read` gives the content of a file by its path in the map folder.

    Raises:
        KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError: the document or a file is damaged.
    """
    snapshot = MapSnapshot(
        revision=whole_number(document["revision"], "revision"),
        stamp_ns=_stamp(document["stamp_ns"]),
        submaps=tuple(_decode_submap(entry, read) for entry in document["submaps"]),
        objects=tuple(_decode_object(entry, read) for entry in document["objects"]),
    )
    _check_ids("submap", [submap.id for submap in snapshot.submaps])
    _check_ids("object", [tracked.id for tracked in snapshot.objects])
    return snapshot


def has_named_content(name: str, data: bytes) -> bool:
    """Return whether a file's content is the one that its name promises."""
    return name.rpartition(".")[0].endswith(f"-{_short_hash(data)}")


def _check_ids(what: str, ids: list[int]) -> None:
    """Refuse ids that are not in ascending order, or come up twice."""
    if any(a >= b for a, b in itertools.pairwise(ids)):
        raise ValueError(f"the ids of {what}s are not in ascending order: {ids[:10]}")


# ---- the records ----------------------------------------------------------------------------------------------------


def _encode_submap(submap: Submap, files: dict[str, bytes]) -> Json:
    space = submap.observed_space
    return {
        "id": int(submap.id),
        "world_from_submap": _numbers(submap.world_from_submap),
        "voxel_m": float(space.voxel_m),
        "floor_z_m": _number(space.floor_z_m),
        "free": _add_file(files, f"{SPACE}/{submap.id:04d}-free", ".npy", npy_bytes(space.free)),
        "structure": _add_file(files, f"{SPACE}/{submap.id:04d}-structure", ".npy", npy_bytes(space.structure)),
    }


def _decode_submap(entry: Json, read: Callable[[str], bytes]) -> Submap:
    space = ObservedSpace(
        voxel_m=_finite(entry["voxel_m"]),
        free=npy_array(read(_file_of(entry["free"], SPACE, ".npy"))),
        structure=npy_array(read(_file_of(entry["structure"], SPACE, ".npy"))),
        floor_z_m=None if entry["floor_z_m"] is None else _finite(entry["floor_z_m"]),
    )
    if not space.voxel_m > 0:
        raise ValueError(f"voxels of {space.voxel_m} m")
    return Submap(id=entry["id"], world_from_submap=_pose(entry["world_from_submap"]), observed_space=space)


def _encode_object(tracked: TrackedObject, files: dict[str, bytes]) -> Json:
    names = [view.name for view in tracked.views]
    return {
        "id": int(tracked.id),
        "phase": str(tracked.phase),
        "submap_id": int(tracked.submap_id),
        "sightings": int(tracked.sightings),
        "first_seen_ns": int(tracked.first_seen_ns),
        "last_seen_ns": int(tracked.last_seen_ns),
        "points": _add_file(
            files, f"{POINTS}/{tracked.id:06d}", ".ply", ply_bytes(tracked.points_world, tracked.colors)
        ),
        "box": {
            "world_from_box": _numbers(tracked.box.world_from_box),
            "half_extents_m": _numbers(tracked.box.half_extents_m),
        },
        "feature": _text(tracked.feature),
        "views": [_encode_view(view) for view in tracked.views],
        "best_view": None if tracked.best_view is None else names.index(tracked.best_view.name),
        "shape": None if tracked.shape is None else _encode_shape(tracked.shape),
        "merged_ids": [int(i) for i in tracked.merged_ids],
        "sketch": None if tracked.sketch is None else encode_superquadrics(tracked.sketch),
    }


def _decode_object(entry: Json, read: Callable[[str], bytes]) -> TrackedObject:
    points_world, colors = ply_arrays(read(_file_of(entry["points"], POINTS, ".ply")))
    views = tuple(_decode_view(view) for view in entry["views"])
    return TrackedObject(
        id=entry["id"],
        phase=Phase(entry["phase"]),
        submap_id=whole_number(entry["submap_id"], "submap"),
        sightings=whole_number(entry["sightings"], "sightings"),
        first_seen_ns=_stamp(entry["first_seen_ns"]),
        last_seen_ns=_stamp(entry["last_seen_ns"]),
        points_world=points_world,
        colors=colors,
        box=OrientedBox(
            world_from_box=_pose(entry["box"]["world_from_box"]),
            half_extents_m=_finite_array(entry["box"]["half_extents_m"]),
        ),
        feature=_float32s(entry["feature"]),
        views=views,
        best_view=None if entry["best_view"] is None else views[whole_number(entry["best_view"], "best view")],
        shape=None if entry["shape"] is None else _decode_shape(entry["shape"]),
        merged_ids=tuple(whole_number(i, "merged id") for i in entry["merged_ids"]),
        # Maps from before sketches have none.
        sketch=None if entry.get("sketch") is None else decode_superquadrics(entry["sketch"]),
    )


def _encode_view(view: View) -> Json:
    return {
        "name": view.name,
        "object_id": int(view.object_id),
        "frame_index": int(view.frame_index),
        "stamp_ns": int(view.stamp_ns),
        "box_px": [int(i) for i in view.box_px],
        "world_from_camera": _numbers(view.world_from_camera),
        "r_area": _number(view.r_area),
        "r_depth": _number(view.r_depth),
        "box_volume_m3": _number(view.box_volume_m3),
        "score": _number(view.score),
        "variance": _number(view.variance),
        "feature": _text(view.feature),
        "is_cut": bool(view.is_cut),
        "observation_index": int(view.observation_index),
    }


def _decode_view(entry: Json) -> View:
    x0, y0, x1, y1 = (whole_number(edge, "a pixel", -_MOST_PIXELS) for edge in entry["box_px"])
    return View(
        object_id=whole_number(entry["object_id"], "object"),
        frame_index=entry["frame_index"],
        stamp_ns=_stamp(entry["stamp_ns"]),
        box_px=(x0, y0, x1, y1),
        world_from_camera=_pose(entry["world_from_camera"]),
        r_area=float(entry["r_area"]),
        r_depth=float(entry["r_depth"]),
        box_volume_m3=float(entry["box_volume_m3"]),
        score=_maybe_float(entry["score"]),
        variance=_maybe_float(entry["variance"]),
        feature=_float32s(entry["feature"]),
        is_cut=_flag(entry["is_cut"]),
        observation_index=entry["observation_index"],
    )


def _encode_shape(shape: ObjectShape) -> Json:
    return {
        "revision": int(shape.revision),
        "reconstructor": shape.reconstructor,
        "mesh_name": shape.mesh_name,
        "mesh_sha256": shape.mesh_sha256,
        "world_from_object": _numbers(shape.world_from_object),
        "fitted": encode_superquadrics(shape.fitted),
        "inflated": encode_superquadrics(shape.inflated),
        "seen_share": _numbers(shape.seen_share),
        "containment": {
            "num_checked": int(shape.containment.num_checked),
            "num_outside": int(shape.containment.num_outside),
            "max_g": _number(shape.containment.max_g),
            "is_certified": bool(shape.containment.is_certified),
            "is_fallback": bool(shape.containment.is_fallback),
            "margin_m": _number(shape.containment.margin_m),
            "shell_m": _number(shape.containment.shell_m),
        },
    }


def _decode_shape(entry: Json) -> ObjectShape:
    checked = entry["containment"]
    return ObjectShape(
        revision=whole_number(entry["revision"], "revision"),
        reconstructor=_text_of(entry["reconstructor"]),
        mesh_name=entry["mesh_name"],
        mesh_sha256=_text_of(entry["mesh_sha256"]),
        world_from_object=_pose(entry["world_from_object"]),
        fitted=decode_superquadrics(entry["fitted"]),
        inflated=decode_superquadrics(entry["inflated"]),
        seen_share=_finite_array(entry["seen_share"]),
        containment=Containment(
            num_checked=whole_number(checked["num_checked"], "a number of pieces"),
            num_outside=whole_number(checked["num_outside"], "a number of pieces"),
            max_g=float(checked["max_g"]),
            # Maps from before the certificate were checked by sampling only.
            is_certified=_flag(checked.get("is_certified", False)),
            is_fallback=_flag(checked.get("is_fallback", False)),
            margin_m=float(checked.get("margin_m", 0.0)),
            shell_m=float(checked.get("shell_m", 0.0)),
        ),
    )


def encode_superquadrics(primitives: Superquadrics) -> Json:
    """Return superquadrics as JSON has them, exactly."""
    return {
        "exponents": _numbers(primitives.exponents),
        "semi_axes_m": _numbers(primitives.semi_axes_m),
        "world_from_local": _numbers(primitives.world_from_local),
    }


def decode_superquadrics(entry: Json) -> Superquadrics:
    """Return what `encode_superquadrics` wrote.

    Raises:
        KeyError, TypeError, ValueError: it is damaged.
    """
    count = len(entry["exponents"])
    bodies = Superquadrics(
        exponents=_array(entry["exponents"]).reshape(count, 2),
        semi_axes_m=_array(entry["semi_axes_m"]).reshape(count, 3),
        world_from_local=_array(entry["world_from_local"]).reshape(count, 4, 4),
    )
    check_bodies(bodies)
    return bodies


# ---- numbers and arrays ---------------------------------------------------------------------------------------------


def _number(value: float | None) -> float | str | None:
    """Return a float as JSON has it; JSON knows no infinity, so that becomes a string that `float` reads."""
    return None if value is None else float(value) if math.isfinite(value) else str(float(value))


def _maybe_float(value: float | str | None) -> float | None:
    return None if value is None else float(value)


def _numbers(array: NDArray[np.float64]) -> Any:
    """Return a small array as nested lists; Python writes the shortest text that reads back as the same double."""
    values = array.tolist()
    return values if np.isfinite(array).all() else np.vectorize(_number, otypes=[object])(array).tolist()


def _array(values: Any) -> NDArray[np.float64]:
    return np.asarray(values, dtype=np.float64)


def _finite_array(values: Any) -> NDArray[np.float64]:
    array = _array(values)
    if not np.isfinite(array).all():
        raise ValueError(f"found {values}, expected finite numbers")
    return array


def _finite(value: Any) -> float:
    """Return a number of the map; a text, which `float` takes as well, is none here."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"found {value!r}, expected a finite number")
    return float(value)


def _pose(values: Any) -> NDArray[np.float64]:
    pose = _array(values)
    if not is_rigid(pose):
        raise ValueError(f"found {values}, expected a rigid (4, 4) transform")
    return pose


def _flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"found {value!r}, expected true or false")
    return value


def _text_of(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"found {value!r}, expected a text")
    return value


def _stamp(value: Any) -> int:
    """Return a stamp, ns: an integer beyond what others are."""
    if isinstance(value, bool) or not isinstance(value, int) or abs(value) >= 2**63:
        raise ValueError(f"found the stamp {str(value)[:40]!r}, expected nanoseconds")
    return value


def _text(array: NDArray[np.float32] | None) -> str | None:
    return None if array is None else base64.b64encode(array.astype("<f4").tobytes()).decode()


def _float32s(text: str | None) -> NDArray[np.float32] | None:
    return None if text is None else np.frombuffer(base64.b64decode(text, validate=True), "<f4").astype(np.float32)


# ---- files ----------------------------------------------------------------------------------------------------------


def _file_of(name: Any, folder: str, suffix: str) -> str:
    """Return the path of a file that the document names, which lies in `folder`; raises OutsideError."""
    inside = name.removeprefix(f"{folder}/") if isinstance(name, str) else name
    return f"{folder}/{plain_name(inside, suffix)}"


def _add_file(files: dict[str, bytes], stem: str, suffix: str, data: bytes) -> str:
    """Note a file under a name that carries its content's hash; return the name."""
    name = f"{stem}-{_short_hash(data)}{suffix}"
    files[name] = data
    return name


def _short_hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


def ply_bytes(points: NDArray[np.float32], colors: NDArray[np.uint8]) -> bytes:
    """Return a binary little-endian PLY of (N, 3) points with (N, 3) colours."""
    vertices = np.empty(len(points), dtype=_PLY_VERTEX)
    vertices["xyz"], vertices["rgb"] = points, colors
    return _PLY_HEADER.format(count=len(points)).encode() + vertices.tobytes()


def ply_arrays(data: bytes) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Return the points (N, 3) and colours (N, 3) of a PLY that `ply_bytes` wrote.

    Raises:
        ValueError: it is another kind of PLY, or shorter than it says.
    """
    header, end, body = data.partition(b"end_header\n")
    count = len(body) // _PLY_VERTEX.itemsize
    if header + end != _PLY_HEADER.format(count=count).encode() or len(body) != count * _PLY_VERTEX.itemsize:
        raise ValueError("not a point file of this map format")
    vertices = np.frombuffer(body, dtype=_PLY_VERTEX)
    if not np.isfinite(vertices["xyz"]).all():
        raise ValueError("a point that is not finite")
    return vertices["xyz"].astype(np.float32), vertices["rgb"].astype(np.uint8)


def npy_bytes(keys: NDArray[np.int64]) -> bytes:
    """Return a .npy file of (N,) keys."""
    buffer = io.BytesIO()
    np.save(buffer, keys.astype("<i8"), allow_pickle=False)
    return buffer.getvalue()


def npy_array(data: bytes, descr: str = "<i8") -> NDArray[Any]:
    """Return the (N,) or (N, n) array of a .npy file, by default the (N,) keys of voxels.

    What the header claims must be there: `numpy.load` would take the memory first.

    Raises:
        ValueError: it is no such file, of numbers of another kind, or shorter or longer than it says.
    """
    header = _NPY_HEADER.match(data)
    if header is None or header["descr"].decode() != descr:
        raise ValueError(f"not an array of {descr} as `numpy.save` writes it")
    shape = [int(length) for length in header["shape"].split(b",") if length.strip()]
    dtype = np.dtype(descr)
    if not 1 <= len(shape) <= 2 or math.prod(shape) * dtype.itemsize != len(data) - header.end():
        raise ValueError(f"an array of shape {shape} in {len(data) - header.end()} bytes")
    array = np.frombuffer(data, dtype, offset=header.end()).reshape(shape)
    return array.astype(dtype.newbyteorder("="))
