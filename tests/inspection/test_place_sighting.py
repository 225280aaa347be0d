import numpy as np
import pytest
from hickory_stream.inspection.point_sighting import sighting_of
from hickory_stream.map_folder.history.track_histories import TrackHistories
from hickory_stream.records import Decision
from tests.engine.snapshot_fixtures import placed
from tests.inspection.keyframe_fixtures import (
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
    assert moved is not None
    assert moved == seen(ON_THING, THING_M)
