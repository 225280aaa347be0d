import numpy as np
import pytest
from hickory_stream.geometry.voxels import keys_of_points
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.entities.observed_space import add, empty_space
from hickory_stream.mapping.rules.structure_checks import is_seen_through, points_in_wall
from tests.mapping.mapping_fixtures import box_surface, space, track

CONFIG = MappingConfig()
SPACE_M = CONFIG.voxels.space_m
BOX = box_surface((0.0, 0.0, 0.5), (0.4, 0.4, 0.4))


def space_with(points, num_keyframes):
    """Space in which so many keyframes saw structure at points."""
    state = empty_space(SPACE_M)
    for _ in range(num_keyframes):
        state = add(state, space(structure=keys_of_points(points, SPACE_M), floor_z_m=0.0))
    return state


def share_of_box(share):
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


def test_a_wall_needs_more_keyframes_than_the_track_in_it():
    state = space_with(share_of_box(0.5), 6)
    assert points_in_wall(track(1, BOX, sightings=2), state) is not None
    assert points_in_wall(track(1, BOX, sightings=3), state) is None
    assert points_in_wall(track(1, BOX, sightings=1), space_with(share_of_box(0.5), 3)) is None


def test_what_rays_passed_for_the_most_part_was_looked_through():
    keys = np.unique(keys_of_points(BOX, SPACE_M))
    assert is_seen_through(track(1, BOX), keys, CONFIG)
    assert not is_seen_through(track(1, BOX), keys[: len(keys) // 2], CONFIG)
