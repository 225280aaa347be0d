from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.errors import InputError, MapFolderError
from hickory_stream.inspection.keyframe_labels import NO_DEPTH, STRUCTURE
from hickory_stream.inspection.pixel_history import check_pixel, place_by_depth, place_in_keyframe
from tests.engine.snapshot_fixtures import placed
from tests.inspection.keyframe_fixtures import (
    CAMERA,
    ON_THING,
    ON_WALL,
    THING_M,
    WALL_M,
    WITHOUT_DEPTH,
    a_keyframe,
    point_at,
)


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
