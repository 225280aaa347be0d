import numpy as np
import pytest
from hickory_stream.geometry.voxels import keys_of_points
from hickory_stream.mapping.entities.observed_space import add, empty_space
from hickory_stream.mapping.rules.support_graph import attachment_of
from tests.mapping.mapping_fixtures import box_surface, space, track

POT = track(1, box_surface((0.0, 0.0, 0.3), (0.3, 0.3, 0.6)))
BRANCH = track(2, box_surface((0.32, 0.0, 0.75), (0.16, 0.12, 0.12)))


def room(*, free=True, wall_x_m=None):
    """Return a room with its floor at 0; with the space around the branch seen free, with a wall."""
    steps = np.arange(-1.0, 1.0, 0.025)
    grid = np.stack(np.meshgrid(steps, steps, np.arange(0.1, 1.5, 0.025), indexing="ij"), axis=-1).reshape(-1, 3)
    seen = space(
        free=keys_of_points(grid.astype(np.float32), 0.05) if free else None,
        structure=keys_of_points(grid[np.abs(grid[:, 0] - wall_x_m) < 0.02].astype(np.float32), 0.05)
        if wall_x_m is not None
        else None,
        floor_z_m=0.0,
    )
    state = empty_space(0.05)
    for _ in range(2):
        state = add(state, seen)
    return state


def test_a_branch_in_the_air_belongs_to_the_nearest_thing():
    host = attachment_of(BRANCH, [POT, BRANCH, track(3, box_surface((0.8, 0.0, 0.3), (0.2, 0.2, 0.6)))], room())
    assert host.id == POT.id


@pytest.mark.parametrize(
    ("others", "state"),
    [
        ([POT, track(3, box_surface((0.32, 0.0, 0.34), (0.3, 0.3, 0.68)))], room()),
        ([POT], room(wall_x_m=0.42)),
        ([POT], room(free=False)),
        ([track(3, box_surface((0.8, 0.0, 0.3), (0.2, 0.2, 0.6)))], room()),
    ],
    ids=["it stands on something", "it hangs on a wall", "nobody saw what is below", "nothing is near"],
)
def test_a_supported_or_lone_track_stays_itself(others, state):
    assert attachment_of(BRANCH, [*others, BRANCH], state) is None


def test_what_is_near_the_floor_is_supported():
    low = track(2, box_surface((0.3, 0.0, 0.2), (0.2, 0.2, 0.1)))
    assert attachment_of(low, [POT, low], room()) is None
