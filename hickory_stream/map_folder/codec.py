"""A snapshot as one JSON document and binary files, and back, exactly.

A file's name has the hash of its content: a document refers to complete files only, and an existing file is never
written again. Small float32 arrays (features) are base64. Nothing read is trusted: names, numbers and sizes are
checked.
"""

import base64
import hashlib
import itertools
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.confined import plain_name, whole_number
from hickory_stream.errors import MapFolderError
from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.geometry.lazy_arrays import GivesUpArrays, read_later
from hickory_stream.geometry.rigid import is_rigid
from hickory_stream.geometry.superquadric import Superquadrics, check_bodies
from hickory_stream.map_folder.array_files import keys_array, keys_bytes, points_arrays, points_bytes
from hickory_stream.records import (
    EDGE_KINDS,
    EDGE_STATUSES,
    Containment,
    GraphEdge,
    GraphNode,
    MapSnapshot,
    ObjectKind,
    ObjectShape,
    ObservedSpace,
    Phase,
    PoseGraphRecord,
    Submap,
    TrackedObject,
    View,
)

Arrays = Mapping[str, NDArray[Any]]


def json_number(value: float | None) -> float | str | None:
    """Return a float for JSON; infinity becomes a string."""
    return None if value is None else float(value) if math.isfinite(value) else str(float(value))


def maybe_float(value: float | str | None) -> float | None:
    """Return the number of `json_number`."""
    return None if value is None else float(value)


def json_numbers(array: NDArray[np.float64]) -> Any:
    """Return a small array as nested lists; Python writes the shortest text of the same double."""
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
    """Return a number; text, which `float` would accept, raises `ValueError`."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"found {value!r}, expected a finite number")
    return float(value)


def rigid_pose(values: Any) -> NDArray[np.float64]:
    """Return a rigid (4, 4) transform; raises `ValueError`."""
    pose = to_array(values)
    if not is_rigid(pose):
        raise ValueError(f"found {values}, which is no rigid (4, 4) transform")
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


T = TypeVar("T", bound=str)
R = TypeVar("R", bound=GivesUpArrays)

POINTS, SPACE = "points", "space"
Json = dict[str, Any]

_MOST_PIXELS = 1 << 20
_NO_KEYS = np.empty(0, np.int64)
_NO_POINTS, _NO_COLORS = np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8)


def encode_snapshot(snapshot: MapSnapshot) -> tuple[Json, dict[str, bytes]]:
    """Return the document of a snapshot, and the contents of its files by their path in the map folder."""
    files: dict[str, bytes] = {}
    document = {
        "revision": int(snapshot.revision),
        "stamp_ns": int(snapshot.stamp_ns),
        "submaps": [encode_submap(submap, encode_space(submap, files)) for submap in snapshot.submaps],
        "objects": [encode_object(tracked, encode_points(tracked, files)) for tracked in snapshot.objects],
    }
    if snapshot.graph is not None:
        document["graph"] = encode_graph(snapshot.graph)
    return document, files


def decode_snapshot(document: Json, read: Callable[[str], bytes], *, is_whole: bool = True) -> MapSnapshot:
    """Return the snapshot of a document; `read` returns the content of a file by its path in the map folder.

    Unless `is_whole`, points and voxels are read on first use, which raises `MapFolderError` for a damaged file.

    Raises KeyError, TypeError, ValueError, IndexError, AttributeError or OverflowError: the document or a file is
    damaged.
    """
    snapshot = MapSnapshot(
        revision=whole_number(document["revision"], "revision"),
        stamp_ns=stamp(document["stamp_ns"]),
        submaps=tuple(_decode_submap(entry, read, is_whole=is_whole) for entry in document["submaps"]),
        objects=tuple(_decode_object(entry, read, is_whole=is_whole) for entry in document["objects"]),
        # Maps without a search for loops have none.
        graph=None if document.get("graph") is None else _GRAPH.read(document["graph"]),
    )
    _check_ids("submap", [submap.id for submap in snapshot.submaps])
    _check_ids("object", [tracked.id for tracked in snapshot.objects])
    return snapshot


def has_named_content(name: str, data: bytes) -> bool:
    """Return whether a file's content has the hash in its name."""
    return name.rpartition(".")[0].endswith(f"-{_short_hash(data)}")


def _check_ids(what: str, ids: list[int]) -> None:
    # Ascending, without duplicates.
    if any(a >= b for a, b in itertools.pairwise(ids)):
        raise ValueError(f"the ids of {what}s are not in ascending order: {ids[:10]}")


def encode_space(submap: Submap, files: dict[str, bytes]) -> tuple[str, ...]:
    """Return the names of the files of a submap's free and structure voxels, and add their contents."""
    return tuple(
        _add_file(files, f"{SPACE}/{submap.id:04d}-{name}", ".keys", keys_bytes(keys))
        for name, keys in (("free", submap.observed_space.free), ("structure", submap.observed_space.structure))
    )


def encode_submap(submap: Submap, space_names: tuple[str, ...]) -> Json:
    """Return a submap for the document; `space_names` are of `encode_space`."""
    space = submap.observed_space
    free, structure = space_names
    return {
        "id": int(submap.id),
        "world_from_submap": json_numbers(submap.world_from_submap),
        "voxel_m": float(space.voxel_m),
        "floor_z_m": json_number(space.floor_z_m),
        "free": free,
        "structure": structure,
    }


def _decode_submap(entry: Json, read: Callable[[str], bytes], *, is_whole: bool) -> Submap:
    free, structure = (_file_of(entry[name], SPACE) for name in ("free", "structure"))

    def arrays() -> Arrays:
        return {"free": keys_array(read(free)), "structure": keys_array(read(structure))}

    now = arrays() if is_whole else {"free": _NO_KEYS, "structure": _NO_KEYS}
    space = ObservedSpace(
        voxel_m=finite(entry["voxel_m"]),
        free=now["free"],
        structure=now["structure"],
        floor_z_m=None if entry["floor_z_m"] is None else finite(entry["floor_z_m"]),
    )
    if not is_whole:
        _read_later(space, f"{free} or {structure}", arrays, "free", "structure")
    if not space.voxel_m > 0:
        raise ValueError(f"voxels of {space.voxel_m} m")
    return Submap(id=entry["id"], world_from_submap=rigid_pose(entry["world_from_submap"]), observed_space=space)


def encode_points(tracked: TrackedObject, files: dict[str, bytes]) -> str:
    """Return the name of the file of an object's points, and add its content."""
    data = points_bytes(tracked.points_world, tracked.colors)
    return _add_file(files, f"{POINTS}/{tracked.id:06d}", ".points", data)


def encode_object(tracked: TrackedObject, points_name: str) -> Json:
    """Return an object for the document; `points_name` is of `encode_points`."""
    names = [view.name for view in tracked.views]
    best = None if tracked.best_view is None else names.index(tracked.best_view.name)
    return _OBJECT.write(tracked) | {"points": points_name, "best_view": best}


def _decode_object(entry: Json, read: Callable[[str], bytes], *, is_whole: bool) -> TrackedObject:
    name = _file_of(entry["points"], POINTS)

    def arrays() -> Arrays:
        points_world, colors = points_arrays(read(name))
        return {"points_world": points_world, "colors": colors}

    if is_whole:
        return _object_with(entry, arrays())
    tracked = _object_with(entry, {"points_world": _NO_POINTS, "colors": _NO_COLORS})
    return _read_later(tracked, name, arrays, "points_world", "colors")


def _object_with(entry: Json, arrays: Arrays) -> TrackedObject:
    views = _VIEWS.read(entry["views"])
    best_view = None if entry["best_view"] is None else views[whole_number(entry["best_view"], "best view")]
    tracked: TrackedObject = _OBJECT.read(_AS_BEFORE_KINDS | entry, views=views, best_view=best_view, **arrays)
    return tracked


def encode_graph(graph: PoseGraphRecord) -> Json:
    """Return a pose graph for the document."""
    encoded: Json = _GRAPH.write(graph)
    return encoded


def _one_of(known: tuple[T, ...]) -> Callable[[Any], T]:
    def choice(word: Any) -> T:
        if word not in known:
            raise ValueError(f"{word!r} is none of {', '.join(map(str, known))}")
        return known[known.index(word)]

    return choice


def encode_superquadrics(primitives: Superquadrics) -> Json:
    """Return superquadrics for JSON, exactly."""
    names = ("exponents", "semi_axes_m", "world_from_local")
    return {name: json_numbers(getattr(primitives, name)) for name in names}


def decode_superquadrics(entry: Json) -> Superquadrics:
    """Return the superquadrics. Raises KeyError, TypeError or ValueError: damaged."""
    bodies = _superquadrics(entry)
    check_bodies(bodies)
    return bodies


def _superquadrics(entry: Json) -> Superquadrics:
    count = len(entry["exponents"])
    return Superquadrics(
        exponents=to_array(entry["exponents"]).reshape(count, 2),
        semi_axes_m=to_array(entry["semi_axes_m"]).reshape(count, 3),
        world_from_local=to_array(entry["world_from_local"]).reshape(count, 4, 4),
    )


class Form(NamedTuple):
    """How a value is written to the document, and read from it."""

    write: Callable[[Any], Any]
    read: Callable[..., Any]


def record_form(kind: Callable[..., Any], forms: Mapping[str, Form | None]) -> Form:
    """Return the form of a record by its fields in their order; None for one that the caller writes and reads."""
    known = {name: form for name, form in forms.items() if form is not None}

    def write(record: object) -> Json:
        return {name: form and form.write(getattr(record, name)) for name, form in forms.items()}

    def read(entry: Json, **others: Any) -> Any:
        found = {name: form.read(entry[name]) for name, form in known.items() if name not in others}
        return kind(**found, **others)

    return Form(write, read)


def list_form(form: Form) -> Form:
    """Return the form of a tuple of values of one form."""
    return Form(lambda values: [form.write(value) for value in values], lambda entries: tuple(map(form.read, entries)))


def _perhaps(form: Form) -> Form:
    return Form(*(lambda value, turn=turn: None if value is None else turn(value) for turn in form))


def _view(name: str, box_px: tuple[int, ...], **fields: Any) -> View:
    x0, y0, x1, y1 = box_px
    return View(box_px=(x0, y0, x1, y1), **fields)


def _written_shape(shape: ObjectShape) -> Json:
    return {name: value for name, value in _WHOLE_SHAPE.write(shape).items() if _USUAL.get(name) != value}


INT = Form(int, lambda value: whole_number(value, "number"))
_PIXEL = Form(int, lambda value: whole_number(value, "pixel", -_MOST_PIXELS))
STAMP, _FLAG, TEXT = Form(int, stamp), Form(bool, flag), Form(str, plain_text)
NUMBER, _FINITE, _MAYBE = Form(json_number, float), Form(json_number, finite), Form(json_number, maybe_float)
POSE, _ARRAY = Form(json_numbers, rigid_pose), Form(json_numbers, finite_array)
_FEATURE = Form(json_float32s, float32s)
_BOX: dict[str, Form | None] = {"world_from_box": POSE, "half_extents_m": _ARRAY}
_BODIES, _SKETCH = Form(encode_superquadrics, _superquadrics), Form(encode_superquadrics, decode_superquadrics)
_VIEWS = list_form(record_form(_view, {
    "name": TEXT, "object_id": INT, "frame_index": INT, "stamp_ns": STAMP, "box_px": list_form(_PIXEL),
    "world_from_camera": POSE, "r_area": NUMBER, "r_depth": NUMBER, "box_volume_m3": NUMBER, "score": _MAYBE,
    "variance": _MAYBE, "feature": _FEATURE, "is_cut": _FLAG, "observation_index": INT,
}))  # fmt: skip
_CONTAINMENT = record_form(Containment, {
    "num_checked": INT, "num_outside": INT, "max_g": NUMBER, "is_certified": _FLAG, "is_fallback": _FLAG,
    "margin_m": NUMBER, "shell_m": NUMBER,
})  # fmt: skip
_WHOLE_SHAPE = record_form(ObjectShape, {
    "revision": INT, "reconstructor": TEXT, "mesh_name": TEXT, "mesh_sha256": TEXT, "world_from_object": POSE,
    "fitted": _BODIES, "inflated": _BODIES, "seen_share": _ARRAY, "containment": _CONTAINMENT, "verdict": TEXT,
    "fit_kind": TEXT,
})  # fmt: skip
# Left out of the document.
_USUAL = {"verdict": "", "fit_kind": "solid"}
_SHAPE = Form(_written_shape, lambda entry: _WHOLE_SHAPE.read(_USUAL | entry))
_OBJECT = record_form(TrackedObject, {
    "id": INT, "phase": Form(str, Phase), "submap_id": INT, "sightings": INT, "first_seen_ns": STAMP,
    "last_seen_ns": STAMP, "points": None, "box": record_form(OrientedBox, _BOX), "feature": _FEATURE, "views": _VIEWS,
    "best_view": None, "shape": _perhaps(_SHAPE), "merged_ids": list_form(INT), "sketch": _perhaps(_SKETCH),
    "kind": Form(str, ObjectKind), "fixture_probability": NUMBER,
})  # fmt: skip
# Maps of earlier versions have objects alone.
_AS_BEFORE_KINDS = {"kind": ObjectKind.OBJECT, "fixture_probability": 0.0}
_NODE = record_form(GraphNode, {
    "submap_id": INT, "stamp_ns": STAMP, "place": POSE, "uncorrected": POSE, "sigma_m": _FINITE,
    "sigma_rad": _FINITE, "covariance_xy": _ARRAY,
})  # fmt: skip
_EDGE = record_form(GraphEdge, {
    "kind": Form(str, _one_of(EDGE_KINDS)), "earlier": INT, "later": INT,
    "status": Form(str, _one_of(EDGE_STATUSES)), "score": _MAYBE, "reason": TEXT, "residual_m": _FINITE,
    "residual_rad": _FINITE, "stamp_ns": STAMP,
})  # fmt: skip
_GRAPH = record_form(PoseGraphRecord, {"nodes": list_form(_NODE), "edges": list_form(_EDGE)})


def _read_later(record: R, name: str, arrays: Callable[[], Arrays], *fields: str) -> R:
    def read() -> Arrays:
        try:
            return arrays()
        except ValueError as error:
            raise MapFolderError(f"{name} is damaged: {error}; play the log again") from error

    read_later(record, read, *fields)
    return record


def _file_of(name: Any, folder: str) -> str:
    inside = name.removeprefix(f"{folder}/") if isinstance(name, str) else name
    return f"{folder}/{plain_name(inside, '')}"


def _add_file(files: dict[str, bytes], stem: str, suffix: str, data: bytes) -> str:
    name = f"{stem}-{_short_hash(data)}{suffix}"
    files[name] = data
    return name


def _short_hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]
