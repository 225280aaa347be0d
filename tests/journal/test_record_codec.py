import re
import zlib
from dataclasses import dataclass
import cbor2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from hickory_stream.geometry.lattice import on_steps, points_of
from hickory_stream.graph.solve import solve
from hickory_stream.journal.record_codec import decode, encode
from hickory_stream.map_folder.digest import map_digest
from hickory_stream.mapping.rules.merging import VoteBook
from hickory_stream.records import Phase
from tests.engine.snapshot_fixtures import make_snapshot
from tests.graph.graph_fixtures import solved_graph, walk
from tests.mapping.mapping_fixtures import box_surface, track

DTYPES = st.sampled_from(["<f4", "<f8", "<i8", "|u1", "|b1", "<i4", "<u2"])
SCALARS = st.none() | st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats() | st.text() | st.binary()


@given(hnp.arrays(dtype=DTYPES, shape=hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=40)))
def test_an_array_comes_back_to_the_bit_and_read_only(array):
    read = decode(encode(array))
    assert read.dtype == array.dtype
    assert read.shape == array.shape
    assert read.tobytes() == array.tobytes()
    assert not read.flags.writeable


@given(st.recursive(SCALARS, lambda inner: st.lists(inner, max_size=4).map(tuple), max_leaves=12))
def test_plain_values_come_back_as_they_were(value):
    assert repr(decode(encode(value))) == repr(value)


def test_a_map_with_everything_and_its_pose_graph_come_back():
    snapshot = make_snapshot()
    read = decode(encode(snapshot))
    assert map_digest(read) == map_digest(snapshot)
    assert read.submaps[0].observed_space.free.tolist() == snapshot.submaps[0].observed_space.free.tolist()
    factors, record = walk().graph, solved_graph()
    read_factors, read_record = decode(encode((factors, record)))
    assert encode((read_factors, read_record)) == encode((factors, record))
    assert solve(read_factors).accepted == solve(factors).accepted
    assert read_record.edges == record.edges


def test_a_field_of_an_earlier_version_is_left_out():
    tag = cbor2.loads(encode(track(1, box_surface((0, 0, 0)))))
    name, fields = tag.value

    def read_with(field):
        return decode(cbor2.dumps(cbor2.CBORTag(tag.tag, [name, {**fields, field: 3}])))

    assert read_with("doubts").id == 1
    with pytest.raises((TypeError, ValueError), match="unknown"):
        read_with("unknown")


def test_keys_of_any_kind_sets_and_enums_come_back():
    book = VoteBook().plus([(1, 2)], together_ns=3, apart_ns=4).plus([(2, 9)], apart_ns=1)
    read = decode(encode((book, {"b", "a"}, Phase.DORMANT, {3: (Phase.ACTIVE,)})))
    assert read == (book, {"a", "b"}, Phase.DORMANT, {3: (Phase.ACTIVE,)})


@given(st.lists(st.integers(1, 200), max_size=300), st.integers(-(2**62), 2**61))
def test_keys_in_columns_come_back(steps, first):
    keys = np.repeat(np.cumsum([0, *steps], dtype=np.int64) * 64 + first, 3) + np.tile([0, 1, 2], len(steps) + 1)
    full = np.concatenate([np.arange(start, start + 500) for start in (first, 0, 1, 63, -64, 1 << 50)])
    for some in (keys, *full.reshape(-1, 500)):
        assert decode(encode(some)).tobytes() == some.tobytes()


def test_keys_of_voxels_take_a_tenth_of_their_size():
    columns = np.unique(np.random.default_rng(0).integers(0, 2**21, 2_000)) << 21
    keys = (columns[:, None] + np.arange(40)).reshape(-1)
    assert len(encode(keys)) < keys.nbytes / 10
    keys = np.unique(np.random.default_rng(0).integers(0, 2**21, 20_000))
    assert len(zlib.compress(encode(keys))) < keys.nbytes / 6


@given(hnp.arrays(np.int32, (50, 3), elements=st.integers(-(2**24) + 1, 2**24 - 1)))
def test_points_at_steps_come_back_to_the_bit(steps):
    assert decode(encode(points_of(steps))).tobytes() == points_of(steps).tobytes()


def test_points_at_steps_and_smooth_colours_take_little():
    points = np.sort(np.random.default_rng(0).uniform(0, 1, (4_000, 3)).astype(np.float32), axis=0)
    assert len(zlib.compress(encode(on_steps(points)))) < 0.6 * len(zlib.compress(encode(points)))
    rng = np.random.default_rng(0)
    colors = (np.cumsum(rng.integers(-2, 3, (4_000, 1)), axis=0) + rng.integers(0, 3, (4_000, 3))).astype(np.uint8)
    assert decode(encode(colors)).tobytes() == colors.tobytes()
    assert len(zlib.compress(encode(colors))) < 0.75 * len(zlib.compress(colors.tobytes()))


def test_only_records_of_ours_are_written_or_made():
    @dataclass(frozen=True)
    class Foreign:
        number: int

    with pytest.raises((AssertionError, TypeError)):
        encode(Foreign(1))
    with pytest.raises(TypeError, match="a journal holds no complex"):
        encode(1j)


@given(st.binary(max_size=60))
def test_bytes_that_are_no_record_are_refused_or_plain(data):
    try:
        decode(data)
    except ValueError:
        pass


def tagged(tag, content):
    return cbor2.dumps(cbor2.CBORTag(tag, content))


HOSTILE = {
    "more_zeros_than_memory": tagged(39_101, ["|b1", [10**12], 1, b""]),
    "more_numbers_than_bytes": tagged(39_101, ["<f8", [10**9], 0, b"\0" * 8]),
    "negative_shape": tagged(39_101, ["<f8", [-1, 1], 0, b"\0" * 8]),
    "blocks_without_keys": tagged(39_101, ["<i8", [1], 4, b"\0" * 16 + b"\1" + b"\0" * 15]),
    "more_keys_than_blocks": tagged(39_101, ["<i8", [65], 4, b"\0" * 8 + b"\xff" * 8]),
    "keys_by_the_billion": tagged(39_101, ["<i8", [10**9], 4, b"\xff" * 16]),
    "half_a_block": tagged(39_101, ["<i8", [0], 4, b"\0" * 8]),
    "colours_of_two": tagged(39_101, ["|u1", [4, 2], 5, b"\0" * 8]),
    "objects": tagged(39_101, ["|O", [1], 0, b"\0" * 8]), "pickled": tagged(39_101, ["|V1000000000", [1], 0, b""]),
    "a_pattern": cbor2.dumps(re.compile("(a+)+$")), "a_record_of_nothing": tagged(39_100, ["Path", {}]),
    "a_field_that_there_is_not": tagged(39_100, ["OpenJob", {"ticket": 1, "object_id": 1, "due_ns": 1, "more": 1}]),
    "a_text_for_a_ticket": tagged(39_100, ["OpenJob", {"ticket": "../../x", "object_id": 1, "due_ns": 1}]),
    "a_flag_for_a_ticket": tagged(39_100, ["OpenJob", {"ticket": True, "object_id": 1, "due_ns": 1}]),
    "a_ticket_of_many_digits": tagged(39_100, ["OpenJob", {"ticket": 10**40, "object_id": 1, "due_ns": 1}]),
    "too_deep": b"\x81" * 5000 + b"\x00",
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_what_was_made_to_do_harm_is_refused(name):
    with pytest.raises(ValueError, match=r"."):
        decode(HOSTILE[name])


@pytest.mark.timeout(10)
def test_bytes_that_unfold_to_billions_of_items_are_refused():
    item = []
    for _ in range(40):
        item = [item, item]
    data = cbor2.dumps(item, value_sharing=True)
    assert len(data) < 1000
    with pytest.raises(ValueError, match="more items than bytes"):
        decode(data)
