import numpy as np
import pytest
from hickory_stream.changes.records import Evidence, MapChanges, ObjectChange, Verdict
from hickory_stream.changes.stationarity import (
    Stationarity,
    StayCount,
    after_comparison,
    read_stationarity,
    write_stationarity,
)
from hickory_stream.errors import InputError

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


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        '{"version": 1}',
        '{"version": 1, "map_digest": "a", "objects": [{"id": 1, "stayed": NaN, "moved": 0}]}',
        '{"version": 1, "map_digest": "a", "objects": [{"id": 1, "stayed": -1, "moved": 0}]}',
        '{"version": 2, "map_digest": "a", "objects": []}',
        "[" * 100_000,
    ],
)
def test_what_is_no_such_file_is_refused(text, tmp_path):
    (tmp_path / "bad.json").write_text(text)
    with pytest.raises(InputError, match="diff"):
        read_stationarity(tmp_path / "bad.json", "a")
    with pytest.raises(InputError, match="cannot read"):
        read_stationarity(tmp_path / "none.json", "a")
