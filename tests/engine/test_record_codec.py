from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from hickory_stream.engine.digest import map_digest
from hickory_stream.engine.record_codec import decode, encode
from hickory_stream.mapping.merge import VoteBook, Votes
from hickory_stream.records import Phase
from tests.engine.snapshot_fixtures import make_snapshot

DTYPES = st.sampled_from(["<f4", "<f8", "<i8", "|u1", "|b1", "<i4", "<u2"])
SCALARS = st.none() | st.booleans() | st.integers(-(2**63), 2**63) | st.floats() | st.text() | st.binary()


@given(
    hnp.arrays(
        dtype=DTYPES,
        shape=hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=40),
    )
)
def test_an_array_comes_back_to_the_bit_and_read_only(array: np.ndarray) -> None:
    read = decode(encode(array))
    assert read.dtype == array.dtype
    assert read.shape == array.shape
    assert read.tobytes() == array.tobytes()
    assert not read.flags.writeable


@given(st.recursive(SCALARS, lambda inner: st.lists(inner, max_size=4).map(tuple), max_leaves=12))
def test_plain_values_come_back_as_they_were(value: object) -> None:
    assert repr(decode(encode(value))) == repr(value)


def test_a_map_with_everything_in_it_comes_back_with_its_digest() -> None:
    snapshot = make_snapshot()
    read = decode(encode(snapshot))
    assert map_digest(read) == map_digest(snapshot)
    assert read.submaps[0].observed_space.free.tolist() == snapshot.submaps[0].observed_space.free.tolist()


def test_keys_of_any_kind_sets_and_enums_come_back() -> None:
    book = VoteBook(votes={(1, 2): Votes(3, 4), (2, 9): Votes(0, 1)})
    read = decode(encode((book, {"b", "a"}, Phase.DORMANT, {3: (Phase.ACTIVE,)})))
    assert read == (book, {"a", "b"}, Phase.DORMANT, {3: (Phase.ACTIVE,)})


def test_sorted_keys_of_voxels_take_a_tenth_of_their_size() -> None:
    import zlib

    keys = np.unique(np.random.default_rng(0).integers(0, 2**21, 20_000))
    assert len(zlib.compress(encode(keys))) < keys.nbytes / 6


def test_only_records_of_ours_are_written_or_made() -> None:
    @dataclass(frozen=True)
    class Foreign:
        number: int

    with pytest.raises((AssertionError, TypeError)):
        encode(Foreign(1))
    with pytest.raises(TypeError, match="a journal holds no complex"):
        encode(1j)


@given(st.binary(max_size=60))
def test_bytes_that_are_no_record_are_refused_or_plain(data: bytes) -> None:
    try:
        decode(data)
    except ValueError:
        pass
