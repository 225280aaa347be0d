from dataclasses import replace
from hickory_stream.mapping.derived import ViewUse
from hickory_stream.mapping.entities.track_table import TrackTable
from tests.mapping.mapping_fixtures import box_surface, track, view


def test_a_view_placed_before_counting_is_unused():
    bare = track(1, box_surface((0, 0, 0.1)))
    first, second, third = (view(k) for k in (1, 2, 3))
    tracks, elsewhere, use = TrackTable({1: replace(bare, best_view=first)}), TrackTable({}), ViewUse()
    kept = {first.name}
    assert use.unused(tracks, elsewhere, {}, {}, kept) == []
    for better in (second, third):
        tracks[1] = replace(bare, best_view=better)
        kept.add(better.name)
        use.ask_for(better.name)
    assert use.unused(tracks, elsewhere, {}, {}, kept) == sorted([first.name, second.name])
    assert use.unused(tracks, elsewhere, {}, {}, {third.name}) == []
