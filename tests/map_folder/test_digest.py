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
    return replace(
        snapshot, objects=(replace(first, sketch=first.shape.fitted, fixture_probability=0.25), *snapshot.objects[1:])
    )


SNAPSHOT = sketched_snapshot()
VARIANTS = dict(variants(SNAPSHOT.objects[0]))
VIEW_VARIANTS = dict(variants(SNAPSHOT.objects[0].views[0]))


def with_first(tracked):
    return replace(SNAPSHOT, objects=(tracked, *SNAPSHOT.objects[1:]))


@pytest.mark.parametrize("path", VARIANTS, ids=".".join)
def test_the_digest_changes_with_the_last_bit_of_an_object(path):
    assert (map_digest(with_first(VARIANTS[path])) == map_digest(SNAPSHOT)) == (path in OUTSIDE)


@pytest.mark.parametrize("path", VIEW_VARIANTS, ids=".".join)
def test_the_digest_changes_with_everything_in_a_view(path):
    first = SNAPSHOT.objects[0]
    changed = replace(first, views=(VIEW_VARIANTS[path], *first.views[1:]))
    assert map_digest(with_first(changed)) != map_digest(SNAPSHOT)


def test_the_digest_knows_the_best_view_and_what_is_absent():
    first = SNAPSHOT.objects[0]
    others = [
        replace(first, best_view=first.views[0]), replace(first, best_view=None), replace(first, views=first.views[1:]),
        replace(first, shape=None), replace(first, feature=None),
    ]  # fmt: skip
    digests = {map_digest(with_first(tracked)) for tracked in (first, *others)}
    assert len(digests) == 6
    assert map_digest(replace(SNAPSHOT, objects=SNAPSHOT.objects[1:])) not in digests


def test_the_digest_ignores_order_and_time_of_the_snapshot():
    later = replace(SNAPSHOT, revision=99, stamp_ns=1, objects=SNAPSHOT.objects[::-1])
    assert map_digest(later) == map_digest(SNAPSHOT)


GRAPH = solved_graph()


def test_a_map_without_a_graph_keeps_its_old_digest():
    assert map_digest(replace(SNAPSHOT, objects=())) == hashlib.sha256().hexdigest()
    assert map_digest(replace(SNAPSHOT, graph=GRAPH)) != map_digest(SNAPSHOT)


LAST_NODES = dict(variants(GRAPH.nodes[-1]))


@pytest.mark.parametrize("path", LAST_NODES, ids=".".join)
def test_the_digest_changes_with_everything_in_a_graph_node(path):
    without = replace(GRAPH, edges=())
    changed = replace(without, nodes=(*GRAPH.nodes[:-1], LAST_NODES[path]))
    assert map_digest(replace(SNAPSHOT, graph=changed)) != map_digest(replace(SNAPSHOT, graph=without))


@pytest.mark.parametrize("field", [field.name for field in fields(GraphEdge)])
def test_the_digest_changes_with_everything_in_a_graph_edge(field):
    edge = GRAPH.loops[0]
    other = {"kind": "odometry", "earlier": edge.earlier - 1}.get(field, nudged(getattr(edge, field)))
    with_other = replace(GRAPH, edges=(replace(edge, **{field: other}),))
    assert map_digest(replace(SNAPSHOT, graph=with_other)) != map_digest(
        replace(SNAPSHOT, graph=replace(GRAPH, edges=(edge,)))
    )


def test_a_graph_survives_writing_and_reading():
    document, files = encode_snapshot(replace(SNAPSHOT, graph=GRAPH))
    read = decode_snapshot(json.loads(json.dumps(document)), files.__getitem__)
    assert read.graph.edges == GRAPH.edges
    assert map_digest(read) == map_digest(replace(SNAPSHOT, graph=GRAPH))
    assert "graph" not in encode_snapshot(SNAPSHOT)[0]


def test_a_graph_that_nobody_wrote_is_refused():
    document, files = encode_snapshot(replace(SNAPSHOT, graph=GRAPH))
    for damage in ({"status": "maybe"}, {"kind": 3}, {"later": 10_000}, {"residual_m": "1"}):
        damaged = json.loads(json.dumps(document))
        damaged["graph"]["edges"][0].update(damage)
        with pytest.raises(ValueError, match=r"found|none of|does not have"):
            decode_snapshot(damaged, files.__getitem__)


finite = st.floats(allow_nan=False, allow_infinity=False, width=64)
finite32 = st.floats(allow_nan=False, allow_infinity=False, width=32)
positive = st.floats(min_value=1e-300, max_value=1e300)


@given(
    place=st.lists(finite, min_size=3, max_size=3),
    half=st.lists(positive, min_size=3, max_size=3),
    points=st.lists(st.tuples(finite32, finite32, finite32), max_size=5),
    feature=st.none() | st.lists(finite32, max_size=5),
    exponents=st.lists(st.floats(min_value=0.1, max_value=2.0), min_size=2, max_size=2),
    max_g=st.floats(allow_nan=False),
    stamp=st.integers(min_value=1 - 2**63, max_value=2**63 - 1),
)
def test_every_number_of_a_map_survives_writing_and_reading(place, half, points, feature, exponents, max_g, stamp):
    pose = np.eye(4)
    pose[:3, 3] = place
    first = SNAPSHOT.objects[0]
    quadrics = Superquadrics(exponents=[exponents], semi_axes_m=[half], world_from_local=pose[None])
    tracked = replace(
        first,
        points_world=np.array(points, dtype=np.float32).reshape(-1, 3),
        colors=np.zeros((len(points), 3), dtype=np.uint8),
        box=OrientedBox(world_from_box=pose, half_extents_m=half),
        feature=None if feature is None else np.array(feature, dtype=np.float32),
        shape=replace(
            first.shape, fitted=quadrics, inflated=quadrics, containment=replace(first.shape.containment, max_g=max_g)
        ),
        sketch=quadrics,
        last_seen_ns=stamp,
    )
    snapshot = with_first(tracked)
    document, files = encode_snapshot(snapshot)
    assert map_digest(decode_snapshot(document, files.__getitem__)) == map_digest(snapshot)


def test_a_shape_without_primitives_survives():
    first = SNAPSHOT.objects[0]
    none = Superquadrics(exponents=np.empty((0, 2)), semi_axes_m=np.empty((0, 3)), world_from_local=np.empty((0, 4, 4)))
    snapshot = with_first(
        replace(first, shape=replace(first.shape, fitted=none, inflated=none, seen_share=np.empty(0)))
    )
    document, files = encode_snapshot(snapshot)
    assert map_digest(decode_snapshot(document, files.__getitem__)) == map_digest(snapshot)
