from dataclasses import replace
from itertools import combinations
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.geometry.bounds import bounds_of
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.core import MapperCore
from hickory_stream.mapping.entities.cloud import cloud_of
from hickory_stream.mapping.entities.track import with_cloud
from hickory_stream.mapping.entities.track_table import TrackTable
from hickory_stream.mapping.entities.views import ViewConfig
from hickory_stream.mapping.rules import merging
from hickory_stream.mapping.rules.association import AssociateConfig, is_oversized
from hickory_stream.mapping.rules.splitting import TrackSplitConfig, reassigned, with_keyframe
from hickory_stream.records import Phase
from tests.mapping.mapping_fixtures import (
    SECOND_NS,
    VOXEL_M,
    box_surface,
    drive,
    graph_of,
    keyframe,
    observation,
    shape,
    track,
    view,
)

CONFIG = merging.MergeConfig()
VIEWS = ViewConfig()

pairs = st.tuples(st.integers(1, 5), st.integers(1, 5)).filter(lambda pair: pair[0] != pair[1])


@st.composite
def vote_books(draw):
    book = merging.VoteBook()
    for pair in draw(st.lists(pairs, max_size=12)):
        book = book.plus([pair], together_ns=draw(st.integers(0, 3)), apart_ns=draw(st.integers(0, 3)))
    return book


def cloud(points):
    return cloud_of(points, np.zeros((len(points), 3), dtype=np.uint8), VOXEL_M)


def found(book, *tracks):
    known = TrackTable({t.id: t for t in tracks})
    pair = merging.find_pair(known, known, book, graph_of(known), 0.01, CONFIG)
    return pair[:2] if pair is not None else None


@given(vote_books(), pairs)
def test_the_votes_of_a_pair_do_not_depend_on_its_order(book, pair):
    assert book.of(*pair) == book.of(*reversed(pair))


@given(vote_books(), pairs, st.integers(0, 3), st.integers(0, 3))
def test_a_vote_counts_for_its_pair_alone(book, pair, together, apart):
    after = book.plus([pair], together_ns=together, apart_ns=apart)
    for a in range(1, 6):
        for b in range(a + 1, 6):
            more = (together, apart) if {a, b} == set(pair) else (0, 0)
            before = book.of(a, b)
            assert after.of(a, b) == merging.Votes(before.together_ns + more[0], before.apart_ns + more[1])


@given(vote_books(), pairs)
def test_a_merge_takes_votes_over_and_counts_shared_looks_once(book, pair):
    kept, gone = pair
    after = book.merged(kept, gone)
    for other in set(range(1, 6)) - {kept, gone}:
        mine, theirs = book.of(kept, other), book.of(gone, other)
        together_ns = max(mine.together_ns, theirs.together_ns)
        assert after.of(kept, other) == merging.Votes(together_ns, mine.apart_ns + theirs.apart_ns)
    assert after.of(kept, gone) == merging.Votes()
    assert not any(gone in known for known in after.votes)


def test_one_keyframe_alone_never_merges_many_fragments():
    book, ids = merging.VoteBook(), range(1, 9)
    book = book.plus(list(combinations(ids, 2)), together_ns=SECOND_NS // 2)
    for gone in ids[:0:-1]:
        assert max(book.of(1, other).together_ns for other in ids) < 1e9 * CONFIG.min_together_s
        book = book.merged(1, gone)


@given(vote_books(), st.integers(1, 5))
def test_a_dropped_track_leaves_no_votes_and_takes_no_others(book, gone):
    after = book.without(gone)
    assert not any(gone in known for known in after.votes)
    assert all(after.votes[known] == votes for known, votes in book.votes.items() if gone not in known)


def test_equal_tracks_and_a_piece_on_a_larger_one_are_one():
    points = box_surface((0, 0, 0.1))
    assert found(merging.VoteBook(), track(8, points), track(3, points)) == (3, 8)
    table = box_surface((0, 0, 0.7), (1.2, 0.8, 0.04))
    assert found(merging.VoteBook(), track(1, table), track(2, table[table[:, 0] > 0.3])) == (1, 2)


def test_what_is_seen_apart_from_the_table_above_it_is_no_leg():
    top, side = box_surface((0, 0, 0.72), (0.6, 1.2, 0.04)), box_surface((0, -0.58, 0.35), (0.6, 0.04, 0.7))
    desk, pedestal = track(1, np.concatenate([top, side])), track(2, box_surface((0, 0.4, 0.34), (0.4, 0.3, 0.66)))
    book = merging.VoteBook().plus([(1, 2)], together_ns=SECOND_NS // 2)
    assert found(book, desk, pedestal) == (1, 2)
    assert found(book.plus([(1, 2)], apart_ns=SECOND_NS), desk, pedestal) is None


def test_tracks_apart_and_a_mug_on_a_table_are_two():
    box = track(1, box_surface((0, 0, 0.1)))
    assert found(merging.VoteBook(), box, track(2, box_surface((1, 0, 0.1)))) is None
    assert found(merging.VoteBook(), box, track(2, box_surface((0.23, 0, 0.1)))) is None
    table, mug = box_surface((0, 0, 0.7), (1.2, 0.8, 0.04)), box_surface((0.2, 0.1, 0.775), (0.08, 0.08, 0.1))
    assert found(merging.VoteBook(), track(1, table), track(2, mug)) is None


def test_a_thing_on_a_third_is_no_part_of_the_one_around_it():
    seat, back = box_surface((0, 0, 0.45), (0.4, 0.4, 0.04)), box_surface((0.19, 0, 0.78), (0.02, 0.4, 0.24))
    chair = track(1, np.concatenate([seat, back]))
    mug = track(2, box_surface((0.13, 0, 0.65), (0.08, 0.08, 0.1)))
    table = track(3, box_surface((-0.3, 0, 0.575), (0.96, 1.0, 0.04)))
    assert found(merging.VoteBook(), chair, mug) == (1, 2)
    assert found(merging.VoteBook(), chair, mug, table) is None


@pytest.mark.parametrize(("together_s", "apart_s", "verdict"), [
    (0.7, 0, None), (0.8, 0, (1, 2)), (0.8, 0.7, (1, 2)), (0.8, 0.8, None), (0.8, 3, None), (2.5, 3, None),
    (0, 0, None),
])  # fmt: skip
def test_pieces_merge_when_seen_as_one_more_often_than_apart(together_s, apart_s, verdict):
    book = merging.VoteBook().plus(
        [(1, 2)], together_ns=round(together_s * SECOND_NS), apart_ns=round(apart_s * SECOND_NS)
    )
    assert found(book, *(track(1, box_surface((0, 0, 0.1))), track(2, box_surface((0.21, 0, 0.1))))) == verdict


def test_leaves_in_one_place_are_one_although_frames_mostly_tear_them():
    lower, upper = (
        np.concatenate([box_surface((0, 0, z + k), (0.5, 0.5, 0.02)) for k in (0, 0.2, 0.4, 0.6)]) for z in (0, 0.3)
    )
    book = merging.VoteBook().plus([(1, 2)], together_ns=SECOND_NS, apart_ns=2 * SECOND_NS)
    assert found(book, track(1, lower), track(2, upper)) == (1, 2)
    assert found(book, replace(track(1, lower), is_promoted=True), track(2, upper)) is None
    assert found(merging.VoteBook().plus([(1, 2)], apart_ns=SECOND_NS), track(1, lower), track(2, upper)) is None


def test_votes_of_things_that_do_not_even_touch_weld_nothing():
    book = merging.VoteBook().plus([(1, 2)], together_ns=50 * SECOND_NS)
    assert found(book, track(1, box_surface((0, 0, 0.1))), track(2, box_surface((0.6, 0, 0.1)))) is None


@pytest.mark.parametrize(("sigma_m", "apart_ns", "pair"), [(0.2, 0, (1, 2)), (0.2, 1, None), (0.01, 0, None)])
def test_a_far_view_is_one_with_a_near_one_within_its_noise(sigma_m, apart_ns, pair):
    near = box_surface((0, 0, 0.1), (0.2, 0.2, 0.2))
    far = near[::3] + np.random.default_rng(0).normal(size=(len(near[::3]), 1)) * np.array([0.2, 0.0, 0.0])
    seen = cloud_of(
        far.astype(np.float32), np.zeros(far.shape, np.uint8), VOXEL_M, np.full(len(far), sigma_m**-2, np.float32)
    )
    blurred = with_cloud(track(2, box_surface((0, 0, 0.1))), seen, 3, VOXEL_M)
    # What was split off is no part of anything.
    clear = replace(track(1, near), is_promoted=True)
    assert found(merging.VoteBook().plus([(1, 2)], apart_ns=apart_ns), clear, blurred) == pair


def test_a_patch_is_a_part_of_a_thing_of_its_kind_that_was_known_as_long():
    car, lamp = (
        track(1, box_surface((0, 0, 0.8), (4.0, 1.8, 1.2))),
        track(2, box_surface((2.0, 0.4, 0.8), (0.06, 0.3, 0.3))),
    )
    book = merging.VoteBook().plus([(1, 2)], apart_ns=9 * SECOND_NS)
    assert found(book, car, lamp) == (1, 2)
    assert found(book, replace(car, is_attached=True), lamp) is None
    assert found(book, car, replace(lamp, observed_ns=car.observed_ns + 1)) is None


def test_only_pairs_with_a_changed_track_are_looked_at():
    points = box_surface((0, 0, 0.1))
    known = TrackTable({1: track(1, points), 2: track(2, points), 3: track(3, box_surface((2, 0, 0.1)))})
    assert merging.find_pair(known, [3], merging.VoteBook(), graph_of(known), 0.01, CONFIG) is None
    assert merging.find_pair(known, [2, 99], merging.VoteBook(), graph_of(known), 0.01, CONFIG) is not None


def test_points_on_another_track_count_and_a_cover_is_named():
    left, right = box_surface((0, 0, 0.1)), box_surface((0.24, 0, 0.1))
    seen = cloud(np.concatenate([left, right]))
    foreign, covered = merging.points_on_others(seen, track(1, left), [track(2, right)])
    assert covered == [2]
    assert (seen.points[foreign][:, 0] > 0.12).all()
    assert foreign.sum() > 0.8 * (seen.points[:, 0] > 0.14).sum()


def test_nothing_is_foreign_on_the_own_track_or_away_from_others():
    points = box_surface((0, 0, 0.1))
    foreign, covered = merging.points_on_others(cloud(points), track(1, points), [track(2, points)])
    assert not foreign.any()
    assert covered == [2]
    foreign, covered = merging.points_on_others(cloud(points), track(1, points), [track(2, box_surface((3, 0, 0.1)))])
    assert not foreign.any()
    assert covered == []


def test_a_track_that_is_only_brushed_is_not_covered():
    vase, table = box_surface((0, 0, 0.2), (0.08, 0.08, 0.4)), box_surface((0, 0, -0.02), (1.2, 0.8, 0.04))
    _, covered = merging.points_on_others(cloud(vase), track(1, vase), [track(2, table)])
    # The vase's lowest cells are beside the table's: less than a third of it.
    assert covered == []


def two_tracks():
    kept = replace(
        track(1, box_surface((0, 0, 0.1)), sightings=4), first_seen_ns=3 * SECOND_NS, last_seen_ns=9 * SECOND_NS,
        seen_clock_ns=6, coverage=((2, view(3)),), best_view=view(4, score=0.3), merged_ids=(7,), seen_through_ns=2,
    )  # fmt: skip
    gone = replace(
        track(5, box_surface((0.1, 0, 0.1)), sightings=9, phase=Phase.DORMANT), first_seen_ns=1 * SECOND_NS,
        last_seen_ns=5 * SECOND_NS, seen_clock_ns=2, coverage=((0, view(5)), (2, view(6, r_area=0.9))),
        best_view=view(6, score=0.5, r_area=0.9), shape=shape(3), merged_ids=(6,), seen_through_ns=1,
    )  # fmt: skip
    return kept, gone


def test_a_merged_track_has_what_both_have_seen_and_the_shape():
    kept, gone = two_tracks()
    one = merging.merge(kept, gone, VOXEL_M)
    assert (one.id, one.merged_ids) == (1, (5, 6, 7))
    assert (one.first_seen_ns, one.last_seen_ns) == (1 * SECOND_NS, 9 * SECOND_NS)
    assert (one.seen_clock_ns, one.seen_through_ns) == (6, 1)
    assert np.array_equal(one.cloud.keys, np.union1d(kept.cloud.keys, gone.cloud.keys))
    assert one.box.contains(one.cloud.points, VOXEL_M).all()
    assert (one.best_view.frame_index, one.best_view.score, one.best_view.object_id) == (6, 0.5, 1)
    assert [(sector, kept_view.frame_index) for sector, kept_view in one.coverage] == [(0, 5), (2, 6)]
    assert {kept_view.object_id for kept_view in one.views} == {1}
    # Shape and phase are those of the more seen one, unless the kept one has a shape.
    assert one.shape is gone.shape
    assert one.phase is Phase.DORMANT
    mine = shape(9)
    assert merging.merge(replace(kept, shape=mine), gone, VOXEL_M).shape is mine


def test_observations_meet_within_a_hands_width():
    bounds = [bounds_of(box_surface((x, 0, 0), (0.2, 0.2, 0.2))) for x in (0.0, 0.3, 0.8)]
    assert merging.pairs_that_meet(bounds, [7, 4, 5]) == {(4, 7)}
    assert merging.pairs_that_meet([], []) == set()


SPLIT = TrackSplitConfig()
PASSED_NS = SECOND_NS // 2
DRESSER = box_surface((0.0, 0.0, 0.4), (0.8, 0.4, 0.8))
SET = box_surface((0.0, 0.0, 1.0), (0.5, 0.2, 0.36))


def cloud_at(points):
    return cloud_of(points, np.full((len(points), 3), 100, dtype=np.uint8), VOXEL_M)


def test_a_part_that_is_seen_apart_often_is_an_object():
    parts = {}
    for frame in range(3):
        assert not any(part.is_object(SPLIT) for part in parts.get(1, ()))
        parts = with_keyframe(parts, frame, PASSED_NS, [(1, cloud_at(SET))], [(1, cloud_at(DRESSER))])
    assert [part.is_object(SPLIT) for part in parts[1]] == [True]


def test_being_seen_as_one_counts_against_it():
    parts = {}
    both = cloud_at(np.concatenate([DRESSER, SET]))
    for frame in range(6):
        parts = with_keyframe(parts, 2 * frame, PASSED_NS, [(1, cloud_at(SET))], [])
        parts = with_keyframe(parts, 2 * frame + 1, PASSED_NS, [], [(1, both)])
    (part,) = parts[1]
    assert (part.sightings, part.apart_ns, part.together_ns) == (6, 6 * PASSED_NS, 6 * PASSED_NS)
    assert not part.is_object(SPLIT)


def test_parts_are_told_by_place_and_go_where_their_host_goes():
    parts = with_keyframe({}, 0, PASSED_NS, [(1, cloud_at(SET))], [])
    parts = with_keyframe(parts, 1, PASSED_NS, [], [(1, cloud_at(SET))])
    assert [(part.frame_index, part.sightings, part.together_ns) for part in parts[1]] == [(0, 1, 0)]
    parts = with_keyframe({}, 0, PASSED_NS, [(1, cloud_at(SET)), (1, cloud_at(SET + np.float32([0, 0.6, 0])))], [])
    assert [part.sightings for part in parts[1]] == [1, 1]
    parts = with_keyframe({}, 0, PASSED_NS, [(2, cloud_at(SET))], [])
    assert list(reassigned(parts, 1, 2)) == [1]


def test_the_core_promotes_what_an_early_view_swallowed():
    core = MapperCore(MappingConfig(voxels=Lattice(object_m=VOXEL_M)))
    both = np.concatenate([DRESSER, SET])
    frames = [keyframe(i, [observation(0, both)]) for i in range(3)]
    frames += [keyframe(i, [observation(0, DRESSER), observation(1, SET)]) for i in range(3, 14)]
    drive(core, frames)
    boxes = [2 * tracked.box.half_extents_m for tracked in core.snapshot().objects]
    assert len(boxes) == 2
    assert sorted(float(size[2]) for size in boxes) == pytest.approx([0.36, 0.8], abs=0.06)


def test_the_core_keeps_as_one_what_is_seen_as_one():
    core = MapperCore(MappingConfig(voxels=Lattice(object_m=VOXEL_M)))
    both = np.concatenate([DRESSER, SET])
    for i in range(12):
        seen = [observation(0, both)] if i % 2 == 0 else [observation(0, DRESSER), observation(1, SET)]
        drive(core, [keyframe(i, seen, stamp_ns=i * PASSED_NS)])
    assert len(core.snapshot().objects) == 1


def test_the_core_promotes_the_rest_of_a_split_track():
    core = MapperCore(MappingConfig(voxels=Lattice(object_m=VOXEL_M)))
    table = box_surface((0.0, 0.0, 0.7), (1.2, 0.8, 0.04))
    tray, mug = box_surface((0.3, 0.1, 0.75), (0.4, 0.3, 0.06)), box_surface((0.3, 0.1, 0.84), (0.1, 0.1, 0.12))
    early = [observation(0, table), observation(1, np.concatenate([tray, mug]))]
    later = [observation(0, np.concatenate([table, tray])), observation(1, mug)]
    drive(core, [keyframe(i, early) for i in range(4)] + [keyframe(i, later) for i in range(4, 9)])
    heights = sorted(float(2 * tracked.box.half_extents_m[2]) for tracked in core.snapshot().objects)
    # The tray, of which most lies near the table, is the table's.
    assert heights == pytest.approx([0.1, 0.12], abs=0.015)


def test_one_observation_does_not_double_a_settled_track():
    config = AssociateConfig()
    mug = track(1, box_surface((0.0, 0.0, 0.05), (0.1, 0.1, 0.1)), sightings=8)
    with_bowl = observation(0, box_surface((0.1, 0.0, 0.06), (0.32, 0.2, 0.12)))
    assert is_oversized(with_bowl, mug, config)
    assert not is_oversized(with_bowl, replace(mug, sightings=2), config)
    assert not is_oversized(observation(0, box_surface((0.0, 0.0, 0.05), (0.11, 0.1, 0.11))), mug, config)
