"""Errors of an estimated trajectory: ATE and RPE as `evo_ape -a` and `evo_rpe` compute them.

ATE is the RMSE of positions after rigid alignment (Umeyama 1991, without scale), RPE the RMSE of the motion between
successive poses (Sturm et al., IROS 2012).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import InputError
from hickory_stream.geometry.rigid import rotation_angle_rad


@dataclass(frozen=True, kw_only=True, slots=True)
class PoseError:
    """RMSE of `num_poses` camera positions in metres: without alignment, and after the best rigid alignment."""

    ate_m: float
    ate_aligned_m: float
    num_poses: int


def pose_error(found: NDArray[np.float64], true: NDArray[np.float64]) -> PoseError:
    """Return the error of (N, 3) camera positions against the (N, 3) true ones, N >= 1."""
    offsets = np.linalg.norm(found - true, axis=1)
    rotation, translation = best_alignment(found, true)
    rest = np.linalg.norm(found @ rotation.T + translation - true, axis=1)
    return PoseError(ate_m=_rms(offsets), ate_aligned_m=_rms(rest), num_poses=len(found))


def best_alignment(
    found: NDArray[np.float64], true: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return rotation (3, 3) and translation (3,) that bring (N, 3) `found` closest to `true` (Umeyama, no scale)."""
    a, b = found.mean(axis=0), true.mean(axis=0)
    u, _, vt = np.linalg.svd((true - b).T @ (found - a))
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt)) or 1.0])
    rotation = u @ flip @ vt
    return rotation, b - rotation @ a


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt((values**2).mean()))


MATCHED_NS = 10_000_000
"""Largest time difference between an estimated pose and its true one; evo's default."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TrajectoryError:
    """RMSE: `ate_m` after alignment, `rpe_m` and `rpe_deg` from pose to pose; and the length of the true path."""

    ate_m: float
    rpe_m: float
    rpe_deg: float
    way_m: float
    num_poses: int


def trajectory_error(
    stamps_ns: Sequence[int], poses: NDArray[np.float64], true_stamps_ns: Sequence[int], true_poses: NDArray[np.float64]
) -> TrajectoryError:
    """Return the error of poses (N, 4, 4) against true ones (M, 4, 4), with their stamps in order.

    Raises `InputError` if fewer than two poses have a true pose within 10 ms.
    """
    pairs = matched(stamps_ns, true_stamps_ns)
    if len(pairs) < 2:
        raise InputError(
            f"{len(pairs)} of {len(stamps_ns)} poses have a true one within {MATCHED_NS / 1e6:g} ms; the true ones are "
            f"from {_span_text(true_stamps_ns)}, the estimated ones from {_span_text(stamps_ns)}"
        )
    found = poses[[i for i, _ in pairs]]
    true = true_poses[[j for _, j in pairs]]
    steps = [
        np.linalg.inv(np.linalg.inv(true[i]) @ true[i + 1]) @ (np.linalg.inv(found[i]) @ found[i + 1])
        for i in range(len(pairs) - 1)
    ]
    moved = np.array([np.linalg.norm(step[:3, 3]) for step in steps])
    turned = np.degrees([rotation_angle_rad(step[:3, :3]) for step in steps])
    return TrajectoryError(
        ate_m=pose_error(found[:, :3, 3], true[:, :3, 3]).ate_aligned_m,
        rpe_m=float(np.sqrt((moved**2).mean())),
        rpe_deg=float(np.sqrt((turned**2).mean())),
        way_m=float(np.linalg.norm(np.diff(true[:, :3, 3], axis=0), axis=1).sum()),
        num_poses=len(pairs),
    )


def matched(stamps_ns: Sequence[int], true_stamps_ns: Sequence[int]) -> list[tuple[int, int]]:
    """Return index pairs of poses and true poses nearest in time; poses without a match are left out."""
    if not len(stamps_ns) or not len(true_stamps_ns):
        return []
    true = np.asarray(true_stamps_ns, dtype=np.int64)
    pairs = []
    for i, stamp_ns in enumerate(stamps_ns):
        j = int(np.abs(true - stamp_ns).argmin())
        if abs(int(true[j]) - stamp_ns) <= MATCHED_NS:
            pairs.append((i, j))
    return pairs


def _span_text(stamps_ns: Sequence[int]) -> str:
    return f"{min(stamps_ns) / 1e9:.3f} s to {max(stamps_ns) / 1e9:.3f} s" if len(stamps_ns) else "none"
