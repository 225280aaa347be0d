import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from hickory_stream.geometry import rigid
from tests.strategies import point_sets, rigid_transforms, rotations, unit_share


@given(rigid_transforms())
def test_the_inverse_undoes_the_transform(a_from_b):
    assert np.allclose(a_from_b @ rigid.invert(a_from_b), np.eye(4), atol=1e-12)
    assert np.allclose(rigid.invert(rigid.invert(a_from_b)), a_from_b, atol=1e-12)


@given(rigid_transforms(), rigid_transforms(), point_sets())
def test_the_product_applies_one_after_the_other(a_from_b, b_from_c, points):
    assert np.allclose(
        rigid.apply(a_from_b @ b_from_c, points), rigid.apply(a_from_b, rigid.apply(b_from_c, points)), atol=1e-9
    )


def test_points_keep_their_float_type_and_integers_widen():
    a_from_b = rigid.from_rotation_translation(rigid.yaw_rotation(np.pi / 2), np.array([0, 0, 1]))
    assert rigid.apply(a_from_b, np.ones((2, 3), dtype=np.float32)).dtype == np.float32
    assert rigid.apply(a_from_b, np.array([[1, 0, 0]])).dtype == np.float64
    assert np.allclose(rigid.apply(a_from_b, np.array([[1, 0, 0]])), [[0, 1, 1]])


@given(rotations())
def test_a_rotation_survives_its_quaternion_near_half_a_turn(rotation):
    quaternion = rigid.quaternion_from_rotation(rotation)
    assert quaternion[3] >= 0
    assert np.linalg.norm(quaternion) == pytest.approx(1, abs=1e-12)
    assert np.allclose(rigid.rotation_from_quaternion(*quaternion), rotation, atol=1e-9)


@given(st.tuples(*[st.floats(-3, 3)] * 4).filter(lambda q: np.linalg.norm(q) > 1e-3))
def test_a_quaternion_of_any_length_rotates_as_in_scipy(q):
    assert np.allclose(rigid.rotation_from_quaternion(*q), Rotation.from_quat(q).as_matrix(), atol=1e-9)


@pytest.mark.parametrize("q", [(0, 0, 0, 0), (np.nan, 0, 0, 1), (np.inf, 0, 0, 1)])
def test_a_quaternion_without_length_is_refused(q):
    with pytest.raises(ValueError, match="is no rotation"):
        rigid.rotation_from_quaternion(*q)


@given(st.floats(0, np.pi), st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda a: np.linalg.norm(a) > 0.1))
def test_the_angle_of_a_rotation_is_the_one_it_was_made_with(angle, axis):
    rotation = Rotation.from_rotvec(angle * np.array(axis) / np.linalg.norm(axis)).as_matrix()
    assert rigid.rotation_angle_rad(rotation) == pytest.approx(angle, abs=1e-9)


@given(st.floats(-10, 10))
def test_yaw_turns_about_z(yaw):
    assert np.allclose(rigid.yaw_rotation(yaw), Rotation.from_euler("z", yaw).as_matrix(), atol=1e-12)


@given(rigid_transforms(), rigid_transforms(), unit_share)
def test_an_interpolation_is_straight_and_turns_evenly(start, end, fraction):
    between = rigid.interpolate(start, end, fraction)
    assert rigid.is_rigid(between, 1e-9)
    assert np.allclose(between[:3, 3], start[:3, 3] + fraction * (end - start)[:3, 3], atol=1e-9)
    whole = rigid.rotation_angle_rad(start[:3, :3].T @ end[:3, :3])
    assert rigid.rotation_angle_rad(start[:3, :3].T @ between[:3, :3]) == pytest.approx(fraction * whole, abs=1e-6)
    assert rigid.rotation_angle_rad(between[:3, :3].T @ end[:3, :3]) == pytest.approx((1 - fraction) * whole, abs=1e-6)


@pytest.mark.parametrize(("matrix", "verdict"), [
    (np.eye(4), True), (np.eye(3), False), (np.diag([1, 1, -1, 1.0]), False), (np.diag([2, 2, 2, 1.0]), False),
    (np.diag([1, 1, 1, 2.0]), False), (np.full((4, 4), np.nan), False), (np.zeros((4, 4)), False),
], ids=["identity", "3 x 3", "mirror", "scale", "bottom row", "NaN", "zeros"])  # fmt: skip
def test_only_proper_rigid_matrices_are_rigid(matrix, verdict):
    assert rigid.is_rigid(matrix) is verdict
