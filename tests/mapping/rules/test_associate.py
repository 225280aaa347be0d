from itertools import permutations
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.geometry.boxes import box_iou
from hickory_stream.mapping.entities.track_table import TrackTable
from hickory_stream.mapping.rules.association import AssociateConfig, Match, associate, one_to_one
from tests.mapping.mapping_fixtures import VOXEL_M, box_surface, observation, track

CONFIG = AssociateConfig()
SIDE = 0.2

# Places on a coarse grid: boxes of 0.2 m at steps of 0.1 m coincide, overlap or are apart.
places = st.lists(st.tuples(st.integers(0, 5), st.integers(0, 3)), min_size=1, max_size=5)


def at(place):
    return box_surface((0.1 * place[0], 0.1 * place[1], 0.1))


def matched(observations, *tracks):
    return associate(observations, TrackTable({t.id: t for t in tracks}), VOXEL_M, CONFIG)


def pairs(matches):
    return {match.observation_index: match.track_id for match in matches}


@given(places, places)
def test_whole_matches_are_one_to_one_and_of_the_best_pairs(seen, known):
    tracks = [track(i + 1, at(place)) for i, place in enumerate(known)]
    observations = [observation(i, at(place)) for i, place in enumerate(seen)]
    matches = matched(observations, *tracks)
    by_box = [m for m in matches if m.track_id is not None and m.lies_on == 0]
    assert len({m.track_id for m in by_box}) == len(by_box)
    for match in by_box:
        assert match.track_id is not None
        true_iou = box_iou(observations[match.observation_index].box, tracks[match.track_id - 1].box)
        assert match.iou == pytest.approx(true_iou)
        assert match.iou >= CONFIG.min_iou
    assert [m.observation_index for m in matches] == list(range(len(seen)))
    # No unmatched pair beats the match of either half.
    of_seen, took = ({getattr(m, name): m for m in by_box} for name in ("observation_index", "track_id"))
    for one in observations:
        for other in tracks:
            iou = box_iou(one.box, other.box)
            rivals = [m.iou for m in (of_seen.get(one.index), took.get(other.id)) if m is not None]
            assert iou < CONFIG.min_iou or max(rivals) >= iou - 1e-12


@given(places, places, st.randoms(use_true_random=False))
def test_the_order_of_observations_does_not_change_the_pairs(seen, known, random):
    tracks = [track(i + 1, at(place)) for i, place in enumerate(known)]
    observations = [observation(i, at(place)) for i, place in enumerate(seen)]
    shuffled = list(observations)
    random.shuffle(shuffled)
    assert pairs(matched(observations, *tracks)) == pairs(matched(shuffled, *tracks))


def test_parts_of_one_track_go_to_it_and_one_of_them_is_whole():
    points = box_surface((0, 0, 0.1), (1.0, 0.2, 0.2))
    ends = [observation(0, points[points[:, 0] < -0.45]), observation(1, points[points[:, 0] > 0.45])]
    for order in permutations(ends):
        matches = matched(list(order), track(4, points))
        assert pairs(matches) == {0: 4, 1: 4}
        assert sorted(m.is_part for m in matches) == [False, True]


def test_the_larger_of_two_things_on_a_track_is_the_track():
    table = box_surface((0, 0, 0.7), (2.0, 0.8, 0.04))
    chair = box_surface((0.9, 0.3, 0.76), (0.1, 0.1, 0.1))
    known = track(4, np.concatenate([table, chair]))
    aside = box_surface((-0.3, 0.6, 0.7), (0.8, 0.4, 0.04))
    half = observation(
        1, np.concatenate([table[(table[:, 0] < -0.2) & (table[:, 1] > 0.0)], aside[aside[:, 1] > 0.65]])
    )
    first, second = matched([observation(0, chair), half], known)
    assert (first.track_id, second.track_id) == (4, 4)
    assert first.lies_on > second.lies_on
    assert (first.is_part, second.is_part) == (True, False)


def test_ties_go_to_the_lower_track_and_the_first_observation():
    points = box_surface((0, 0, 0.1))
    for ids in ((3, 7), (7, 3)):
        tracks = TrackTable({i: track(i, points) for i in ids})
        assert pairs(associate([observation(0, points)], tracks, VOXEL_M, CONFIG)) == {0: 3}
    first, second = matched([observation(0, points), observation(1, points)], track(5, points))
    assert (first.track_id, first.is_part) == (5, False)
    assert (second.track_id, second.is_part) == (5, True)


def test_a_partial_view_that_lies_on_a_track_goes_to_it():
    table = box_surface((0, 0, 0.7), (1.2, 0.8, 0.04))
    seen = observation(0, table[(table[:, 0] > 0.4) & (table[:, 1] > 0.2)])
    known = track(2, table)
    assert box_iou(seen.box, known.box) < CONFIG.min_iou
    (match,) = matched([seen], known)
    assert match.track_id == 2
    assert match.lies_on > 0.9
    assert not match.is_part


def test_a_thing_off_a_tracks_points_or_far_from_all_is_new():
    # Below a table: inside its box, off its surface.
    top, leg = box_surface((0, 0, 0.7), (1.2, 0.8, 0.04)), box_surface((-0.55, -0.35, 0.35), (0.04, 0.04, 0.7))
    (match,) = matched([observation(0, box_surface((0.2, 0.1, 0.15)))], track(1, np.concatenate([top, leg])))
    assert match.track_id is None
    assert match.lies_on < CONFIG.min_lies_on
    assert [i for i, _ in match.candidates] == [1]
    (match,) = matched([observation(0, box_surface((5, 0, 0.1)))], track(1, box_surface((0, 0, 0.1))))
    assert match == Match(observation_index=0, track_id=None, iou=0.0, lies_on=0.0, is_part=False, candidates=())


def test_all_candidates_are_named_best_first_with_exact_iou():
    # Cubes shifted by a quarter and a half of their side: 3/5 and 1/3, but for the steps that their points lie at.
    tracks = [track(1, box_surface((0.1, 0, 0.1))), track(2, box_surface((0.05, 0, 0.1)))]
    (match,) = matched([observation(0, box_surface((0, 0, 0.1)))], *tracks)
    assert [i for i, _ in match.candidates] == [2, 1]
    assert [iou for _, iou in match.candidates] == pytest.approx([3 / 5, 1 / 3], abs=1e-3)
    tracks = [track(i, box_surface((0.01 * i, 0, 0.1))) for i in range(1, 9)]
    (match,) = matched([observation(0, box_surface((0, 0, 0.1)))], *tracks)
    assert [i for i, _ in match.candidates] == list(range(1, 9))


@given(st.sampled_from([0.0, 0.4, 0.78]), st.floats(0, 0.5))
def test_a_thing_seen_again_a_little_off_is_the_same_track(yaw_rad, off):
    known = track(9, box_surface((0, 0, 0.1), yaw_rad=yaw_rad))
    again = observation(0, box_surface((off * SIDE, 0, 0.1), yaw_rad=yaw_rad))
    assert pairs(matched([again], known)) == {0: 9}


def test_the_best_pairs_come_first_and_take_both_members():
    assert one_to_one([(1, 7), (1, 8), (2, 7), (2, 8), (3, 9)], of_one_kind=False) == [(1, 7), (2, 8), (3, 9)]
    ranked = [(1, 2), (2, 3), (4, 1), (4, 3)]
    assert one_to_one(ranked, of_one_kind=True) == [(1, 2), (4, 3)]
    assert one_to_one(ranked, of_one_kind=False) == [(1, 2), (2, 3), (4, 1)]
