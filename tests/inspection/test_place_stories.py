from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.errors import InputError, MapFolderError
from hickory_stream.evaluation.why_text import place_text
from hickory_stream.inspection.keyframe_labels import NO_DEPTH, STRUCTURE
from hickory_stream.inspection.pixel_history import check_pixel, place_by_depth, place_in_keyframe
from hickory_stream.inspection.point_history import PlaceStory
from hickory_stream.inspection.point_sighting import sighting_of
from hickory_stream.inspection.track_history import track_story
from hickory_stream.map_folder.history.track_histories import TrackHistories
from hickory_stream.records import Decision
from tests.engine.snapshot_fixtures import placed
from tests.inspection.keyframe_fixtures import (
    CAMERA,
    ON_THING,
    ON_WALL,
    REJECTED,
    THING_M,
    WALL_M,
    WITHOUT_DEPTH,
    a_keyframe,
    point_at,
)


def seen(pixel, depth_m, *, shift_m=(0, 0, 0)):
    """What the keyframe took the place for that is so far along a pixel's ray; its mask went to #5."""
    book = TrackHistories()
    book.add(7, [Decision(kind="create", object_id=5, text="", observation_index=0)])
    keyframe = a_keyframe(map_from_odometry=placed(*shift_m))
    return sighting_of(keyframe, point_at(pixel, depth_m) + shift_m, book)


@pytest.mark.parametrize(
    ("pixel", "depth_m", "text"),
    [
        (ON_THING, THING_M, "in a mask that went to #5"),
        (ON_THING, 3.0, "hidden by #5"),
        (ON_THING, 1.0, "looked through: what is seen there lies behind"),
        (ON_WALL, WALL_M, "taken for structure"),
        (ON_WALL, 6.0, "hidden by structure"),
        (ON_WALL, 2.0, "looked through: what is seen there lies behind"),
        (REJECTED, WALL_M, "its mask was rejected: too few points"),
        (WITHOUT_DEPTH, 2.0, "no depth there"),
    ],
)
def test_a_place_is_what_depth_and_masks_say_of_it(pixel, depth_m, text):
    sighting = seen(pixel, depth_m)
    assert (sighting.frame, sighting.keyframe, sighting.text) == (7, 2, text)
    assert sighting.pixel == pixel
    assert sighting.distance_m == pytest.approx(np.linalg.norm(point_at(pixel, depth_m)))
    assert (sighting.track_id == 5) == (sighting.where == "mask")


def test_a_place_is_looked_for_in_its_placed_submap_and_image():
    assert seen((80.0, 24.0), 2.0) is None
    assert seen(ON_THING, -2.0) is None
    moved = seen(ON_THING, THING_M, shift_m=(5.0, 1.0, 0.0))
    assert moved == seen(ON_THING, THING_M)


def test_a_pixels_place_is_its_masks_point_its_depth_or_none():
    assert place_in_keyframe(a_keyframe(), ON_THING, 1) == pytest.approx(point_at(ON_THING, THING_M), abs=1e-6)
    place = place_in_keyframe(a_keyframe(map_from_odometry=placed(5, 0, 0)), ON_WALL, STRUCTURE)
    assert place == pytest.approx(point_at(ON_WALL, WALL_M) + np.float64([5, 0, 0]))
    assert place_in_keyframe(a_keyframe(), WITHOUT_DEPTH, NO_DEPTH) is None


def test_a_journal_without_depth_is_refused():
    keyframe = a_keyframe()
    with pytest.raises(MapFolderError, match="no depth of frame 7: play the log again"):
        place_in_keyframe(replace(keyframe, observed=replace(keyframe.observed, coarse=None)), ON_WALL, STRUCTURE)


@pytest.mark.parametrize("nothing", [np.nan, 0.0, np.inf])
def test_the_depth_of_a_log_gives_a_place_where_there_is_any(nothing):
    depth_m = np.full((48, 64), nothing, dtype=np.float32)
    depth_m[24, 32] = 1.5
    place = place_by_depth(depth_m, (32.2, 23.9), CAMERA, placed(0, 0, 1))
    assert place == pytest.approx(point_at((32.2, 23.9), 1.5) + np.float64([0, 0, 1]))
    assert place_by_depth(depth_m, ON_WALL, CAMERA, np.eye(4)) is None


@pytest.mark.parametrize("pixel", [(-1.0, 0.0), (64.0, 0.0), (0.0, 47.5), (float("nan"), 1.0)])
def test_a_pixel_that_is_not_in_the_image_is_refused(pixel):
    check_pixel((63.0, 47.0), CAMERA)
    with pytest.raises(InputError, match="expected a column of 0 to 63 and a row of 0 to 47"):
        check_pixel(pixel, CAMERA)


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
