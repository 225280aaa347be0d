from dataclasses import replace
from hypothesis import given, settings
from hypothesis import strategies as st
from hickory_stream.mapping.derived import ShapeWishes
from hickory_stream.mapping.entities.track_table import TrackTable
from hickory_stream.mapping.rules.shape_requests import next_requests
from tests.mapping.mapping_fixtures import SECOND_NS
from tests.mapping.rules.test_requests import CONFIG, built, failed, scored, seen

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
        of_all = next_requests(table, wishes.num_open, clock_ns, is_final=False, config=CONFIG)
        assert wishes.next_wanted(table, clock_ns, CONFIG) == of_all
