from hickory_stream.map_folder.history.track_histories import TrackHistories
from hickory_stream.records import Decision


def told(kind, object_id, text="", **more):
    return Decision(kind=kind, object_id=object_id, text=text, **more)


def test_a_track_is_followed_through_every_merge():
    book = TrackHistories()
    book.add(10, [told("create", i, "mask: new", observation_index=i) for i in (1, 2, 3)])
    book.add(20, [told("merge", 2, "#3 is the same: seen as one", other_id=3)])
    assert (book.final(3), book.final(2), book.final(1)) == (2, 2, 1)
    book.add(30, [told("merge", 1, "#2 is the same: they touch", other_id=2)])
    assert book.final(3) == book.final(2) == 1
    gone = book.by_id[3].ending
    assert (gone.kind, gone.frame, gone.into, gone.text) == ("merged", 20, 2, "seen as one")
    book.add(None, [told("drop", 1, "never confirmed, after 1 sightings", cause="never confirmed")])
    assert book.final(3) is None
    last = book.last(3)
    assert (last.id, last.ending.cause, last.ending.frame) == (1, "never confirmed", None)


def test_masks_are_those_of_the_track_that_they_went_to_last():
    book = TrackHistories()
    book.add(1, [told("create", 5, "mask: new", observation_index=0)])
    book.add(2, [told("associate", 5, "IoU 0.9", observation_index=4)])
    part, again = ((5, "as a part"), (6, "its mask shows what was a part of #5"))
    split = told("split", 6, "seen apart from #5 in 6 keyframes", other_id=5)
    book.add(3, [told("associate", *part, observation_index=2), split, told("associate", *again, observation_index=2)])
    assert book.by_id[5].frames == [1, 2]
    assert book.by_id[6].frames == [3]
    assert (book.home(2, 4), book.home(3, 2), book.home(9, 9)) == (5, 6, None)
    assert "split off #5" in book.by_id[6].born.text


def test_what_is_about_no_object_is_in_no_history():
    book = TrackHistories()
    book.add(1, [told("reject", None, "mask: 3 points"), told("time_jump", None, "loop: stamps jumped")])
    assert (book.by_id, book.final(1), book.last(1)) == ({}, None, None)
