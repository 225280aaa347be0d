import numpy as np
import pytest
from scipy import ndimage
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.depth_sensor import DepthSensor
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.shapes.reconstruct.completion import FREE, SOLID, solid_of
from hickory_stream.shapes.reconstruct.meshing import extract, surface_field
from hickory_stream.shapes.reconstruct.symmetry import half_turn_of
from hickory_stream.shapes.reconstruct.tsdf import DepthView, Evidence, VoxelGrid, gaussian_blurred

INNER = (slice(3, 17), slice(3, 17), slice(3, 17))


def seen_front(top_depth):
    """A block of which the front was seen, and so many layers of the top behind it."""
    states = np.zeros((20, 20, 20), np.uint8)
    states[:, :3, :] = FREE
    states[:, :, 17:] = FREE
    states[3:17, 3:5, 3:17] = SOLID
    states[3:17, 5 : 5 + top_depth, 15:17] = SOLID
    return states


def test_a_front_alone_ends_in_a_closing_face():
    solid = solid_of(seen_front(0), INNER, None, 0)
    assert solid[INNER][:, :2].mean() > 0.9
    assert not solid[:, 7:].any()


def test_front_and_top_continue_to_their_own_edges():
    solid = solid_of(seen_front(8), INNER, None, 0)
    assert solid[4:16, 4:12, 4:16].mean() > 0.95
    assert not solid[:, 14:].any()
    assert not solid[:, :3].any()


def test_a_plate_is_as_thick_as_its_edge():
    states = seen_front(10)
    states[:, 3:5, 3:10] = FREE
    solid = solid_of(states, INNER, None, 0)
    assert solid[5:15, 5:14, 12:15].mean() > 0.95
    assert not solid[5:15, 5:14, :10].any()


def test_a_sloping_front_has_no_wedge_behind_it():
    states = np.zeros((20, 20, 20), np.uint8)
    for z in range(3, 17):
        y = 3 + (z - 3) // 3
        states[:, :y, z] = FREE
        states[3:17, y : y + 2, z] = SOLID
    states[:, :, 17:] = FREE
    assert solid_of(states, INNER, None, 0).sum() < 1.3 * (states == SOLID).sum()


def test_seen_free_space_is_never_filled():
    states = seen_front(10)
    states[3:10, 5:16, 3:15] = FREE
    assert not (solid_of(states, INNER, None, 0) & (states == FREE)).any()


def seen_bed():
    """A slab over the support, layer 3: its sides and top are seen, and free space before and a bit under it."""
    states = np.zeros((40, 40, 30), np.uint8)
    states[:, :4, 3:] = FREE
    states[5:35, 4:35, 20:] = FREE
    states[5:35, 4, 9:20] = SOLID
    states[5:35, 4:35, 19] = SOLID
    states[5, 4:35, 9:20] = states[34, 4:35, 9:20] = SOLID
    states[:, 4:7, 3:9] = FREE
    states[5:8, :, 3:9] = states[32:35, :, 3:9] = FREE
    states[:5] = states[35:] = FREE
    for x in (5, 33):
        states[x : x + 2, 4:6, 3:9] = SOLID
    return states


BED = (slice(5, 35), slice(4, 35), slice(3, 20))


def test_nothing_is_filled_under_a_bed_and_its_feet_stay():
    solid = solid_of(seen_bed(), BED, 3, 3)
    assert not solid[10:30, 10:30, 3:8].any()
    assert solid[10:30, 10:30, 10:19].all()
    assert solid[5:7, 4:6, 3:9].all()


def test_sides_that_reach_the_support_are_filled_down_to_it():
    states = seen_bed()
    states[5:35, 4:35, 3:9] = 0
    states[5:35, 4, 3:9] = states[5, 4:35, 3:9] = states[34, 4:35, 3:9] = SOLID
    assert solid_of(states, BED, 3, 3)[12:28, 12:28, 3:8].mean() > 0.6


def test_a_gap_that_no_view_saw_is_bridged_to_the_support():
    states = seen_bed()
    states[:, :, 3:9] = 0
    assert solid_of(states, BED, 3, 6)[12:28, 12:28, 3:8].mean() > 0.9


@pytest.mark.parametrize("at_side", [False, True])
def test_the_surface_is_exact_also_at_the_side_of_its_block(at_side):
    solid = np.zeros((40, 36, 34), dtype=bool)
    first = 0 if at_side else 5
    solid[6:34, first:30, 5:29] = True
    nothing = np.zeros(solid.shape, np.float32)
    evidence = Evidence(distance=nothing, near=nothing, free=nothing)
    grid = VoxelGrid(world_from_grid=np.eye(4), voxel_m=0.01, shape=solid.shape)
    vertices, faces = extract(surface_field(solid, evidence), grid)
    expected_vertices, expected_faces = extract(_field_of_exact_distances(solid), grid)
    np.testing.assert_array_equal(faces, expected_faces)
    np.testing.assert_array_equal(vertices, expected_vertices)


def _field_of_exact_distances(solid):
    distance = ndimage.distance_transform_edt(~solid) - ndimage.distance_transform_edt(solid)
    smooth = gaussian_blurred((distance - np.sign(distance) * 0.5).astype(np.float32), 1.0, mode="nearest")
    magnitude = np.where((smooth < 0) != solid, 0.1, np.maximum(np.abs(smooth), 1e-3))
    return np.where(solid, -magnitude, magnitude).astype(np.float32)


CAMERA_WORLD = np.array([0.0, 0.0, 0.3])
AHEAD = np.array([2.0, 0.4])


def extruded(front, noise_m=0.0):
    """Return points of a front, given across and ahead of the middle, at heights of up to 0.3 m."""
    forward = AHEAD / np.linalg.norm(AHEAD)
    across = np.array([-forward[1], forward[0]])
    plane = AHEAD + front[:, :1] * across + front[:, 1:] * forward
    points = np.concatenate([np.column_stack([plane, np.full(len(plane), z)]) for z in np.linspace(0, 0.3, 12)])
    return points + np.random.default_rng(3).normal(size=points.shape) * noise_m


def arc(radius):
    angles = np.linspace(-np.pi / 2, np.pi / 2, 80)
    return radius * np.stack([np.sin(angles), -np.cos(angles)], axis=1)


@pytest.mark.parametrize("noise_m", [0.0, 0.005])
@pytest.mark.parametrize("radius", [0.04, 0.15])
def test_an_arc_is_turned_about_its_middle(radius, noise_m):
    turn = half_turn_of(extruded(arc(radius), noise_m), CAMERA_WORLD, [], 0.01)
    assert np.linalg.det(turn[:3, :3]) == pytest.approx(1)
    axis = turn[:2, 3] / 2
    assert np.linalg.norm(axis - AHEAD) < 0.12 * radius + 2 * noise_m


@pytest.mark.parametrize("yaw_deg", [0, 10, 25, 45])
def test_the_front_of_a_box_is_not_round(yaw_deg):
    yaw = np.deg2rad(yaw_deg)
    side = np.linspace(-0.15, 0.15, 60)
    faces = np.concatenate([np.stack([side, -0.15 + 0 * side], axis=1), np.stack([-0.15 + 0 * side, side], axis=1)])
    turned = faces @ np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    front = turned if yaw_deg else faces[:60]
    assert half_turn_of(extruded(front, 0.002), CAMERA_WORLD, [], 0.01) is None


def test_what_was_seen_through_behind_is_not_turned():
    points = extruded(arc(0.15))
    # From the side a camera sees a wall far behind where the turned half would be.
    pose = np.eye(4)
    pose[:3, :3] = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
    pose[:3, 3] = [AHEAD[0] + 0.15, AHEAD[1] - 1.5, 0.15]
    camera = Camera(width=160, height=120, fx=130, fy=130, cx=79.5, cy=59.5)
    view = DepthView(
        law=DepthSensor().law, depth_m=np.full((120, 160), 4.0, np.float32), mask=np.zeros((120, 160), bool),
        camera=camera, camera_from_world=invert(pose),
    )  # fmt: skip
    assert (apply(view.camera_from_world, points)[:, 2] > 0.5).all()
    assert half_turn_of(points, CAMERA_WORLD, [view], 0.01) is None


def test_points_above_the_camera_have_no_front():
    assert half_turn_of(np.array([[0.0, 0.0, 1.0]] * 30), CAMERA_WORLD, [], 0.01) is None
