from hickory_stream.evaluation.why_text import place_text
from hickory_stream.inspection.point_history import PlaceStory
from hickory_stream.inspection.track_history import track_story
from hickory_stream.map_folder.history.track_histories import TrackHistories
from hickory_stream.records import Decision


def test_a_change_of_mind_is_told_in_the_order_of_frames():
    book = TrackHistories()
    book.add(10, [Decision(kind="create", object_id=4, text="mask: new", observation_index=0)])
    book.add(14, [Decision(kind="room", object_id=4, text="set aside as part of the room after 4 sightings: a slab")])
    book.add(30, [Decision(kind="room", object_id=4, text="an object after all, after 9 sightings: its side was seen")])
    story = track_story(book.by_id[4], book.final(4))
    assert story.changes == (
        "in frame 14 set aside as part of the room after 4 sightings: a slab",
        "in frame 30 an object after all, after 9 sightings: its side was seen",
    )
    place = PlaceStory(
        point_m=(0.0, 0.0, 0.0), asked=None, verdict="in object #4", objects=(), num_keyframes=3, num_looking=3,
        tracks=(story,), stretches=(), sightings=(),
    )  # fmt: skip
    text = " ".join(place_text(place).split())
    assert "; ".join(("seen in 1 keyframe", *story.changes, "in the map")) in text


def test_a_track_never_held_for_the_room_has_no_changes():
    book = TrackHistories()
    book.add(1, [Decision(kind="create", object_id=4, text="mask: new", observation_index=0)])
    book.add(2, [Decision(kind="phase", object_id=4, text="tentative -> active after 4 sightings")])
    assert track_story(book.by_id[4], 4).changes == ()
