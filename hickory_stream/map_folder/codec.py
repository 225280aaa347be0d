"""A snapshot as one JSON document and binary files, and back, exactly.

A file's name has the hash of its content: a document refers to complete files only, and an existing file is never
written again. Small float32 arrays (features) are base64. Nothing read is trusted: names, numbers and sizes are
checked.
"""

from __future__ import annotations

import base64
import hashlib
import itertools
import math
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

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

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

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
        **_ints(snapshot, "revision", "stamp_ns"),
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
        graph=None if document.get("graph") is None else _decode_graph(document["graph"]),
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
    free, structure = (_file_of(entry[name], SPACE, "") for name in ("free", "structure"))

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
    return {
        "id": int(tracked.id),
        "phase": str(tracked.phase),
        **_ints(tracked, "submap_id", "sightings", "first_seen_ns", "last_seen_ns"),
        "points": points_name,
        "box": {
            "world_from_box": json_numbers(tracked.box.world_from_box),
            "half_extents_m": json_numbers(tracked.box.half_extents_m),
        },
        "feature": json_float32s(tracked.feature),
        "views": [_encode_view(view) for view in tracked.views],
        "best_view": None if tracked.best_view is None else names.index(tracked.best_view.name),
        "shape": None if tracked.shape is None else _encode_shape(tracked.shape),
        "merged_ids": [int(i) for i in tracked.merged_ids],
        "sketch": None if tracked.sketch is None else encode_superquadrics(tracked.sketch),
        "kind": str(tracked.kind),
        "fixture_probability": json_number(tracked.fixture_probability),
    }


def _decode_object(entry: Json, read: Callable[[str], bytes], *, is_whole: bool) -> TrackedObject:
    name = _file_of(entry["points"], POINTS, "")

    def arrays() -> Arrays:
        points_world, colors = points_arrays(read(name))
        return {"points_world": points_world, "colors": colors}

    if is_whole:
        return _object_with(entry, arrays())
    tracked = _object_with(entry, {"points_world": _NO_POINTS, "colors": _NO_COLORS})
    return _read_later(tracked, name, arrays, "points_world", "colors")


def _object_with(entry: Json, arrays: Arrays) -> TrackedObject:
    views = tuple(_decode_view(view) for view in entry["views"])
    return TrackedObject(
        id=entry["id"],
        phase=Phase(entry["phase"]),
        submap_id=whole_number(entry["submap_id"], "submap"),
        sightings=whole_number(entry["sightings"], "sightings"),
        first_seen_ns=stamp(entry["first_seen_ns"]),
        last_seen_ns=stamp(entry["last_seen_ns"]),
        points_world=arrays["points_world"],
        colors=arrays["colors"],
        box=OrientedBox(
            world_from_box=rigid_pose(entry["box"]["world_from_box"]),
            half_extents_m=finite_array(entry["box"]["half_extents_m"]),
        ),
        feature=float32s(entry["feature"]),
        views=views,
        best_view=None if entry["best_view"] is None else views[whole_number(entry["best_view"], "best view")],
        shape=None if entry["shape"] is None else _decode_shape(entry["shape"]),
        merged_ids=tuple(whole_number(i, "merged id") for i in entry["merged_ids"]),
        sketch=None if entry["sketch"] is None else decode_superquadrics(entry["sketch"]),
        # Maps of earlier versions have objects alone.
        kind=ObjectKind(entry.get("kind", ObjectKind.OBJECT)),
        fixture_probability=float(entry.get("fixture_probability", 0.0)),
    )


def _encode_view(view: View) -> Json:
    return {
        "name": view.name,
        **_ints(view, "object_id", "frame_index", "stamp_ns"),
        "box_px": [int(i) for i in view.box_px],
        "world_from_camera": json_numbers(view.world_from_camera),
        **_numbers(view, "r_area", "r_depth", "box_volume_m3", "score", "variance"),
        "feature": json_float32s(view.feature),
        "is_cut": bool(view.is_cut),
        "observation_index": int(view.observation_index),
    }


def _decode_view(entry: Json) -> View:
    x0, y0, x1, y1 = (whole_number(edge, "a pixel", -_MOST_PIXELS) for edge in entry["box_px"])
    return View(
        object_id=whole_number(entry["object_id"], "object"),
        frame_index=entry["frame_index"],
        stamp_ns=stamp(entry["stamp_ns"]),
        box_px=(x0, y0, x1, y1),
        world_from_camera=rigid_pose(entry["world_from_camera"]),
        r_area=float(entry["r_area"]),
        r_depth=float(entry["r_depth"]),
        box_volume_m3=float(entry["box_volume_m3"]),
        score=maybe_float(entry["score"]),
        variance=maybe_float(entry["variance"]),
        feature=float32s(entry["feature"]),
        is_cut=flag(entry["is_cut"]),
        observation_index=entry["observation_index"],
    )


def _encode_shape(shape: ObjectShape) -> Json:
    return {
        "revision": int(shape.revision),
        "reconstructor": shape.reconstructor,
        "mesh_name": shape.mesh_name,
        "mesh_sha256": shape.mesh_sha256,
        "world_from_object": json_numbers(shape.world_from_object),
        "fitted": encode_superquadrics(shape.fitted),
        "inflated": encode_superquadrics(shape.inflated),
        "seen_share": json_numbers(shape.seen_share),
        "containment": {
            **_ints(shape.containment, "num_checked", "num_outside"),
            "max_g": json_number(shape.containment.max_g),
            "is_certified": bool(shape.containment.is_certified),
            "is_fallback": bool(shape.containment.is_fallback),
            **_numbers(shape.containment, "margin_m", "shell_m"),
        },
        **({"verdict": shape.verdict} if shape.verdict else {}),
        **({"fit_kind": shape.fit_kind} if shape.fit_kind != "solid" else {}),
    }


def _decode_shape(entry: Json) -> ObjectShape:
    checked = entry["containment"]
    return ObjectShape(
        revision=whole_number(entry["revision"], "revision"),
        reconstructor=plain_text(entry["reconstructor"]),
        mesh_name=entry["mesh_name"],
        mesh_sha256=plain_text(entry["mesh_sha256"]),
        world_from_object=rigid_pose(entry["world_from_object"]),
        fitted=_superquadrics(entry["fitted"]),
        inflated=_superquadrics(entry["inflated"]),
        seen_share=finite_array(entry["seen_share"]),
        containment=Containment(
            num_checked=whole_number(checked["num_checked"], "a number of pieces"),
            num_outside=whole_number(checked["num_outside"], "a number of pieces"),
            max_g=float(checked["max_g"]),
            is_certified=flag(checked["is_certified"]),
            is_fallback=flag(checked["is_fallback"]),
            margin_m=float(checked["margin_m"]),
            shell_m=float(checked["shell_m"]),
        ),
        verdict=plain_text(entry.get("verdict", "")),
        fit_kind=entry.get("fit_kind", "solid"),
    )


def encode_graph(graph: PoseGraphRecord) -> Json:
    """Return a pose graph for the document."""
    return {
        "nodes": [
            {
                **_ints(node, "submap_id", "stamp_ns"),
                "place": json_numbers(node.place),
                "uncorrected": json_numbers(node.uncorrected),
                **_numbers(node, "sigma_m", "sigma_rad"),
                "covariance_xy": json_numbers(node.covariance_xy),
            }
            for node in graph.nodes
        ],
        "edges": [
            {
                "kind": edge.kind,
                **_ints(edge, "earlier", "later"),
                "status": edge.status,
                "score": json_number(edge.score),
                "reason": edge.reason,
                **_numbers(edge, "residual_m", "residual_rad"),
                "stamp_ns": int(edge.stamp_ns),
            }
            for edge in graph.edges
        ],
    }


def _decode_graph(entry: Json) -> PoseGraphRecord:
    return PoseGraphRecord(
        nodes=tuple(
            GraphNode(
                submap_id=whole_number(node["submap_id"], "submap"),
                stamp_ns=stamp(node["stamp_ns"]),
                place=rigid_pose(node["place"]),
                uncorrected=rigid_pose(node["uncorrected"]),
                sigma_m=finite(node["sigma_m"]),
                sigma_rad=finite(node["sigma_rad"]),
                covariance_xy=finite_array(node["covariance_xy"]),
            )
            for node in entry["nodes"]
        ),
        edges=tuple(
            GraphEdge(
                kind=_one_of(edge["kind"], EDGE_KINDS),
                earlier=whole_number(edge["earlier"], "submap"),
                later=whole_number(edge["later"], "submap"),
                status=_one_of(edge["status"], EDGE_STATUSES),
                score=maybe_float(edge["score"]),
                reason=plain_text(edge["reason"]),
                residual_m=finite(edge["residual_m"]),
                residual_rad=finite(edge["residual_rad"]),
                stamp_ns=stamp(edge["stamp_ns"]),
            )
            for edge in entry["edges"]
        ),
    )


def _ints(record: object, *names: str) -> Json:
    return {name: int(getattr(record, name)) for name in names}


def _numbers(record: object, *names: str) -> Json:
    return {name: json_number(getattr(record, name)) for name in names}


def _one_of(word: Any, known: tuple[T, ...]) -> T:
    for choice in known:
        if choice == word:
            return choice
    raise ValueError(f"{word!r} is none of {', '.join(map(str, known))}")


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


def _read_later(record: R, name: str, arrays: Callable[[], Arrays], *fields: str) -> R:
    def read() -> Arrays:
        try:
            return arrays()
        except ValueError as error:
            raise MapFolderError(f"{name} is damaged: {error}; play the log again") from error

    read_later(record, read, *fields)
    return record


def _file_of(name: Any, folder: str, suffix: str) -> str:
    inside = name.removeprefix(f"{folder}/") if isinstance(name, str) else name
    return f"{folder}/{plain_name(inside, suffix)}"


def _add_file(files: dict[str, bytes], stem: str, suffix: str, data: bytes) -> str:
    name = f"{stem}-{_short_hash(data)}{suffix}"
    files[name] = data
    return name


def _short_hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]
