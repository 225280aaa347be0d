import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hickory_stream.mapping.entities.cloud import NAMES, Cloud, is_packed, pack, pack_part, without


def cloud_of(steps, seed):
    count, rng = len(steps), np.random.default_rng(seed)
    return Cloud(
        keys=np.cumsum(steps, dtype=np.int64) - (1 << 40),
        points=rng.normal(size=(count, 3)).astype(np.float32),
        colors=rng.uniform(0, 255, (count, 3)).astype(np.float32),
        hits=rng.integers(1, 9, count).astype(np.int32),
    )


def bytes_of(cloud):
    return [(array.dtype.str, array.shape, array.tobytes()) for array in [getattr(cloud, name) for name in NAMES]]


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(1, 1 << 45), min_size=1, max_size=20), st.integers(0, 5), st.booleans())
def test_a_cloud_and_a_part_of_it_come_back_to_the_byte(steps, seed, is_other):
    whole = cloud_of(steps, seed)
    part = cloud_of(steps, seed + 1) if is_other else without(whole, whole.hits < 4)
    before, counts = (bytes_of(whole), bytes_of(part)), (len(whole), len(part))
    pack_part(part, whole)
    pack_part(part, whole)
    assert is_packed(whole)
    assert is_packed(part)
    assert (len(whole), len(part)) == counts
    assert is_packed(whole)
    # A part does not wake the whole that it is made from.
    assert bytes_of(part) == before[1]
    assert is_packed(whole)
    assert not is_packed(part)
    assert bytes_of(whole) == before[0]
    pack(whole)
    assert bytes_of(whole) == before[0]


def test_earlier_packed_clouds_are_released_without_compressing():
    cloud, kept = cloud_of([1, 2, 3], 0), list[bytes]()
    before = bytes_of(cloud)

    def keep(data):
        kept.append(data)
        return lambda: data

    pack(cloud, keep)
    assert bytes_of(cloud) == before
    assert not is_packed(cloud)
    pack(cloud, keep)
    assert is_packed(cloud)
    assert len(kept) == len(NAMES)
    assert bytes_of(cloud) == before


def test_a_cloud_that_is_its_own_part_is_packed_once():
    cloud = cloud_of([1, 2, 3], 0)
    before = bytes_of(cloud)
    pack_part(cloud, cloud)
    assert is_packed(cloud)
    assert bytes_of(cloud) == before
    assert not hasattr(cloud, "no_such_array")
