"""The digest of a map: one number that compares two runs.

It covers, by object: id, phase, submap, sightings, first and last stamp, points and colours, box, feature, all views
(stamps, box, pose, factors, score, variance, feature, is_cut), the best view, merged ids; of the shape: reconstructor,
hash and pose of the mesh, fitted and inflated superquadrics, seen shares, containment, or else the sketch; and nodes
and edges of a pose graph. It leaves out timings, ledger, configuration, revision and stamp of the snapshot, tickets,
file names, and observed space.
"""

import dataclasses
import hashlib
import struct
from typing import Any

import numpy as np

from hickory_stream.geometry.superquadric import Superquadrics
from hickory_stream.records import MapSnapshot, ObjectShape, PoseGraphRecord, TrackedObject


def map_digest(snapshot: MapSnapshot) -> str:
    """Return the sha256 (hex) of a map's objects, superquadrics and meshes, to the last bit of floats."""
    digest = hashlib.sha256()
    for tracked in sorted(snapshot.objects, key=lambda tracked: tracked.id):
        _feed(digest, _object_values(tracked))
    # A map without a graph keeps the digest that it had before there were graphs.
    if snapshot.graph is not None:
        _feed(digest, _graph_values(snapshot.graph))
    return digest.hexdigest()


def seal_of(digest: str, document: bytes) -> str:
    """Return the tie between a digest and a map's document, which names all other files by content.

    It proves, without those files, that the document belongs to the map with this digest.
    """
    return hashlib.sha256(digest.encode() + b"\n" + hashlib.sha256(document).digest()).hexdigest()


# The order of names is part of the digest.
_OBJECT = ("submap_id", "sightings", "first_seen_ns", "last_seen_ns", "points_world", "colors")
_VIEW = (
    *("object_id", "frame_index", "stamp_ns", "box_px", "world_from_camera", "r_area", "r_depth"),
    *("box_volume_m3", "score", "variance", "feature", "is_cut", "observation_index"),
)
_NODE = ("submap_id", "stamp_ns", "place", "uncorrected", "sigma_m", "sigma_rad", "covariance_xy")


def _values(record: object, names: tuple[str, ...]) -> tuple[Any, ...]:
    return tuple(getattr(record, name) for name in names)


def _object_values(tracked: TrackedObject) -> tuple[Any, ...]:
    return (
        tracked.id,
        str(tracked.phase),
        *_values(tracked, _OBJECT),
        tracked.box.world_from_box,
        tracked.box.half_extents_m,
        tracked.feature,
        tuple(_values(view, _VIEW) for view in tracked.views),
        tracked.best_view.name if tracked.best_view else None,
        _shape_values(tracked.shape) if tracked.shape else None,
        tracked.merged_ids,
        *((_primitive_values(tracked.sketch),) if tracked.sketch is not None else ()),
        # Maps of before there were kinds keep their digests.
        *((str(tracked.kind), tracked.fixture_probability) if tracked.fixture_probability else ()),
    )


def _shape_values(shape: ObjectShape) -> tuple[Any, ...]:
    return (
        shape.reconstructor,
        shape.mesh_sha256,
        shape.world_from_object,
        _primitive_values(shape.fitted),
        _primitive_values(shape.inflated),
        shape.seen_share,
        dataclasses.astuple(shape.containment),
        # Shapes that were not judged have the digest that they had before there were verdicts; so with kinds of fits.
        *((shape.verdict,) if shape.verdict else ()),
        *((shape.fit_kind,) if shape.fit_kind != "solid" else ()),
    )


def _graph_values(graph: PoseGraphRecord) -> tuple[Any, ...]:
    return (
        "graph",
        tuple(_values(node, _NODE) for node in graph.nodes),
        tuple(dataclasses.astuple(edge) for edge in graph.edges),
    )


def _primitive_values(primitives: Superquadrics) -> tuple[Any, ...]:
    return (primitives.exponents, primitives.semi_axes_m, primitives.world_from_local)


def _feed(digest: "hashlib._Hash", value: Any) -> None:
    # Kind and size come first, so that no two sequences of values give the same bytes.
    match value:
        case None:
            digest.update(b"n")
        case str():
            encoded = value.encode()
            digest.update(b"s%d:" % len(encoded) + encoded)
        case int() | np.integer():
            digest.update(b"i%d;" % int(value))
        case float() | np.floating():
            digest.update(b"f" + struct.pack("<d", value))
        case tuple():
            digest.update(b"t%d:" % len(value))
            for item in value:
                _feed(digest, item)
        case np.ndarray():
            little = np.ascontiguousarray(value, dtype=value.dtype.newbyteorder("<"))
            digest.update(f"a{little.dtype.str}{little.shape}:".encode())
            digest.update(little.data if little.size else b"")
        case _:
            raise TypeError(f"a map holds no {type(value).__name__}")
