from dataclasses import replace
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.engine.step_writer import CheckpointTimes
from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.journal.checkpoints import PackedTrack, Packer, unpacked
from hickory_stream.mapping.entities.cloud import Cloud, solid_part, without
from hickory_stream.mapping.entities.track import Track
from hickory_stream.mapping.rules.merging import VoteBook
from hickory_stream.records import Phase


def cloud_of(hits):
    count = len(hits)
    return Cloud(
        keys=np.cumsum(np.arange(1, count + 1)).astype(np.int64),
        points=np.linspace(0, 1, 3 * count, dtype=np.float32).reshape(count, 3),
        colors=np.full((count, 3), 7, np.float32),
        hits=np.array(hits, np.int32),
    )


def track_of(cloud, solid):
    return Track(
        id=1, phase=Phase.ACTIVE, sightings=5, first_seen_ns=0, last_seen_ns=1, seen_clock_ns=1, cloud=cloud,
        solid=solid, box=OrientedBox(world_from_box=np.eye(4), half_extents_m=np.ones(3)),
        bounds=np.zeros((2, 3), np.float32),
    )  # fmt: skip


def bytes_of(cloud):
    return [array.tobytes() for array in (cloud.keys, cloud.points, cloud.colors, cloud.hits)]


@given(st.lists(st.integers(1, 5), min_size=1, max_size=30), st.sampled_from([1, 5, 20]))
def test_a_packed_state_comes_back_to_the_byte(hits, sightings):
    cloud = cloud_of(hits)
    track = track_of(cloud, solid_part(cloud, sightings))
    back = unpacked(Packer().packed({"tracks": {1: track}, "_next": 3}))
    assert back["_next"] == 3
    assert bytes_of(back["tracks"][1].cloud) == bytes_of(track.cloud)
    assert bytes_of(back["tracks"][1].solid) == bytes_of(track.solid)


def test_a_solid_part_not_chosen_from_the_cloud_is_kept():
    cloud = cloud_of([1, 2, 3])
    moved = replace(without(cloud, np.array([True, False, False])), points=np.ones((2, 3), np.float32))
    for solid in (moved, without(cloud, np.ones(3, bool))):
        track = track_of(cloud, solid)
        assert Packer().packed({"tracks": {1: track}})["tracks"][0].values[0] is track


def test_marks_of_a_track_change_exactly_with_the_track():
    packer = Packer()
    cloud = cloud_of([1, 3, 3, 4])
    track = track_of(cloud, without(cloud, cloud.hits < 2))
    first = packer.packed({"tracks": {1: track}})["tracks"][0].values[0]
    second = packer.packed({"tracks": {1: replace(track, sightings=6)}})["tracks"][0].values[0]
    third = packer.packed({"tracks": {1: replace(track, solid=without(cloud, cloud.hits < 4))}})["tracks"][0].values[0]
    assert isinstance(first, PackedTrack)
    assert first.is_solid is second.is_solid
    assert third.is_solid.tolist() == [False, False, False, True]


def test_a_page_is_equal_exactly_without_changes():
    packer = Packer()
    cloud = cloud_of([1, 3, 3, 4])
    tracks = {i: replace(track_of(cloud, cloud), id=i) for i in (1, 31, 32, 99)}
    votes = VoteBook().plus([(1, 31)], apart_ns=1).plus([(32, 99)], together_ns=2)
    before = packer.packed({"tracks": tracks, "votes": votes})
    after = packer.packed(
        {"tracks": tracks | {31: replace(tracks[31], sightings=9)}, "votes": votes.plus([(1, 31)], apart_ns=1)}
    )
    for name in ("tracks", "votes"):
        assert [a is b for a, b in zip(before[name], after[name], strict=True)] == [False, True, True]
    back = unpacked(after)
    assert back["votes"] == votes.plus([(1, 31)], apart_ns=1)
    assert {i: track.sightings for i, track in back["tracks"].items()} == {1: 5, 31: 9, 32: 5, 99: 5}


def due(keyframes, searching):
    """Return where a checkpoint is due; `searching` has a 's' for each keyframe with an open search."""
    times = CheckpointTimes(keyframes)
    return "".join("x" if times.is_due(searches=one == "s") else "." for one in searching)


def test_one_is_due_every_few_keyframes_and_waits_for_searches():
    assert due(3, ".........") == "..x..x..x"
    assert due(1, "...") == "xxx"
    assert due(3, "..sss.....") == ".....x..x."
    assert due(3, "ss........") == "..x..x..x."
    assert due(2, "s" * 12) == "...x...x...x"
