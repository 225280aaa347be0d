"""The true pose of a map's frame, from a truth folder or from a ground-truth trajectory in a common frame."""
# `world_from_map` and, for a body, `body_from_camera` follow from the poses of kept views and the truth at the same
# stamps, by the closed form of Shah (2013) for body_i X = W camera_i.

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.truth import load_truth
from hickory_stream.geometry.rigid import from_rotation_translation, interpolate, invert
from hickory_stream.map_folder.saved_map import SavedMap
from hickory_stream.records import MapSnapshot
from players.poses.interpolation import pose_of_row
from players.poses.pose_file import read_pose_file

_MAX_GAP_NS = 500_000_000
_MIN_POSES = 3
# If the camera never turns by more than this, `body_from_camera` is not observable and is taken as the identity.
_MIN_TURN_RAD = 0.2


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TrueTrajectory:
    """Stamps (N,) ascending, `world_from_body` (N, 4, 4); `is_camera`: the body is the camera itself."""

    stamps_ns: NDArray[np.int64]
    world_from_body: NDArray[np.float64]
    is_camera: bool


def read_true_trajectory(path: Path) -> TrueTrajectory:
    """Return the trajectory of a truth folder, a Kimera-Multi `<robot>_gt_odom.csv`, or a TUM file."""
    # Raises RecordingError: it is none of these, or damaged.
    if path.is_dir():
        frames = load_truth(path).frames
        return TrueTrajectory(
            stamps_ns=np.array([frame.stamp_ns for frame in frames], dtype=np.int64),
            world_from_body=np.array([frame.world_from_camera for frame in frames]).reshape(-1, 4, 4),
            is_camera=True,
        )
    stamps_ns, rows = read_pose_file(path, None)
    order = np.argsort(stamps_ns, kind="stable")
    return TrueTrajectory(
        stamps_ns=np.array(stamps_ns, dtype=np.int64)[order],
        world_from_body=np.array([pose_of_row(np.array(rows[i])) for i in order]),
        is_camera=False,
    )


def world_from_map(snapshot: MapSnapshot, truth: TrueTrajectory, name: str) -> NDArray[np.float64]:
    """Return the true pose (4, 4) of the map's frame: the least-squares fit over all kept views, since odometry drifts.

    Raises:
        RecordingError: fewer than three views of the map were taken while the ground truth was recorded.
    """
    views = {view.stamp_ns: view.world_from_camera for item in snapshot.objects for view in item.views}
    pairs = [(pose_at(truth, stamp), views[stamp]) for stamp in sorted(views)]
    known = [(body, camera) for body, camera in pairs if body is not None]
    if len(known) < _MIN_POSES:
        raise RecordingError(
            f"of {len(views)} views of {name}, {len(known)} were taken while the ground truth was recorded; expected "
            f"at least {_MIN_POSES}: name the truth of the log that was played"
        )
    bodies = np.array([body for body, _ in known])
    cameras = np.array([camera for _, camera in known])
    return _common_frame(bodies, cameras) if truth.is_camera else _hand_eye(bodies, cameras)


def true_a_from_b(a: SavedMap, b: SavedMap, truths: Sequence[Path]) -> NDArray[np.float64]:
    """Return the true pose (4, 4) of map b in map a; `truths` are those of their logs, in one frame."""
    world_from_a, world_from_b = (
        world_from_map(one.snapshot, read_true_trajectory(truth), one.folder.name)
        for one, truth in zip((a, b), truths, strict=True)
    )
    return invert(world_from_a) @ world_from_b


def pose_at(truth: TrueTrajectory, stamp_ns: int) -> NDArray[np.float64] | None:
    """Return the true pose (4, 4) at a stamp, interpolated across gaps of at most 0.5 s; None across a longer gap."""
    after = int(np.searchsorted(truth.stamps_ns, stamp_ns))
    if after < len(truth.stamps_ns) and truth.stamps_ns[after] == stamp_ns:
        return truth.world_from_body[after]
    if after in (0, len(truth.stamps_ns)):
        return None
    start_ns, end_ns = int(truth.stamps_ns[after - 1]), int(truth.stamps_ns[after])
    if end_ns - start_ns > _MAX_GAP_NS:
        return None
    share = (stamp_ns - start_ns) / (end_ns - start_ns)
    return interpolate(truth.world_from_body[after - 1], truth.world_from_body[after], share)


def _common_frame(bodies: NDArray[np.float64], cameras: NDArray[np.float64]) -> NDArray[np.float64]:
    rotation = Rotation.from_matrix(bodies[:, :3, :3] @ cameras[:, :3, :3].transpose(0, 2, 1)).mean().as_matrix()
    translation = (bodies[:, :3, 3] - cameras[:, :3, 3] @ rotation.T).mean(axis=0)
    return from_rotation_translation(rotation, translation)


def _hand_eye(bodies: NDArray[np.float64], cameras: NDArray[np.float64]) -> NDArray[np.float64]:
    turns = Rotation.from_matrix(cameras[0, :3, :3].T @ cameras[:, :3, :3]).magnitude()
    if turns.max() < _MIN_TURN_RAD:
        return _common_frame(bodies, cameras)
    total = np.zeros((9, 9))
    for body, camera in zip(bodies, cameras, strict=True):
        total += np.kron(camera[:3, :3], body[:3, :3])
    # vec(W) is the left singular vector of the largest singular value, vec(X) the right one.
    world_from_map_rotation = _nearest_rotation(np.linalg.svd(total)[0][:, 0].reshape(3, 3, order="F"))
    # body_R x - w = W_R camera_t - body_t, linear in x (the camera on the body) and w.
    rows = np.concatenate([np.hstack([body[:3, :3], -np.eye(3)]) for body in bodies])
    wanted = np.concatenate(
        [world_from_map_rotation @ camera[:3, 3] - body[:3, 3] for body, camera in zip(bodies, cameras, strict=True)]
    )
    # Centred, so that the minimum-norm solution has a small x rather than a small w.
    center = bodies[:, :3, 3].mean(axis=0) - world_from_map_rotation @ cameras[:, :3, 3].mean(axis=0)
    shifted = wanted + np.tile(center, len(bodies))
    solution = np.linalg.lstsq(rows, shifted, rcond=1e-3)[0]
    return from_rotation_translation(world_from_map_rotation, solution[3:] + center)


def _nearest_rotation(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    matrix = matrix * np.sign(np.linalg.det(matrix))
    left, _, right = np.linalg.svd(matrix)
    return np.asarray(left @ right)
