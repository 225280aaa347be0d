from dataclasses import replace
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hickory_stream.mapping.entities.track import touching
from hickory_stream.mapping.entities.track_table import TrackTable
from tests.mapping.mapping_fixtures import box_surface, track

CHANGES = st.lists(
    st.tuples(st.integers(1, 6), st.sampled_from(["put", "drop"]), st.integers(-3, 3), st.integers(0, 5)), max_size=25
)


def at(track_id, x_m, seen_ns):
    made = track(track_id, box_surface((x_m, 1.9, 0.2)))
    return replace(made, seen_clock_ns=seen_ns, merged_ids=(100 + track_id,))


@settings(max_examples=30, deadline=None)
@given(CHANGES, CHANGES)
def test_it_finds_what_a_search_through_all_tracks_finds(first, later):
    table, plain = TrackTable(), {}
    marks = []
    for changes in (first, later):
        marks.append((table.now, dict(plain)))
        for track_id, what, x, seen_ns in changes:
            if what == "put":
                table[track_id] = plain[track_id] = at(track_id, 2.0 * x, seen_ns)
            elif track_id in plain:
                del plain[track_id]
                table.pop(track_id)
    ordered = [plain[i] for i in sorted(plain)]
    assert table.ordered() == ordered
    for x in (-6.2, -0.4, 1.9, 2.0):
        bounds = np.array([[x, 1.7, 0.0], [x + 0.4, 2.1, 0.1]], np.float32)
        for slack_m in (0.0, 0.03, 2.5):
            assert table.touching(bounds, slack_m) == touching(bounds, ordered, slack_m)
    assert sorted(table.last_seen(1, 4)) == [i for i in sorted(plain) if 1 < plain[i].seen_clock_ns <= 4]
    assert [table.host_of(100 + i) for i in range(1, 7)] == [i if i in plain else None for i in range(1, 7)]
    for mark, before in marks:
        changed = {i for i in before.keys() | plain.keys() if before.get(i) is not plain.get(i)}
        assert changed <= set(table.changed_since(mark))
    assert table.changed_since(table.now) == []
    assert table.changed_since(None) == sorted(plain)
    assert table.changed_since(TrackTable(plain).now) == sorted(plain)
