import warnings
import numpy as np
import pytest
from hickory_stream.errors import InputError
from hickory_stream.evaluation.trajectory_error import matched, trajectory_error
from hickory_stream.geometry.rigid import from_rotation_translation, quaternion_from_rotation, rotation_of_vector


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
