from dataclasses import replace
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.mapping.derived import ShapeWishes
from hickory_stream.mapping.entities.track import ShapeState
from hickory_stream.mapping.entities.track_table import TrackTable
from hickory_stream.mapping.rules import shape_requests
from hickory_stream.records import Phase
from tests.mapping.mapping_fixtures import SECOND_NS, box_surface, shape, track, view

CONFIG = shape_requests.RequestConfig(
    max_in_flight=2, first_sightings=5, min_gain=0.9, final_gain=0.15, interval_s=6.0, max_failures=2
)
POINTS = box_surface((0, 0, 0.1))


def seen(track_id, *, num_views=2, sightings=9):
    """A confirmed track that has no shape yet."""
    coverage = tuple((i, view(10 * track_id + i)) for i in range(num_views))
    return replace(track(track_id, POINTS, sightings=sightings), coverage=coverage)


def built(track_id, *, new_views=0, asked_s=0.0):
    """A track with a shape of two views, and views that are new since."""
    bare = seen(track_id, num_views=2 + new_views)
    asked = ShapeState(
        asked_clock_ns=round(asked_s * SECOND_NS),
        asked_points=len(bare.solid.keys),
        asked_views=tuple(v.name for v in bare.views[:2]),
    )
    return replace(bare, shape=shape(1), shape_state=asked)


def failed(bare, failures):
    state = ShapeState(asked_views=tuple(v.name for v in bare.views), asked_points=1, failures=failures)
    return replace(bare, shape_state=state)


def asked(*tracks, num_open=0, clock_s=100, is_final=False):
    known = {t.id: t for t in tracks}
    return shape_requests.next_requests(known, num_open, round(clock_s * SECOND_NS), is_final=is_final, config=CONFIG)


def test_first_shapes_and_lower_ids_come_first():
    assert asked(built(1, new_views=30), seen(4), seen(2)) == [2, 4]
    assert asked(built(1, new_views=30), seen(4)) == [4, 1]


def scored(bare, score, asked_score=0.0, **state):
    """The track with a best view of a score, whose shape was last asked for at another one."""
    best = replace(bare.views[0], score=score)
    coverage = ((0, best), *bare.coverage[1:])
    shape_state = replace(bare.shape_state, asked_score=asked_score, **state)
    return replace(bare, best_view=best, coverage=coverage, shape_state=shape_state)


def test_the_best_view_and_the_largest_gain_come_first():
    assert asked(scored(seen(1), 0.1), scored(seen(2), 0.3)) == [2, 1]
    much, little = scored(built(1, new_views=30), 0.30, 0.29), scored(built(2, new_views=30), 0.2, 0.1)
    assert asked(much, little) == [2, 1]
    # It cannot be negative: of two that have not grown, what is new in views decides.
    assert asked(scored(built(1, new_views=20), 0.1, 0.3), scored(built(2, new_views=30), 0.1, 0.1)) == [2, 1]


def test_a_gain_counts_more_where_it_costs_less():
    few, many = scored(seen(1, num_views=8), 0.30), scored(seen(2, num_views=2), 0.29)
    costly = replace(CONFIG, job_s=0.1, view_s=1.0, kilopoint_s=0.0)
    assert shape_requests.predicted_s(few, costly) == pytest.approx(8.1)
    assert shape_requests.next_requests({1: few, 2: many}, 0, 0, is_final=True, config=costly) == [2, 1]
    assert shape_requests.next_requests({1: few, 2: many}, 0, 0, is_final=True, config=replace(costly, view_s=0.0)) == [
        1,
        2,
    ]


@pytest.mark.parametrize(
    ("score", "passed_s", "is_replaced"),
    [(0.151, 0.0, True), (0.149, 0.0, False), (0.16, 2.0, True), (0.16, 3.0, False), (0.2, 4.0, True)],
)
def test_an_open_job_is_replaced_when_the_view_is_far_better(score, passed_s, is_replaced):
    config = replace(CONFIG, latency_s=4.0)
    waiting = scored(seen(1), score, 0.1, open_ticket=7, asked_clock_ns=0)
    clock_ns = round(passed_s * SECOND_NS)
    assert shape_requests.next_replacements({1: waiting}, clock_ns, config) == ([1] if is_replaced else [])
    again = replace(waiting, shape_state=replace(waiting.shape_state, is_replacement=True))
    assert shape_requests.next_replacements({1: again}, clock_ns, config) == []
    ended = replace(waiting, shape_state=replace(waiting.shape_state, open_ticket=None))
    assert shape_requests.next_replacements({1: ended}, clock_ns, config) == []


def test_no_more_jobs_are_open_than_allowed_and_one_per_object():
    tracks = [seen(i) for i in range(1, 6)]
    assert asked(*tracks) == [1, 2]
    assert asked(*tracks, num_open=1) == [1]
    assert asked(*tracks, num_open=2) == []
    assert asked(*tracks, num_open=7) == []
    assert asked(replace(seen(1), shape_state=ShapeState(open_ticket=4))) == []
    assert asked(replace(seen(1), shape_state=ShapeState(open_ticket=4)), is_final=True) == []


def test_a_shape_is_requested_for_a_confirmed_often_seen_object():
    assert asked(seen(1, sightings=5)) == [1]
    assert asked(seen(1, sightings=4)) == []
    assert asked(seen(1, num_views=0)) == []
    assert asked(replace(seen(1), phase=Phase.TENTATIVE)) == []


@pytest.mark.parametrize("phase", [Phase.ACTIVE, Phase.DORMANT, Phase.ARCHIVED])
def test_at_the_end_every_missing_shape_is_requested_at_once(phase):
    tracks = [replace(seen(i, sightings=3), phase=phase) for i in range(1, 8)]
    assert asked(*tracks, num_open=2, is_final=True) == [1, 2, 3, 4, 5, 6, 7]


def test_a_shape_is_renewed_after_news_and_time_or_at_the_end():
    assert asked(built(1, new_views=30)) == [1]
    assert asked(built(1, new_views=1)) == []
    assert asked(built(1, new_views=30, asked_s=95)) == []
    assert asked(built(1, new_views=30, asked_s=94)) == [1]
    assert asked(built(1, new_views=1), is_final=True) == [1]
    assert asked(built(1), is_final=True) == []


@pytest.mark.parametrize(
    ("size", "lost", "is_renewed"), [(3.0, 0, True), (0.3, 0, True), (1.0, 0, False), (1.0, 1, True), (-1.0, 0, True)]
)
def test_a_shape_that_fits_what_was_seen_since_is_kept(size, lost, is_renewed):
    known = built(1, new_views=30)
    # A ball with half of the surface inside of it, or one of another size; below 0, layer 4 is no larger than it.
    radius_m = abs(size) * np.median(np.linalg.norm(known.solid.points - [0, 0, 0.1], axis=1))
    place = from_rotation_translation(np.eye(3), np.array([0, 0, 0.1]))
    ball = replace(known.shape.fitted, semi_axes_m=np.full((1, 3), radius_m), world_from_local=place[None])
    state = replace(known.shape_state, asked_points=known.shape_state.asked_points + lost)
    known = replace(
        known, shape=replace(known.shape, fitted=ball, **({"inflated": ball} if size < 0 else {})), shape_state=state
    )
    assert asked(known) == asked(known, is_final=True) == ([1] if is_renewed else [])


def test_the_gain_is_the_share_of_new_views_and_of_new_surface():
    assert shape_requests.gain_of(built(1)) == 0.0
    assert shape_requests.gain_of(built(1, new_views=2)) == pytest.approx(0.5)
    half_known = built(1)
    half_known = replace(
        half_known, shape_state=replace(half_known.shape_state, asked_points=len(half_known.solid.keys) / 1.5)
    )
    assert shape_requests.gain_of(half_known) == pytest.approx(0.5)
    assert shape_requests.gain_of(seen(1)) > shape_requests.gain_of(built(1, new_views=1000))


def test_surface_that_is_gone_counts_twice():
    shrunk = built(1)
    asked_points = round(len(shrunk.solid.keys) / 0.8)
    shrunk = replace(shrunk, shape_state=replace(shrunk.shape_state, asked_points=asked_points))
    assert shape_requests.gain_of(shrunk) == pytest.approx(0.4, abs=0.01)
    assert asked(shrunk, is_final=True) == [1]


def test_objects_without_views_and_failed_ones_come_at_the_end():
    assert asked(seen(1, num_views=0), is_final=True) == [1]
    assert asked(failed(seen(1), failures=1)) == [1]
    assert asked(failed(seen(1), failures=2)) == []
    assert asked(failed(seen(1), failures=2), is_final=True) == []


def test_a_request_has_the_best_view_first_and_is_remembered():
    bare = seen(1, num_views=3)
    best = replace(bare.views[1], score=0.5)
    known = replace(bare, best_view=best, coverage=tuple((i, best if i == 1 else v) for i, v in bare.coverage))
    request = shape_requests.shape_request(known, ticket=8, support_z_m=0.7, due_ns=5)
    assert [view.frame_index for view in request.views] == [11, 10, 12]
    assert (request.ticket, request.object_id, request.support_z_m, request.due_ns) == (8, 1, 0.7, 5)
    assert len(request.points_world) == len(request.colors) == len(known.solid.keys)
    state = shape_requests.state_of_request(failed(known, 1), 8, 3, is_replacement=True)
    assert (state.open_ticket, state.asked_clock_ns, state.asked_score, state.failures) == (8, 3, 0.5, 1)
    assert set(state.asked_views) == {view.name for view in known.views}
    assert state.is_replacement


KINDS = ("seen", "seen more", "built", "built anew", "scored", "failed", "job", "gone")
CHANGES = st.lists(st.tuples(st.integers(1, 5), st.sampled_from(KINDS), st.integers(0, 9)), min_size=1, max_size=25)


def changed(track_id, kind, seconds):
    match kind:
        case "seen":
            return seen(track_id)
        case "seen more":
            return seen(track_id, num_views=5)
        case "built":
            return built(track_id, new_views=3, asked_s=seconds)
        case "built anew":
            return built(track_id, new_views=30, asked_s=seconds)
        case "scored":
            return scored(built(track_id, new_views=3), 1.0 + seconds)
        case "failed":
            return failed(seen(track_id), seconds % 3)
        case "job":
            bare = seen(track_id)
            return replace(bare, shape_state=replace(bare.shape_state, open_ticket=seconds))
    return None


@settings(max_examples=40, deadline=None)
@given(CHANGES)
def test_the_next_requests_are_those_of_all_tracks(changes):
    table, elsewhere, wishes = TrackTable(), TrackTable(), ShapeWishes()
    for i, (track_id, kind, seconds) in enumerate(changes):
        track = changed(track_id, kind, seconds)
        if track is not None:
            table[track_id] = track
        else:
            table.pop(track_id, None)
        if i % 11 == 10:
            table = TrackTable(dict(table))
        clock_ns = seconds * SECOND_NS
        wishes.follow(table, elsewhere, CONFIG)
        of_all = shape_requests.next_requests(table, wishes.num_open, clock_ns, is_final=False, config=CONFIG)
        assert wishes.next_wanted(table, clock_ns, CONFIG) == of_all
