import re
import numpy as np
import pytest
from hickory_stream.box_scene import SceneBox
from hickory_stream.geometry.camera import backproject
from hickory_stream.geometry.rigid import compose, from_rotation_translation, invert, yaw_rotation
from hickory_stream.poses.keyframe_registration import (
    LOST_KEYFRAMES,
    NUM_RECENT,
    KeptOut,
    KeyframeRegistration,
    Placed,
    Remembered,
)
from hickory_stream.poses.registration_config import RegistrationConfig
from hickory_stream.poses.surface_image import surface_image
from tests.poses.registration_scenes import (
    CAMERA,
    EMPTY_WALL,
    NUM_KEYFRAMES,
    ROOM,
    SPREAD_PER_M,
    drifted,
    errors_m,
    image,
    true_pose,
    wall_pose,
)

CONFIG = RegistrationConfig()
NOTHING = surface_image(np.zeros((120, 160), np.uint16), CAMERA, spread_per_m=SPREAD_PER_M, max_sigma_m=0.1)
TRUE = [true_pose(i) for i in range(NUM_KEYFRAMES)]
DRIFTED = drifted(TRUE)


def walked(odometry, config=CONFIG):
    registration = KeyframeRegistration(config)
    return [registration.place(image(i), pose) for i, pose in enumerate(odometry)]


def poses_of(found):
    return [each.map_from_camera for each in found if isinstance(each, Placed)]


@pytest.fixture(scope="module")
def corrected():
    return walked(DRIFTED)


def test_exact_poses_stay_as_they_are_to_the_last_bit():
    found = walked(TRUE)
    assert all(isinstance(each, Placed) and not each.belief.corrects for each in found)
    assert [pose.tobytes() for pose in poses_of(found)] == [pose.tobytes() for pose in TRUE]


def test_most_of_a_drift_is_taken_out(corrected):
    before, after = errors_m(DRIFTED), errors_m(poses_of(corrected))
    assert before[-1] > 0.09
    assert len(after) == NUM_KEYFRAMES
    assert after.max() < 0.03
    assert np.sqrt((after**2).mean()) < 0.3 * np.sqrt((before**2).mean())


def test_the_correction_grows_and_never_jumps(corrected):
    offsets = np.array([each.belief.map_from_odometry for each in corrected if isinstance(each, Placed)])
    at_camera = [compose(offset, DRIFTED[-1])[:3, 3] for offset in offsets]
    assert np.linalg.norm(np.diff(at_camera, axis=0), axis=1).max() < 0.03
    assert np.linalg.norm(at_camera[-1] - at_camera[0]) > 0.08


def test_the_same_keyframes_have_the_same_places_to_the_last_bit(corrected):
    again = poses_of(walked(DRIFTED))
    assert [pose.tobytes() for pose in again] == [pose.tobytes() for pose in poses_of(corrected)]


def test_a_person_who_walks_along_does_not_pull_a_keyframe_along():
    registration = KeyframeRegistration(CONFIG)
    poses = []
    for i, pose in enumerate(DRIFTED):
        ahead = TRUE[i][:3, 3] + 1.3 * TRUE[i][:3, 2] + 0.02 * i * TRUE[i][:3, 0]
        low, high = (ahead[0] - 0.25, ahead[1] - 0.25, 0.0), (ahead[0] + 0.25, ahead[1] + 0.25, 1.7)
        found = registration.place(image(i, (*ROOM, SceneBox(low=low, high=high, rgb=(200, 150, 120)))), pose)
        poses.append(found.map_from_camera)
    assert errors_m(poses).max() < 0.03


def test_along_a_bare_wall_only_the_odometry_moves_a_keyframe():
    odometry = [wall_pose(i) for i in range(12)]
    for i, pose in enumerate(odometry):
        pose[0, 3] += 0.01 * i  # along the wall
        pose[1, 3] += 0.008 * i  # towards it
    registration = KeyframeRegistration(CONFIG)
    found = [registration.place(image(i, EMPTY_WALL, along_wall=True), pose) for i, pose in enumerate(odometry)]
    last = found[-1]
    assert last.belief.corrects
    assert abs(last.map_from_camera[1, 3]) < 0.02
    assert last.map_from_camera[0, 3] == pytest.approx(odometry[-1][0, 3], abs=0.01)
    sigma_m = np.sqrt(np.diag(last.belief.covariance)[3:])
    assert sigma_m[0] > 3 * sigma_m[1]
    shifts = last.degenerate[np.abs(last.degenerate[:, 3:]).max(axis=1) > 0, 3:]
    assert np.abs(shifts @ [1.0, 0.0, 0.0]).max() > 0.95
    assert np.abs(shifts @ [0.0, 1.0, 0.0]).max() < 0.3


def test_where_odometry_is_blind_the_surface_moves_a_keyframe():
    """The odometry guesses a quarter too little of each step and says so: it is no contradiction, nor too far."""
    short = drifted(TRUE[:16], scale=-0.25, yaw_deg=0.0)
    unsaid, said = KeyframeRegistration(CONFIG), KeyframeRegistration(CONFIG)
    kept_out, found = 0, []
    for i, pose in enumerate(short):
        along = pose[:3, :3].T @ (pose[:3, 3] - short[max(i - 1, 0)][:3, 3])
        unseen = np.concatenate([np.zeros(3), along / max(np.linalg.norm(along), 1e-9)])[None]
        found.append(said.place(image(i), pose, unseen))
        kept_out += isinstance(unsaid.place(image(i), pose), KeptOut)
    assert kept_out > 4
    assert all(isinstance(each, Placed) for each in found)
    assert np.linalg.norm(short[-1][:3, 3] - TRUE[15][:3, 3]) > 0.3
    assert errors_m(poses_of(found))[-8:].max() < 0.03


def test_new_ground_unseen_by_odometry_is_as_unsure_as_its_guess():
    sideways = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]])
    sigmas = []
    for unseen in (np.empty((0, 6)), sideways):
        registration = KeyframeRegistration(CONFIG)
        registration.place(image(0), TRUE[0])
        found = registration.place(NOTHING, TRUE[1], unseen)
        turn = TRUE[1][:3, :3]
        sigmas.append(np.sqrt(np.diag(turn.T @ found.belief.covariance[3:, 3:] @ turn)))
    way_m = np.linalg.norm(TRUE[1][:3, 3] - TRUE[0][:3, 3])
    assert sigmas[1][0] == pytest.approx(np.hypot(sigmas[0][0], 0.3 * way_m))
    assert sigmas[1][1:] == pytest.approx(sigmas[0][1:])


def test_new_ground_is_mapped_by_odometry_and_less_sure():
    registration = KeyframeRegistration(CONFIG)
    found = [registration.place(image(0) if i == 0 else NOTHING, pose) for i, pose in enumerate(TRUE[:6])]
    assert [each.how for each in found if isinstance(each, Placed)] == ["first", *5 * ["new ground"]]
    assert [pose.tobytes() for pose in poses_of(found)] == [pose.tobytes() for pose in TRUE[:6]]
    sure = [each.belief.covariance[3, 3] for each in found if isinstance(each, Placed)]
    assert sure == sorted(sure)
    assert sure[-1] > 4 * sure[1]


def test_a_carried_robot_is_kept_out_and_then_starts_over():
    registration = KeyframeRegistration(CONFIG)
    for i in range(12):
        assert isinstance(registration.place(image(i), TRUE[i]), Placed)
    # Its wheels did not turn: it sees another corner of the room, and the odometry goes on from where it was.
    carried = compose(TRUE[12], invert(true_pose(20)))
    odometry = [compose(carried, true_pose(20 + i)) for i in range(LOST_KEYFRAMES + 4)]
    away = [registration.place(image(20 + i), pose) for i, pose in enumerate(odometry)]
    out = [each for each in away if isinstance(each, KeptOut)]
    assert len(out) == LOST_KEYFRAMES - 1
    assert "of what it should show of the map is there" in out[0].reason
    hows = [each.how for each in away if isinstance(each, Placed)]
    assert hows[0] == "begun anew"
    assert set(hows[1:]) == {"fits"}


def test_a_slip_of_the_odometry_is_found_again():
    slip = from_rotation_translation(yaw_rotation(0.01), np.array([0.06, -0.03, 0.0]))
    found = walked([*TRUE[:12], *(compose(slip, pose) for pose in TRUE[12:])])
    reasons = [each.reason for each in found if isinstance(each, KeptOut)]
    assert 0 < len(reasons) < LOST_KEYFRAMES
    moved_m, times = map(
        float, re.match(r"its surface fits the map (.*) m and .* pose, (.*) times the", reasons[0]).groups()
    )
    assert 0.02 < moved_m < 0.09 and times > 6
    assert errors_m(poses_of(found)[-20:], NUM_KEYFRAMES - 20).max() < 0.02


def test_who_was_kept_out_does_not_believe_new_ground():
    registration = KeyframeRegistration(CONFIG)
    for i in range(12):
        registration.place(image(i), TRUE[i])
    assert isinstance(registration.place(image(20), TRUE[12]), KeptOut)
    found = registration.place(NOTHING, TRUE[13])
    assert "too little of the map is in sight" in found.reason
    assert isinstance(registration.place(image(14), TRUE[14]), Placed)


def test_after_a_known_jump_an_unfitting_keyframe_starts_over():
    registration = KeyframeRegistration(CONFIG)
    for i in range(6):
        registration.place(image(i), TRUE[i])
    registration.jumped()
    found = registration.place(image(14), TRUE[6])
    assert found.how == "begun anew"


def test_a_log_that_begins_again_begins_without_a_correction(corrected):
    registration = KeyframeRegistration(CONFIG)
    for i, pose in enumerate(DRIFTED):
        registration.place(image(i), pose)
    registration.began_again()
    found = registration.place(image(0, seed=1), DRIFTED[0])
    assert found.how == "fits"
    assert errors_m([found.map_from_camera]).max() < 0.02


@pytest.mark.parametrize("until", [5, 20])
def test_what_was_restored_goes_on_to_the_same_places(corrected, until):
    placed = [each for each in corrected if isinstance(each, Placed)]
    remembered = [
        Remembered(image=image(i), map_from_camera=each.map_from_camera, number=i, is_anchor=each.is_anchor)
        for i, each in enumerate(placed[:until])
        if each.is_anchor or i >= until - NUM_RECENT
    ]
    registration = KeyframeRegistration(CONFIG)
    registration.restore(placed[until - 1].belief, remembered, until)
    for i in range(until, until + 8):
        found = registration.place(image(i), DRIFTED[i])
        assert found.map_from_camera.tobytes() == placed[i].map_from_camera.tobytes()
        assert found.is_anchor == placed[i].is_anchor


def test_few_keyframes_are_remembered_where_all_were_seen_before(corrected):
    anchors = [each.is_anchor for each in corrected if isinstance(each, Placed)]
    assert sum(anchors) < 0.6 * NUM_KEYFRAMES
    assert not any(anchors[-4:])


def test_the_covariance_covers_the_error(corrected):
    sigmas = []
    for i, each in enumerate(corrected):
        if isinstance(each, Placed) and each.belief.corrects and i > 10:
            off = compose(each.map_from_camera, invert(TRUE[i]))[:3, 3]
            assert np.isfinite(off).all()
            sigmas.append(np.sqrt(np.diag(each.belief.covariance)[3:]))
    assert np.array(sigmas).max() < 0.02
    assert np.array(sigmas).min() > 0.0002


def seen(depth_m, max_sigma_m=0.1):
    depth_mm = np.rint(1e3 * depth_m).astype(np.uint16)
    return surface_image(depth_mm, CAMERA, spread_per_m=SPREAD_PER_M, max_sigma_m=max_sigma_m)


def plane(normal, distance_m):
    """Return the depth of the plane n . p = -d, as an image."""
    rays = backproject(np.ones((CAMERA.height, CAMERA.width), np.float32), CAMERA).astype(float)
    return -distance_m / (rays @ np.asarray(normal))


@pytest.mark.parametrize("normal", [(0.0, 0.0, -1.0), (0.6, 0.0, -0.8), (0.28, -0.0, -0.96)])
def test_a_plane_has_its_normal_and_its_distance_everywhere(normal):
    shown = seen(plane(normal, 1.5))
    has = ~np.isnan(shown.sigma_m)
    assert has[2:-2, 2:-2].mean() > 0.95
    assert np.allclose(shown.normals[has], normal, atol=0.02)
    assert np.allclose(shown.points[has] @ np.asarray(normal), -1.5, atol=0.002)


def test_sigma_grows_with_the_square_of_the_distance():
    near, far = seen(plane((0.0, 0.0, -1.0), 1.0)), seen(plane((0.0, 0.0, -1.0), 3.0))
    assert np.nanmedian(far.sigma_m) == pytest.approx(9 * np.nanmedian(near.sigma_m), rel=0.05)


def test_beside_an_edge_no_point_lies_between_the_two_surfaces():
    depth_m = np.full((CAMERA.height, CAMERA.width), 3.0)
    depth_m[:, :80] = 1.5
    z = seen(depth_m).points[..., 2]
    z = z[~np.isnan(z)]
    assert (np.minimum(np.abs(z - 1.5), np.abs(z - 3.0)) < 0.02).all()


def test_missing_far_or_flat_pixels_are_no_surface():
    assert np.isnan(seen(np.zeros((CAMERA.height, CAMERA.width))).sigma_m).all()
    assert np.isnan(seen(np.full((CAMERA.height, CAMERA.width), 4.0), max_sigma_m=0.01).sigma_m).all()
    floor = np.where((depth_m := plane((0.0, -0.99, -0.14), 0.3)) > 0, depth_m, 0.0).clip(0, 20)
    slanted = seen(floor)
    cosines = -(slanted.points * slanted.normals).sum(axis=-1) / np.linalg.norm(slanted.points, axis=-1)
    assert np.nanmin(cosines) >= 0.2
