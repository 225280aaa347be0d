import warnings
from dataclasses import replace
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from hickory_stream.alignment.align import align
from hickory_stream.alignment.object_map import object_map
from hickory_stream.errors import InputError, RecordingError
from hickory_stream.evaluation.trajectory_error import matched, trajectory_error
from hickory_stream.geometry.rigid import (
    from_rotation_translation,
    invert,
    quaternion_from_rotation,
    rotation_of_vector,
)
from hickory_stream.pictures.render_alignment import render_alignment
from tests.alignment.map_fixtures import frame, furniture, snapshot_of
from tests.mapping.mapping_fixtures import view
from tools.evaluation.alignment_truth import TrueTrajectory, pose_at, read_true_trajectory, world_from_map
from tools.paper_tables.alignment import row_of

START_NS = 1_700_000_000_000_000_000
STEP_NS = 100_000_000
BODY_FROM_CAMERA = from_rotation_translation(
    Rotation.from_euler("xyz", [-90, 5, -85], degrees=True).as_matrix(), np.array([0.3, -0.05, 0.4])
)


def body_poses(count=40):
    rng = np.random.default_rng(0)
    poses = []
    for i in range(count):
        turn = Rotation.from_euler("zyx", [0.15 * i, 0.2 * np.sin(i), 0.1 * rng.normal()]).as_matrix()
        poses.append(from_rotation_translation(turn, np.array([0.2 * i, np.sin(0.3 * i), 0.1 * rng.normal()])))
    return np.array(poses)


def map_with_views(cameras):
    snapshot = snapshot_of(furniture(4, 0), np.eye(4))
    views = [
        replace(view(i), stamp_ns=START_NS + i * STEP_NS, world_from_camera=camera) for i, camera in enumerate(cameras)
    ]
    first, *others = snapshot.objects
    return replace(snapshot, objects=(replace(first, views=tuple(views)), *others))


def write_csv(path, poses):
    rows = ["#timestamp_kf,x,y,z,qw,qx,qy,qz"]
    for i, pose in enumerate(poses):
        x, y, z, w = quaternion_from_rotation(pose[:3, :3])
        rows.append(",".join(map(str, [START_NS + i * STEP_NS, *pose[:3, 3], w, x, y, z])))
    path.write_text("\n".join(rows))
    return path


def write_tum(path, poses):
    rows = ["# timestamp tx ty tz qx qy qz qw"]
    for i, pose in enumerate(poses):
        stamp = START_NS + i * STEP_NS
        seconds = f"{stamp // 10**9}.{stamp % 10**9:09d}"
        rows.append(" ".join([seconds, *map(str, [*pose[:3, 3], *quaternion_from_rotation(pose[:3, :3])])]))
    path.write_text("\n".join(rows))
    return path


@pytest.mark.parametrize("write", [write_csv, write_tum])
def test_a_body_trajectory_places_the_map_for_any_camera_mount(write, tmp_path):
    bodies = body_poses()
    true = frame(50, 3, -2, 0.5)
    snapshot = map_with_views(np.array([invert(true) @ body @ BODY_FROM_CAMERA for body in bodies]))
    truth = read_true_trajectory(write(tmp_path / "gt", bodies))
    assert truth.stamps_ns.tolist() == [START_NS + i * STEP_NS for i in range(40)]
    assert np.allclose(world_from_map(snapshot, truth, "m"), true, atol=1e-5)


def test_a_camera_trajectory_is_taken_as_it_is_up_to_mean_drift():
    cameras = body_poses()
    true = frame(-20, 1, 1)
    truth = TrueTrajectory(stamps_ns=START_NS + STEP_NS * np.arange(40), world_from_body=cameras, is_camera=True)
    drifting = np.array([invert(true) @ camera for camera in cameras])
    drifting[:, 0, 3] += np.linspace(-0.1, 0.1, 40)
    assert np.allclose(world_from_map(map_with_views(drifting), truth, "m"), true, atol=0.02)


def test_truth_is_interpolated_between_poses_and_not_over_gaps():
    poses = body_poses(3)
    truth = TrueTrajectory(stamps_ns=np.array([0, 100_000_000, 2_000_000_000]), world_from_body=poses, is_camera=True)
    assert np.allclose(pose_at(truth, 50_000_000)[:3, 3], poses[:2, :3, 3].mean(axis=0))
    assert pose_at(truth, 1_000_000_000) is None
    assert pose_at(truth, -1) is None
    assert pose_at(truth, 2_000_000_001) is None


@pytest.mark.parametrize(
    "content", ["", "# only a comment\n", "1 2 3\n", "5,1,2\n", "a b c d e f g h\n", "1 0 0 0 0 0 0 0\n"]
)
def test_what_is_no_trajectory_is_refused_with_what_was_expected(content, tmp_path):
    path = tmp_path / "gt.txt"
    path.write_text(content)
    with pytest.raises(RecordingError, match=r"gt\.txt"):
        read_true_trajectory(path)


def test_a_missing_file_and_the_truth_of_another_log_are_refused(tmp_path):
    with pytest.raises(RecordingError, match="cannot be read"):
        read_true_trajectory(tmp_path / "nothing.csv")
    other = TrueTrajectory(stamps_ns=np.arange(5), world_from_body=body_poses(5), is_camera=True)
    with pytest.raises(RecordingError, match="of the log that was played"):
        world_from_map(map_with_views(body_poses()), other, "m")


def test_a_row_has_the_errors_of_an_answer_or_the_refusal():
    items, b_from_world = furniture(9, 2), frame(30, 1, 0)
    map_a, map_b = object_map(snapshot_of(items, np.eye(4))), object_map(snapshot_of(items, b_from_world, 1))
    good = row_of(align(map_a, map_b), invert(b_from_world))
    assert (good["num_pairs"], good["refusal"]) == (9, None)
    assert good["translation_m"] < 0.02
    refused = row_of(align(map_a, object_map(snapshot_of([], np.eye(4)))), np.eye(4))
    assert (refused["num_pairs"], refused["translation_m"], refused["refusal"]) == (0, None, "empty")


def test_the_picture_shows_both_maps_and_what_was_said_of_them():
    items = furniture(8, 2)
    map_a, map_b = object_map(snapshot_of(items, np.eye(4))), object_map(snapshot_of(items, frame(30, 1, 0), 1))
    joined = render_alignment(map_a, map_b, align(map_a, map_b), (640, 320))
    apart = render_alignment(map_a, map_b, align(map_a, object_map(snapshot_of([], np.eye(4)))), (640, 320))
    for image in (joined, apart):
        assert image.shape == (320, 640, 3)
        pixels = image[50:].reshape(-1, 3).astype(int)
        assert ((pixels[:, 2] - pixels[:, 0]) > 60).sum() > 300
        assert ((pixels[:, 0] - pixels[:, 2]) > 60).sum() > 300
    assert not np.array_equal(joined, apart)
    with pytest.raises(ValueError, match="at least"):
        render_alignment(map_a, map_b, align(map_a, map_b), (100, 100))


def walk(count, noise, seed):
    rng = np.random.default_rng(seed)
    poses = []
    for i in range(count):
        turn = rotation_of_vector(np.array([0.02, 0.3, -0.1]) * i / 5 + noise * rng.standard_normal(3))
        place = np.array([np.cos(i / 9), np.sin(i / 7), 0.05 * i]) + noise * rng.standard_normal(3)
        poses.append(from_rotation_translation(turn, place))
    return np.array(poses)


def test_errors_are_those_of_evo():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its own dependencies warn of one another
        from evo.core import metrics, sync
        from evo.core.trajectory import PoseTrajectory3D

    def as_evo_has_it(stamps_ns, poses):
        xyzw = np.array([quaternion_from_rotation(pose[:3, :3]) for pose in poses])
        return PoseTrajectory3D(poses[:, :3, 3], np.roll(xyzw, 1, axis=1), np.array(stamps_ns) / 1e9)

    true_ns = [i * 100_000_000 for i in range(60)]
    true = walk(60, 0.0, 0)
    elsewhere = from_rotation_translation(rotation_of_vector(np.array([0.4, -0.2, 1.0])), np.array([3.0, -1.0, 2.0]))
    stamps_ns = [ns + 4_000_000 for ns in true_ns[:50]] + [20_000_000_000]
    found = elsewhere @ np.concatenate([walk(50, 0.02, 1), np.eye(4)[None]])
    error = trajectory_error(stamps_ns, found, true_ns, true)

    reference, estimate = sync.associate_trajectories(
        as_evo_has_it(true_ns, true), as_evo_has_it(stamps_ns, found), max_diff=0.01
    )
    steps = metrics.RPE(metrics.PoseRelation.translation_part, delta=1, delta_unit=metrics.Unit.frames)
    turns = metrics.RPE(metrics.PoseRelation.rotation_angle_deg, delta=1, delta_unit=metrics.Unit.frames)
    for metric in (steps, turns):
        metric.process_data((reference, estimate))
    estimate.align(reference)
    whole = metrics.APE(metrics.PoseRelation.translation_part)
    whole.process_data((reference, estimate))
    assert error.num_poses == 50
    assert error.ate_m == pytest.approx(whole.get_statistic(metrics.StatisticsType.rmse), abs=1e-9)
    assert error.rpe_m == pytest.approx(steps.get_statistic(metrics.StatisticsType.rmse), abs=1e-9)
    assert error.rpe_deg == pytest.approx(turns.get_statistic(metrics.StatisticsType.rmse), abs=1e-6)
    assert error.way_m == pytest.approx(reference.path_length, abs=1e-9)


def test_a_pose_is_paired_within_ten_milliseconds():
    assert matched([0, 12_000_000, 31_000_000], [3_000_000, 20_000_000, 60_000_000]) == [(0, 0), (1, 1)]


def test_trajectories_of_different_times_are_refused_with_spans():
    poses = walk(3, 0.0, 0)
    with pytest.raises(InputError, match=r"0 of 3 poses .* from 50\.000 s to 52\.000 s, .* 0\.000 s to 2\.000 s"):
        trajectory_error([0, 10**9, 2 * 10**9], poses, [50 * 10**9, 51 * 10**9, 52 * 10**9], poses)
