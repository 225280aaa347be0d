from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.changes import evidence
from hickory_stream.changes.compare import compare_maps, probability_changed
from hickory_stream.changes.evidence import evidence_at, seen_places
from hickory_stream.changes.records import (
    ChangesConfig,
    Evidence,
    MapChanges,
    ObjectChange,
    Verdict,
    evidence_text,
    sentence,
)
from hickory_stream.changes.stationarity import (
    Stationarity,
    StayCount,
    after_comparison,
    read_stationarity,
    write_stationarity,
)
from hickory_stream.changes.within_run import changes_within_run
from hickory_stream.errors import InputError
from hickory_stream.geometry.rigid import apply, from_rotation_translation, invert, yaw_rotation
from hickory_stream.mapping.entities.rigid_motion import moved_object
from tests.engine.snapshot_fixtures import box_mesh, make_object, placed
from tests.navigation.rooms import seen_room, snapshot

RED, BLUE = (200, 40, 30), (40, 60, 190)
A_FROM_B = from_rotation_translation(yaw_rotation(0.7), np.array([2.0, -1.0, 0.3]))


def crate(object_id, x, y, size=(0.5, 0.4, 0.4), color=RED):
    return make_object(object_id, box_mesh(size, color), placed(x, y, size[2] / 2))


def said(before, after):
    return {(one.id_a, one.id_b): one.verdict for one in compared(before, after).changes}


def compared(before, after):
    """Compare two maps of which the second one has a frame of its own."""
    b_from_a = invert(A_FROM_B)
    objects = tuple(moved_object(item, b_from_a) for item in after.objects)
    submaps = tuple(replace(s, world_from_submap=b_from_a @ s.world_from_submap) for s in after.submaps)
    return compare_maps(before, replace(after, objects=objects, submaps=submaps), A_FROM_B, 0.01)


STAYS, LEAVES, OTHER = crate(1, 1.0, 1.0), crate(2, 1.5, 3.0), crate(3, 4.5, 1.0, (1.0, 0.5, 0.8), BLUE)


@pytest.mark.parametrize("sizes", [((0.3, 0.3, 0.3), (0.3, 0.3, 1.0)), ((0.3, 0.3, 1.0), (0.3, 0.3, 0.3))])
def test_same_colour_and_other_extent_means_exchanged(sizes):
    before, after = (crate(i, 1.0, 1.0, size) for i, size in enumerate(sizes, 1))
    assert said(snapshot(before), snapshot(after)) == {(1, 2): Verdict.EXCHANGED}


def test_what_was_turned_on_the_spot_was_moved():
    long = crate(1, 1.0, 1.0, (1.2, 0.3, 0.6))
    quarter = from_rotation_translation(yaw_rotation(np.pi / 2), np.zeros(3))
    away = from_rotation_translation(np.eye(3), np.array([1.0, 1.0, 0.0]))
    turned = replace(moved_object(long, away @ quarter @ invert(away)), id=2)
    found = compared(snapshot(long), snapshot(turned))
    assert [(one.verdict, one.id_a, one.id_b) for one in found.changes] == [(Verdict.MOVED, 1, 2)]


def test_what_stays_is_still_there_and_what_left_is_gone():
    found = compared(snapshot(STAYS, LEAVES), snapshot(replace(STAYS, id=7)))
    assert {(one.id_a, one.id_b): one.verdict for one in found.changes} == {
        (1, 7): Verdict.STILL_THERE,
        (2, None): Verdict.GONE,
    }
    assert all(one.probability > 0.9 for one in found.changes)
    gone = found.changes[-1]
    assert gone.evidence.free > 0.9
    assert gone.evidence.free + gone.evidence.structure + gone.evidence.objects + gone.evidence.unseen == pytest.approx(
        1
    )


def test_what_nobody_looked_at_is_not_gone_and_not_new():
    dark = seen_room(dark_m=(0.5, 2.5))
    assert said(snapshot(LEAVES), snapshot(OTHER, space=dark))[(2, None)] is Verdict.NOT_SEEN_AGAIN
    assert said(snapshot(OTHER, space=dark), snapshot(LEAVES))[(None, 2)] is Verdict.NOT_SEEN_BEFORE


def test_what_appears_where_there_was_free_space_is_new():
    assert said(snapshot(STAYS), snapshot(STAYS, OTHER)) == {(1, 1): Verdict.STILL_THERE, (None, 3): Verdict.NEW}


@pytest.mark.parametrize(("x", "y"), [(4.5, 3.0), (1.9, 3.0)])
def test_what_stands_elsewhere_has_moved_by_so_much(x, y):
    found = compared(snapshot(STAYS, OTHER, LEAVES), snapshot(STAYS, OTHER, crate(9, x, y)))
    [moved] = [one for one in found.changes if one.verdict is Verdict.MOVED]
    assert (moved.id_a, moved.id_b) == (2, 9)
    assert np.allclose(moved.shift_m, (x - 1.5, y - 3.0, 0.0), atol=0.05)


def test_what_looks_otherwise_in_the_same_place_was_exchanged():
    blue = crate(5, 1.0, 1.0, color=BLUE)
    assert said(snapshot(STAYS), snapshot(blue)) == {(1, 5): Verdict.EXCHANGED}


def test_of_two_alike_objects_neither_is_known_to_have_moved():
    twins = (crate(2, 1.5, 3.0), crate(3, 4.5, 1.0))
    certain = compared(snapshot(twins[0]), snapshot(crate(9, 4.5, 3.0))).changes[0]
    shared = [one for one in compared(snapshot(*twins), snapshot(crate(9, 4.5, 3.0))).changes if one.id_b == 9]
    assert certain.verdict is Verdict.MOVED
    assert shared[0].probability < certain.probability


def test_a_gone_plate_is_gone_and_empty_maps_have_no_changes():
    table = crate(1, 1.5, 3.0, (1.2, 0.8, 0.7), BLUE)
    bowl = make_object(2, box_mesh((0.3, 0.3, 0.2), RED), placed(1.5, 3.0, 0.81))
    assert said(snapshot(table, bowl), snapshot(table))[(2, None)] is Verdict.GONE
    assert compared(snapshot(), snapshot()).changes == ()
    assert said(snapshot(), snapshot(STAYS)) == {(None, 1): Verdict.NEW}


def test_the_probability_of_a_change_follows_bayes_rule():
    def seen(free, objects):
        return Evidence(free=free, structure=0.0, objects=objects, unseen=1 - free - objects, num_clear=100)

    config = ChangesConfig(change_prior=0.2, looks=1.0, reliable=0.9)
    assert probability_changed(seen(0.0, 0.0), config) == pytest.approx(0.2)
    # One look that is right in nine of ten cases: 0.2 * 0.9 / (0.2 * 0.9 + 0.8 * 0.1).
    assert probability_changed(seen(1.0, 0.0), config) == pytest.approx(0.18 / 0.26)
    assert probability_changed(seen(0.0, 1.0), config) == pytest.approx(0.02 / 0.74)


@pytest.mark.parametrize(("free", "unseen", "text"), [
    (0.0, 1.0, "the second map did not see its place"),
    (0.6, 0.4, "the second map saw in its place: 60% free space, 40% of it was not seen"),
    (1.0, 0.0, "the second map saw in its place: 100% free space"),
])  # fmt: skip
def test_the_evidence_says_plainly_what_was_seen(free, unseen, text):
    seen = Evidence(free=free, structure=0.0, objects=0.0, unseen=unseen, num_clear=100)
    change = ObjectChange(
        verdict=Verdict.GONE, id_a=1, id_b=None, probability=0.5, evidence=seen, fixture_probability=0.75
    )
    assert evidence_text(change) == text
    assert sentence(change) == "#1 (fixture 0.75), probability 0.50"


def test_in_a_run_what_is_seen_through_is_gone():
    tall = crate(8, 4.6, 2.9, (0.3, 0.3, 1.2), (240, 240, 240))
    before = snapshot(STAYS, LEAVES, OTHER)
    # The core gives what stands elsewhere a new id.
    after = snapshot(STAYS, crate(9, 3.0, 3.2), tall)
    found = {(one.object_id, one.kind): one for one in changes_within_run(before, after)}
    assert set(found) == {(9, "moved"), (3, "gone"), (8, "new")}
    assert "it was #2" in found[9, "moved"].text
    assert all(one.probability is not None and one.probability > 0.7 for one in found.values())
    assert changes_within_run(before, before) == ()


def test_in_a_run_the_unrevisited_only_dropped_or_appeared():
    dark = seen_room(dark_m=(0.5, 2.5))
    (dropped,) = changes_within_run(snapshot(LEAVES), snapshot(space=dark))
    assert (dropped.kind, dropped.probability) == ("dropped", None)
    (appeared,) = changes_within_run(snapshot(space=dark), snapshot(LEAVES))
    assert (appeared.kind, appeared.probability) == ("appeared", None)


def test_in_a_run_gone_needs_a_place_that_was_seen_through():
    seen_through = snapshot(STAYS, LEAVES)
    dark = seen_room(dark_m=(0.5, 2.5))
    again = replace(STAYS, sightings=STAYS.sightings + 5)
    # The core has not given it up, and its own points lie there still.
    (gone,) = changes_within_run(snapshot(STAYS, LEAVES, space=dark), snapshot(again, LEAVES))
    assert (gone.object_id, gone.kind) == (2, "gone")
    # Nobody looked there; nobody looked there again: what was free before proves nothing.
    assert changes_within_run(snapshot(STAYS, LEAVES, space=dark), snapshot(again, LEAVES, space=dark)) == ()
    assert changes_within_run(seen_through, snapshot(again, LEAVES)) == ()
    (moved,) = changes_within_run(snapshot(STAYS, LEAVES, space=dark), snapshot(again, LEAVES, crate(9, 3.0, 3.2)))
    assert (moved.object_id, moved.kind, moved.was) == (9, "moved", 2)


def test_a_submap_far_away_is_not_asked(monkeypatch):
    room = snapshot(STAYS, LEAVES)
    far = replace(
        room.submaps[0],
        id=room.submaps[-1].id + 1,
        world_from_submap=from_rotation_translation(yaw_rotation(0.3), np.array([100.0, 0.0, 0.0])),
    )
    both = seen_places(room.objects, (*room.submaps, far))
    asked = []
    cells_in = evidence._cells
    monkeypatch.setattr(evidence, "_cells", lambda points, submap: asked.append(submap.id) or cells_in(points, submap))
    points = STAYS.points_world[:50].astype(np.float64)
    found = evidence_at(both, points, 0.02)
    assert far.id not in asked and set(asked) == {submap.id for submap in room.submaps}
    assert found == evidence_at(seen_places(room.objects, room.submaps), points, 0.02)
    # Whichever way it is turned, what it has seen there is found.
    moved = apply(far.world_from_submap, points)
    assert evidence_at(both, moved, 0.02).unseen == evidence_at(seen_places((), room.submaps), points, 0.02).unseen < 1


NOTHING = Evidence(free=0.0, structure=0.0, objects=0.0, unseen=0.0, num_clear=0)


def day(before, *changes):
    made = tuple(
        ObjectChange(verdict=verdict, id_a=a, id_b=b, probability=probability, evidence=NOTHING)
        for verdict, a, b, probability in changes
    )
    return after_comparison(before, MapChanges(a_from_b=np.eye(4), sigma_m=0.01, changes=made))


def test_counts_follow_an_object_and_weigh_verdicts():
    tuesday = day({}, (Verdict.STILL_THERE, 1, 10, 0.9), (Verdict.MOVED, 2, 20, 0.8))
    assert tuesday == {10: StayCount(stayed=0.9, moved=pytest.approx(0.1)), 20: StayCount(moved=0.8)}
    wednesday = day(tuesday, (Verdict.MOVED, 20, 5, 1.0), (Verdict.STILL_THERE, 10, 6, 1.0))
    assert wednesday == {5: StayCount(moved=1.8), 6: StayCount(stayed=1.9, moved=pytest.approx(0.1))}
    # A prior as strong as two comparisons, nine in ten of which find the object where it was.
    assert wednesday[5].probability() == pytest.approx(1.8 / 3.8)
    assert wednesday[6].probability() == pytest.approx(3.7 / 4.0)


def test_one_move_makes_no_object_one_that_tends_to_move():
    once = day({}, (Verdict.MOVED, 1, 1, 1.0))
    twice = day(once, (Verdict.MOVED, 1, 1, 1.0))
    back = day(twice, (Verdict.STILL_THERE, 1, 1, 1.0))
    assert [Stationarity(digest="d", counts=counts).movable() for counts in (once, twice, back)] == [[], [1], []]


def test_an_unseen_object_says_nothing_and_a_new_one_came_once():
    known = {1: StayCount(stayed=3.0)}
    found = day(
        known, (Verdict.NOT_SEEN_BEFORE, None, 4, 0.5), (Verdict.NEW, None, 5, 0.9), (Verdict.EXCHANGED, 1, 6, 0.95),
        (Verdict.GONE, 2, None, 0.9),
    )  # fmt: skip
    assert found == {4: StayCount(), 5: StayCount(moved=0.9), 6: StayCount(moved=0.95)}


def test_a_file_says_what_was_written_and_only_of_its_map(tmp_path):
    known = Stationarity(digest="abc", counts={3: StayCount(stayed=1.25, moved=0.5), 9: StayCount()})
    (tmp_path / "known.json").write_bytes(write_stationarity(known))
    assert read_stationarity(tmp_path / "known.json", "abc") == known
    with pytest.raises(InputError, match="is of a map with the digest abc, this one has xyz"):
        read_stationarity(tmp_path / "known.json", "xyz")


@pytest.mark.parametrize("text", [
    "", "[]", '{"version": 1}', '{"version": 1, "map_digest": "a", "objects": [{"id": 1, "stayed": NaN, "moved": 0}]}',
    '{"version": 1, "map_digest": "a", "objects": [{"id": 1, "stayed": -1, "moved": 0}]}',
    '{"version": 2, "map_digest": "a", "objects": []}', "[" * 100_000,
])  # fmt: skip
def test_what_is_no_such_file_is_refused(text, tmp_path):
    (tmp_path / "bad.json").write_text(text)
    with pytest.raises(InputError, match="diff"):
        read_stationarity(tmp_path / "bad.json", "a")
    with pytest.raises(InputError, match="cannot read"):
        read_stationarity(tmp_path / "none.json", "a")
