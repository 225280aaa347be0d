import math
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection
from scipy.spatial.transform import Rotation
from hickory_stream.geometry.bounds import bounds_of, extent_of
from hickory_stream.geometry.boxes import OrientedBox, box_iou, faced_box, gravity_aligned_box, intersection_volume_m3
from hickory_stream.geometry.rigid import from_rotation_translation
from tests.strategies import oriented_boxes, point_sets, rigid_transforms


def box(center=(0, 0, 0), half=(1, 1, 1), turn_deg=0):
    rotation = Rotation.from_euler("z", turn_deg, degrees=True).as_matrix()
    return OrientedBox(
        world_from_box=from_rotation_translation(rotation, np.array(center)), half_extents_m=np.array(half)
    )


def moved(a, b_from_world):
    return OrientedBox(world_from_box=b_from_world @ a.world_from_box, half_extents_m=a.half_extents_m)


def halfspaces(a):
    """Six rows (n, -h) of the planes n . p <= h of a box."""
    normals = np.concatenate([a.world_from_box[:3, :3].T, -a.world_from_box[:3, :3].T])
    heights = normals @ a.center + np.tile(a.half_extents_m, 2)
    return np.column_stack([normals, -heights])


@pytest.mark.parametrize("offset", [(2, 0, 0), (0, 2, 0), (2, 2, 0), (2, 2, 2), (2, 0.5, -0.3)])
def test_boxes_that_only_touch_share_nothing(offset):
    assert intersection_volume_m3(box(), box(offset)) == 0.0
    assert box_iou(box(), box(offset)) == 0.0


@given(oriented_boxes(), st.integers(0, 2), st.sampled_from([-1.0, 1.0]), st.floats(0.1, 0.9))
def test_faces_that_two_boxes_share_count_once(a, axis, side, share):
    # A slab of `a`, flush with five of its faces.
    half = a.half_extents_m.copy()
    half[axis] *= share
    offset = np.zeros(3)
    offset[axis] = side * (1 - share) * a.half_extents_m[axis]
    slab = OrientedBox(
        world_from_box=a.world_from_box @ from_rotation_translation(np.eye(3), offset), half_extents_m=half
    )
    assert intersection_volume_m3(a, slab) == pytest.approx(share * a.volume_m3, rel=1e-6)


@pytest.mark.parametrize("thickness", [1e-2, 1e-4, 1e-6])
def test_thin_plates_that_cross_share_a_thin_bar(thickness):
    lying, standing = box(half=(1, 1, thickness)), box(half=(1, thickness, 1))
    assert intersection_volume_m3(lying, standing) == pytest.approx(8 * thickness**2, rel=1e-3)


def test_thin_plates_one_above_the_other_share_nothing():
    assert box_iou(box(half=(1, 1, 0.001)), box((0, 0, 0.0021), (1, 1, 0.001), turn_deg=17)) == 0.0


def test_boxes_that_no_face_separates_may_share_nothing():
    # Edge against edge: only the cross product of two edges separates these.
    a = OrientedBox(
        world_from_box=from_rotation_translation(Rotation.from_euler("x", 45, degrees=True).as_matrix(), np.zeros(3)),
        half_extents_m=np.ones(3),
    )
    b = OrientedBox(
        world_from_box=from_rotation_translation(
            Rotation.from_euler("y", 45, degrees=True).as_matrix(), np.array([0, 0, 2 * math.sqrt(2) + 0.01])
        ),
        half_extents_m=np.ones(3),
    )
    assert intersection_volume_m3(a, b) == 0.0


@given(oriented_boxes(), oriented_boxes(), rigid_transforms())
def test_the_iou_is_a_symmetric_share_wherever_the_boxes_are(a, b, b_from_world):
    assert box_iou(a, b) == pytest.approx(box_iou(b, a), abs=1e-8)
    assert 0.0 <= box_iou(a, b) <= 1.0 + 1e-12
    assert box_iou(moved(a, b_from_world), moved(b, b_from_world)) == pytest.approx(box_iou(a, b), abs=1e-7)
    for own in (a, moved(a, b_from_world)):
        assert box_iou(own, own) == pytest.approx(1.0, abs=1e-9)


@given(oriented_boxes(), oriented_boxes())
def test_the_intersection_is_the_polyhedron_of_twelve_planes(a, b):
    planes = np.concatenate([halfspaces(a), halfspaces(b)])
    # The middle of the largest sphere within all planes (Chebyshev centre) is surely inside.
    found = linprog(
        [0, 0, 0, -1], A_ub=np.column_stack([planes[:, :3], np.ones(12)]), b_ub=-planes[:, 3],
        bounds=[(None, None)] * 3 + [(0, None)],
    )  # fmt: skip
    assume(found.status == 0 and found.x[3] > 0.01)
    polyhedron = HalfspaceIntersection(planes, found.x[:3])
    assert intersection_volume_m3(a, b) == pytest.approx(ConvexHull(polyhedron.intersections).volume, rel=1e-6)


def test_half_extents_must_be_positive():
    with pytest.raises(ValueError, match="half extents must be positive"):
        box(half=(1, 0, 1))


@given(oriented_boxes(), st.floats(0, 0.5))
def test_a_grown_box_reaches_further_by_the_margin_on_every_side(a, margin):
    grown = a.grown(margin)
    assert np.allclose(grown.half_extents_m - a.half_extents_m, margin)
    assert grown.contains(a.corners_world()).all() or margin < 1e-12
    assert (a.contains(grown.corners_world(), margin + 1e-9)).all()


@given(oriented_boxes())
def test_the_corners_have_the_boxs_volume_and_diagonal(a):
    corners = a.corners_world()
    assert ConvexHull(corners).volume == pytest.approx(a.volume_m3, rel=1e-6)
    assert np.linalg.norm(corners[:, None] - corners[None], axis=-1).max() == pytest.approx(a.diagonal_m, rel=1e-9)


@given(point_sets())
def test_the_upright_box_contains_its_points_and_stands_upright(points):
    a = gravity_aligned_box(points, 0.001)
    assert a.contains(points, 1e-9).all()
    assert np.allclose(a.world_from_box[:3, 2], [0, 0, 1])
    assert np.isclose(np.linalg.det(a.world_from_box[:3, :3]), 1)


@given(point_sets())
def test_no_other_yaw_gives_a_smaller_footprint(points):
    a = gravity_aligned_box(points, 1e-9)
    area = 4 * a.half_extents_m[0] * a.half_extents_m[1]
    yaws = np.linspace(0, np.pi / 2, 721)
    along = points[:, :1] * np.cos(yaws) + points[:, 1:2] * np.sin(yaws)
    across = -points[:, :1] * np.sin(yaws) + points[:, 1:2] * np.cos(yaws)
    assert area <= (np.ptp(along, axis=0) * np.ptp(across, axis=0)).min() + 1e-7


@given(point_sets(), st.floats(0.001, 0.05))
def test_the_upright_box_is_tight_down_to_the_least_half_extent(points, least):
    a = gravity_aligned_box(points, least)
    local = np.abs((points - a.center) @ a.world_from_box[:3, :3]).max(axis=0)
    assert np.allclose(a.half_extents_m, np.maximum(local, least), atol=1e-9)


@pytest.mark.parametrize(("points", "half"), [
    ([[1, 2, 3]], (0.01, 0.01, 0.01)), ([[1, 2, 3]] * 5, (0.01, 0.01, 0.01)),
    ([[0, 0, 0], [3, 4, 0], [1.5, 2, 0]], (2.5, 0.01, 0.01)), ([[0, 0, 0], [0, 0, 1], [0, 0, 0.2]], (0.01, 0.01, 0.5)),
    ([[0, 0, 5], [1, 0, 5], [1, 2, 5], [0, 2, 5]], (0.5, 1.0, 0.01)),
    ([[0, 0, 0], [2, 0, 0], [0, 0, 2]], (1.0, 0.01, 1.0)),
], ids=["a point", "one point five times", "a line", "a vertical line", "a rectangle", "a vertical plane"])  # fmt: skip
def test_a_flat_cloud_gets_a_box_of_the_least_thickness(points, half):
    a = gravity_aligned_box(np.array(points, dtype=np.float32), 0.01)
    assert sorted(a.half_extents_m[:2]) == pytest.approx(sorted(half[:2]), abs=1e-6)
    assert a.half_extents_m[2] == pytest.approx(half[2], abs=1e-6)
    assert a.contains(np.array(points), 1e-6).all()


def two_sides(yaw_rad, width_m=1.2, depth_m=0.5):
    """The front and a part of one side of a cupboard, as a camera sees them."""
    along = np.linspace(0, 1, 60)
    front = np.stack([width_m * along, 0 * along], axis=1)
    side = np.stack([0 * along, 0.7 * depth_m * along], axis=1)
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    flat = np.concatenate([front, side]) @ np.array([[c, s], [-s, c]])
    return np.concatenate([np.column_stack([flat, np.full(len(flat), z)]) for z in (0.0, 0.4, 0.8)])


@pytest.mark.parametrize("yaw_deg", [0, 7, 30, 62, 88])
def test_a_faced_box_lies_along_the_sides_that_were_seen(yaw_deg):
    noise = np.random.default_rng(2).normal(size=(360, 3)) * 0.004
    box = faced_box(two_sides(np.deg2rad(yaw_deg)) + noise, 0.01)
    off = (np.rad2deg(np.arctan2(box.world_from_box[1, 0], box.world_from_box[0, 0])) - yaw_deg + 45) % 90 - 45
    assert abs(off) <= 3
    assert np.sort(2 * box.half_extents_m) == pytest.approx([0.35, 0.8, 1.2], abs=0.06)


def test_a_faced_box_of_one_point_has_the_least_size():
    box = faced_box(np.array([[1.0, 2.0, 3.0]]), 0.01)
    assert box.center == pytest.approx([1, 2, 3])
    assert box.half_extents_m == pytest.approx([0.01, 0.01, 0.01])


@given(point_sets())
def test_a_faced_box_is_hardly_larger_than_the_smallest(points):
    box, smallest = faced_box(points, 0.01), gravity_aligned_box(points, 0.01)
    assert box.contains(points, 1e-6 * (1 + float(np.abs(points).max()))).all()
    assert box.volume_m3 <= 1.6 * smallest.volume_m3


@given(oriented_boxes(), oriented_boxes(), st.floats(0.0, 0.2))
def test_an_intersection_with_a_margin_uses_the_grown_boxes(a, b, margin):
    assert intersection_volume_m3(a, b, margin) == intersection_volume_m3(a.grown(margin), b.grown(margin))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@given(data=st.data())
def test_bounds_are_least_and_greatest_in_the_points_precision(dtype, data):
    width = np.dtype(dtype).itemsize * 8
    points = data.draw(arrays(dtype, (data.draw(st.integers(1, 9)), 3), elements=st.floats(-9, 9, width=width)))
    bounds = bounds_of(points)
    assert bounds.dtype == dtype
    assert np.array_equal(bounds, [points.min(axis=0), points.max(axis=0)])
    assert np.array_equal(extent_of(points), np.ptp(points, axis=0))
