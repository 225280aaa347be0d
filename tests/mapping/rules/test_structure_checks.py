from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.geometry.voxels import keys_of_points
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.entities.observed_space import SpaceState, add, empty_space
from hickory_stream.mapping.entities.track import Track
from hickory_stream.mapping.rules.structure_checks import is_seen_through, points_in_wall, why_structure
from hickory_stream.records import Phase
from tests.mapping.mapping_fixtures import SECOND_NS, box_surface, space, track

CONFIG = MappingConfig()
SPACE_M = CONFIG.voxels.space_m
BOX = box_surface((0.0, 0.0, 0.5), (0.4, 0.4, 0.4))


def space_with(points: np.ndarray, num_keyframes: int) -> SpaceState:
    """Space in which so many keyframes saw structure at points."""
    state = empty_space(SPACE_M)
    for _ in range(num_keyframes):
        state = add(state, space(structure=keys_of_points(points, SPACE_M), floor_z_m=0.0))
    return state


def share_of_box(share: float) -> np.ndarray:
    """The lowest points of the box, about so many of them."""
    return BOX[np.argsort(BOX[:, 2], kind="stable")][: round(share * len(BOX))]


@pytest.mark.parametrize(("share", "is_told"), [(0.02, False), (0.5, True), (1.0, False)])
def test_between_a_seam_and_all_of_a_track_lies_in_a_wall(share, is_told):
    in_wall = points_in_wall(track(1, BOX, sightings=1), space_with(share_of_box(share), 6))
    assert (in_wall is not None) == is_told
    if in_wall is not None:
        cloud = track(1, BOX, sightings=1).cloud
        assert in_wall.shape == cloud.keys.shape
        assert cloud.points[in_wall, 2].mean() < cloud.points[~in_wall, 2].mean()


def test_a_track_seen_more_often_than_the_wall_stays():
    state = space_with(share_of_box(0.5), 6)
    assert points_in_wall(track(1, BOX, sightings=2), state) is not None
    assert points_in_wall(track(1, BOX, sightings=3), state) is None


def test_too_few_keyframes_make_no_wall():
    assert points_in_wall(track(1, BOX, sightings=1), space_with(share_of_box(0.5), 3)) is None


def test_what_rays_passed_for_the_most_part_was_looked_through():
    keys = np.unique(keys_of_points(BOX, SPACE_M))
    assert is_seen_through(track(1, BOX), keys, CONFIG)
    assert not is_seen_through(track(1, BOX), keys[: len(keys) // 2], CONFIG)


def test_too_large_for_a_thing_is_structure_and_says_how_large():
    wide = track(1, box_surface((0, 0, 1.5), (3.2, 3.0, 0.4)))
    assert why_structure(wide, empty_space(SPACE_M), 0, CONFIG) == "3.2 x 3.0 x 0.4 m is too large for an object"
    assert why_structure(track(1, BOX), empty_space(SPACE_M), 0, CONFIG) is None


def picture(phase: Phase) -> Track:
    """A picture on the wall at x = 0, last seen at clock 0."""
    return replace(track(1, box_surface((0.02, 0.0, 1.4), (0.04, 0.5, 0.4)), sightings=9), phase=phase)


@pytest.mark.parametrize(
    ("phase", "clock_s", "is_asked"),
    [(Phase.ACTIVE, 0, False), (Phase.ACTIVE, 2, True), (Phase.TENTATIVE, 0, True), (Phase.DORMANT, 9, False)],
)
def test_a_flat_thing_is_compared_with_the_wall_around_it(phase, clock_s, is_asked):
    wall = np.stack(np.meshgrid([0.0], np.arange(-1.5, 1.5, 0.02), np.arange(0, 2.5, 0.02)), axis=-1).reshape(-1, 3)
    reason = why_structure(picture(phase), space_with(wall, 6), clock_s * SECOND_NS, CONFIG)
    assert reason == ("flat or an edge, and the wall goes on around it" if is_asked else None)
