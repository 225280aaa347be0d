import hashlib
import json
from dataclasses import fields, is_dataclass, replace
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.geometry.superquadric import Superquadrics
from hickory_stream.map_folder.codec import decode_snapshot, encode_snapshot
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.records import GraphEdge, Phase
from tests.engine.snapshot_fixtures import make_snapshot
from tests.graph.graph_fixtures import solved_graph

NULLABLE = ("best_view", "shape", "feature")
OUTSIDE = {("shape", "revision"), ("shape", "mesh_name")}


def variants(record, path=()):
    """Yield every record that differs from `record` in one leaf, with the path to it."""
    for field in fields(record):
        value, here = getattr(record, field.name), (*path, field.name)
        if field.name in ("views", "best_view"):
            continue
        if is_dataclass(value):
            for leaf, changed in variants(value, here):
                yield leaf, replace(record, **{field.name: changed})
        else:
            yield here, replace(record, **{field.name: nudged(value)})


def nudged(value):
    """Return a neighbour of a value: the next float, the next number, another text."""
    match value:
        case Phase():
            return Phase.DORMANT
        case str():
            # The kind of a fit is one of a few words.
            return "panels" if value == "solid" else "x" + value
        case int():
            return value + 1
        case float():
            return np.nextafter(value, np.inf).item()
        case tuple():
            return (*value[:-1], value[-1] + 1)
        case np.ndarray():
            changed = value.copy()
            last = changed.reshape(-1)[-1:]
            last[:] = np.nextafter(last, np.inf, dtype=last.dtype) if value.dtype.kind == "f" else last ^ 1
            return changed
    raise AssertionError(type(value))


def sketched_snapshot():
    """Return a map whose first object has a sketch, too: no real one has both it and a shape."""
    snapshot = make_snapshot()
    first = snapshot.objects[0]
    sketched = replace(first, sketch=first.shape.fitted, fixture_probability=0.25)
    return replace(snapshot, objects=(sketched, *snapshot.objects[1:]))


SNAPSHOT = sketched_snapshot()
GRAPH = solved_graph()


def with_first(tracked):
    return replace(SNAPSHOT, objects=(tracked, *SNAPSHOT.objects[1:]))


def altered():
    """Yield a name of every map that differs in one leaf of its first object, a view, or the last node of its graph."""
    first = SNAPSHOT.objects[0]
    for path, changed in variants(first):
        yield path, with_first(changed)
    for path, view in variants(first.views[0]):
        yield ("view", *path), with_first(replace(first, views=(view, *first.views[1:])))
    for path, node in variants(GRAPH.nodes[-1]):
        nodes = (*GRAPH.nodes[:-1], node)
        yield ("node", *path), replace(SNAPSHOT, graph=replace(GRAPH, edges=(), nodes=nodes))


ALTERED = dict(altered())


@pytest.mark.parametrize("path", ALTERED, ids=".".join)
def test_the_digest_changes_with_the_last_bit_of_a_map(path):
    graph = replace(GRAPH, edges=()) if path[0] == "node" else None
    assert (map_digest(ALTERED[path]) == map_digest(replace(SNAPSHOT, graph=graph))) == (path in OUTSIDE)


def test_the_digest_knows_the_best_view_and_what_is_absent():
    first = SNAPSHOT.objects[0]
    absent = ({"best_view": first.views[0]}, {"views": first.views[1:]}, *({name: None} for name in NULLABLE))
    digests = {map_digest(with_first(replace(first, **changes))) for changes in ({}, *absent)}
    assert len(digests) == 6
    assert map_digest(replace(SNAPSHOT, objects=SNAPSHOT.objects[1:])) not in digests


def test_the_digest_ignores_order_time_and_an_absent_graph():
    assert map_digest(replace(SNAPSHOT, objects=())) == hashlib.sha256().hexdigest()
    assert map_digest(replace(SNAPSHOT, graph=GRAPH)) != map_digest(SNAPSHOT)
    later = replace(SNAPSHOT, revision=99, stamp_ns=1, objects=SNAPSHOT.objects[::-1])
    assert map_digest(later) == map_digest(SNAPSHOT)


@pytest.mark.parametrize("field", [field.name for field in fields(GraphEdge)])
def test_the_digest_changes_with_everything_in_a_graph_edge(field):
    edge = GRAPH.loops[0]
    other = {"kind": "odometry", "earlier": edge.earlier - 1}.get(field, nudged(getattr(edge, field)))
    with_other = replace(GRAPH, edges=(replace(edge, **{field: other}),))
    one = replace(GRAPH, edges=(edge,))
    assert map_digest(replace(SNAPSHOT, graph=with_other)) != map_digest(replace(SNAPSHOT, graph=one))


def test_a_graph_survives_writing_unless_nobody_wrote_it():
    document, files = encode_snapshot(replace(SNAPSHOT, graph=GRAPH))
    read = decode_snapshot(json.loads(json.dumps(document)), files.__getitem__)
    assert read.graph.edges == GRAPH.edges
    assert map_digest(read) == map_digest(replace(SNAPSHOT, graph=GRAPH))
    assert "graph" not in encode_snapshot(SNAPSHOT)[0]
    for damage in ({"status": "maybe"}, {"kind": 3}, {"later": 10_000}, {"residual_m": "1"}):
        damaged = json.loads(json.dumps(document))
        damaged["graph"]["edges"][0].update(damage)
        with pytest.raises(ValueError, match=r"found|none of|does not have"):
            decode_snapshot(damaged, files.__getitem__)


finite = st.floats(allow_nan=False, allow_infinity=False, width=64)
finite32 = st.floats(allow_nan=False, allow_infinity=False, width=32)
positive = st.floats(min_value=1e-300, max_value=1e300)


@given(
    place=st.lists(finite, min_size=3, max_size=3), half=st.lists(positive, min_size=3, max_size=3),
    points=st.lists(st.tuples(finite32, finite32, finite32), max_size=5),
    feature=st.none() | st.lists(finite32, max_size=5),
    exponents=st.lists(st.floats(min_value=0.1, max_value=2.0), min_size=2, max_size=2),
    max_g=st.floats(allow_nan=False), stamp=st.integers(min_value=1 - 2**63, max_value=2**63 - 1),
)  # fmt: skip
def test_every_number_of_a_map_survives_writing_and_reading(place, half, points, feature, exponents, max_g, stamp):
    pose = np.eye(4)
    pose[:3, 3] = place
    first = SNAPSHOT.objects[0]
    contained = replace(first.shape.containment, max_g=max_g)
    quadrics = Superquadrics(exponents=[exponents], semi_axes_m=[half], world_from_local=pose[None])
    tracked = replace(
        first, points_world=np.array(points, dtype=np.float32).reshape(-1, 3),
        colors=np.zeros((len(points), 3), dtype=np.uint8), box=OrientedBox(world_from_box=pose, half_extents_m=half),
        feature=None if feature is None else np.array(feature, dtype=np.float32),
        shape=replace(first.shape, fitted=quadrics, inflated=quadrics, containment=contained), sketch=quadrics,
        last_seen_ns=stamp,
    )  # fmt: skip
    none = Superquadrics(exponents=np.empty((0, 2)), semi_axes_m=np.empty((0, 3)), world_from_local=np.empty((0, 4, 4)))
    bare = replace(first.shape, fitted=none, inflated=none, seen_share=np.empty(0))
    for snapshot in (with_first(tracked), with_first(replace(first, shape=bare))):
        document, files = encode_snapshot(snapshot)
        assert map_digest(decode_snapshot(document, files.__getitem__)) == map_digest(snapshot)
