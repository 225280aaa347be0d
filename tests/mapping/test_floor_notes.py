import numpy as np
import pytest
from hickory_stream.geometry.voxels import keys_of_points, sorted_unique
from hickory_stream.mapping.floor_warnings import floor_warnings, tilt_warning
from hickory_stream.records import MapSnapshot, ObservedSpace, Submap

VOXEL_M = 0.05


def space_of(points, floor_z_m):
    return ObservedSpace(
        voxel_m=VOXEL_M,
        free=sorted_unique(keys_of_points(np.array([[0.0, 0.0, 1.0]]), VOXEL_M)),
        structure=sorted_unique(keys_of_points(points, VOXEL_M)),
        floor_z_m=floor_z_m,
    )


def plane(tilt_deg=0.0, uphill_deg=0.0, half_m=2.5):
    x, y = np.meshgrid(np.arange(-half_m, half_m, 0.02), np.arange(-half_m, half_m, 0.02))
    along = x * np.cos(np.radians(uphill_deg)) + y * np.sin(np.radians(uphill_deg))
    return np.stack([x, y, np.tan(np.radians(tilt_deg)) * along], axis=-1).reshape(-1, 3)


def lifted(by_m, half_m=2.5):
    return plane(half_m=half_m) + np.array([0.0, 0.0, by_m])


def wall(x_m):
    y, z = np.meshgrid(np.arange(-2.5, 2.5, 0.02), np.arange(-0.1, 2.4, 0.02))
    return np.stack([np.full(y.shape, x_m), y, z], axis=-1).reshape(-1, 3)


def snapshot(*spaces, world_from_submap=None):
    place = np.eye(4) if world_from_submap is None else world_from_submap
    submaps = tuple(Submap(id=i, world_from_submap=place, observed_space=space) for i, space in enumerate(spaces))
    return MapSnapshot(revision=1, stamp_ns=1, submaps=submaps, objects=())


def test_a_level_floor_between_walls_is_nothing_to_speak_of():
    assert floor_warnings(snapshot(space_of(np.concatenate([plane(), wall(2.4), wall(-2.4)]), 0.0))) == ()


@pytest.mark.parametrize(("tilt_deg", "uphill_deg"), [(1.5, 0.0), (2.0, 90.0), (3.0, -150.0), (5.0, 45.0)])
def test_the_tilt_of_a_floor_is_told_to_a_tenth_of_a_degree(tilt_deg, uphill_deg):
    note = tilt_warning(space_of(np.concatenate([plane(tilt_deg, uphill_deg), wall(2.4)]), 0.0))
    words = note.split()
    assert float(words[words.index("by") + 1]) == pytest.approx(tilt_deg, abs=0.2)
    assert float(words[words.index("towards") + 1]) == pytest.approx(uphill_deg, abs=4.0)


def test_ground_that_rolls_or_has_a_step_has_no_tilt():
    rolling = plane()
    rolling[:, 2] = 0.15 * np.sin(2.5 * rolling[:, 0]) * np.cos(2.0 * rolling[:, 1])
    assert tilt_warning(space_of(rolling, 0.0)) is None
    step = plane()
    step[step[:, 0] > 0, 2] += 0.2
    assert tilt_warning(space_of(step, 0.0)) is None


def test_a_map_without_a_floor_says_so_and_an_empty_one_does_not():
    (note,) = floor_warnings(snapshot(space_of(wall(1.0), None)))
    assert "no floor was seen" in note
    nothing = np.empty(0, dtype=np.int64)
    assert (
        floor_warnings(snapshot(ObservedSpace(voxel_m=VOXEL_M, free=nothing, structure=nothing, floor_z_m=None))) == ()
    )


def test_a_floor_as_small_as_a_table_may_be_one():
    (note,) = floor_warnings(snapshot(space_of(lifted(0.7, half_m=0.5), 0.7)))
    assert "at z = 0.70 m, has an area of 1.0 m2 only and may be a table" in note


def test_floors_of_two_storeys_are_listed_and_a_step_is_not():
    two = snapshot(space_of(plane(), 0.0), space_of(lifted(3.0), 3.0), space_of(lifted(0.2), 0.2))
    (note,) = floor_warnings(two)
    assert "2 levels, at z = 0.00 m, 3.00 m" in note
    assert floor_warnings(snapshot(space_of(plane(), 0.0), space_of(lifted(0.2), 0.2))) == ()
