"""The absolute trajectory error (ATE) of the camera's positions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


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
