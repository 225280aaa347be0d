"""The least-squares transform between matched objects of two maps, and its covariance.

Level maps differ by a rotation about the vertical and a translation (4 unknowns), others by any rotation (6). The
rotation is solved in closed form about the weighted centroids (Horn, 1987; Umeyama, 1991).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hickory_stream.geometry.rigid import apply, from_rotation_translation, rotation_angle_rad, yaw_rotation


def registered(
    points_a: NDArray[np.float64], points_b: NDArray[np.float64], weights: NDArray[np.float64], *, is_level: bool
) -> NDArray[np.float64]:
    """Return `a_from_b` (4, 4) of least weighted squares between (K, 3) points, K >= 1."""
    weights = weights / weights.sum()
    mean_a, mean_b = weights @ points_a, weights @ points_b
    # (3, 3): sum of w a b'.
    correlation = (points_a - mean_a).T @ ((points_b - mean_b) * weights[:, None])
    if is_level:
        sine, cosine = correlation[1, 0] - correlation[0, 1], correlation[0, 0] + correlation[1, 1]
        rotation = yaw_rotation(float(np.arctan2(sine, cosine)))
    else:
        left, _, right = np.linalg.svd(correlation)
        signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
        rotation = (left * signs) @ right
    return from_rotation_translation(rotation, mean_a - rotation @ mean_b)


def information(
    points_a: NDArray[np.float64], sigmas_m: NDArray[np.float64], center: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the information (6, 6) of a small rotation (radians) about `center` and a translation (metres) in a.

    The inverse Cramer-Rao bound for K points (K, 3) whose residuals have (K,) standard deviations on each axis.
    """
    total = np.zeros((6, 6))
    for offset, sigma in zip(points_a - center, sigmas_m, strict=True):
        x, y, z = offset
        # The Jacobian of rotation x offset + translation.
        jacobian = np.hstack([np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]]), np.eye(3)])
        total += jacobian.T @ jacobian / sigma**2
    return total


def common_covariance(
    points_a: NDArray[np.float64], center: NDArray[np.float64], sigmas_m: tuple[float, float], max_turn_rad: float
) -> NDArray[np.float64]:
    """Return the (6, 6) covariance of an error that all matched objects (K, 3) may have in common, or in a gradient.

    Objects seen from one height, or along one way, err together, and are worth one (Kish's design effect, 1965).
    `sigmas_m` are level and vertical; a turn that the objects leave open is known to `max_turn_rad`.
    """
    weights = 1.0 / np.array([sigmas_m[0], sigmas_m[0], sigmas_m[1]]) ** 2
    total = np.diag([1.0 / max_turn_rad**2] * 3 + [0.0] * 3)
    for x, y, z in points_a - center:
        jacobian = np.hstack([np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]]), np.eye(3)])
        total += jacobian.T @ (jacobian * weights[:, None]) / len(points_a)
    return np.asarray(np.linalg.inv(total))


def moved_about(
    a_from_b: NDArray[np.float64], step: NDArray[np.float64], center_a: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the transform followed by a small turn (radians) about the centre and a shift (6,), in frame a."""
    turn = Rotation.from_rotvec(step[:3]).as_matrix()
    return from_rotation_translation(turn, center_a - turn @ center_a + step[3:]) @ a_from_b


def tilt_rad(a_from_b: NDArray[np.float64]) -> float:
    """Return the angle between the verticals of the two maps."""
    return float(np.arctan2(np.hypot(a_from_b[0, 2], a_from_b[1, 2]), a_from_b[2, 2]))


def differs(
    a_from_b: NDArray[np.float64],
    other_a_from_b: NDArray[np.float64],
    center_b: NDArray[np.float64],
    *,
    distance_m: float,
    angle_rad: float,
) -> bool:
    """Return whether two transforms differ by more than `distance_m` at `center_b`, or by more than `angle_rad`."""
    moved_m = float(np.linalg.norm(apply(a_from_b, center_b) - apply(other_a_from_b, center_b)))
    turned_rad = rotation_angle_rad(a_from_b[:3, :3].T @ other_a_from_b[:3, :3])
    # A plain bool: limits of NumPy types would give NumPy's bool, which JSON cannot encode.
    return bool(moved_m > distance_m or turned_rad > angle_rad)


# 99 % of chi-squared with two degrees of freedom.
_LEVEL = 9.21


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Levelled:
    """A transform (4, 4) with its covariance (6, 6) under the prior, and whether its tilt is within noise."""

    a_from_b: NDArray[np.float64]
    covariance: NDArray[np.float64]
    is_level: bool


def levelled(
    a_from_b: NDArray[np.float64],
    covariance: NDArray[np.float64],
    center_a: NDArray[np.float64],
    sigmas_rad: NDArray[np.float64],
) -> Levelled:
    """Return a transform (4, 4) under the prior that both maps know gravity, to a tenth of a degree or to several.

    The prior is a mixture of normal distributions over that range of scales, each as likely. The result is the mean and
    the covariance of its posterior, in closed form: in doubt between no tilt and some, the covariance holds both.
    `covariance` (6, 6) of a small turn about `center_a` (3,), then a shift, is by the objects alone; `sigmas_rad` (S,)
    are standard deviations of the tilt about each level axis, ascending.
    """
    tilt = tilt_vector(a_from_b)
    spread = covariance[:2, :2]
    means, covariances, logs = [], [], []
    for sigma in sigmas_rad:
        total = spread + sigma**2 * np.eye(2)
        gain = spread @ np.linalg.inv(total)
        means.append(tilt - gain @ tilt)
        covariances.append(spread - gain @ spread)
        logs.append(-0.5 * (tilt @ np.linalg.solve(total, tilt) + np.log(np.linalg.det(total))))
    weights = np.exp(np.array(logs) - max(logs))
    weights /= weights.sum()
    mean = weights @ np.array(means)
    mixed = np.einsum("s,sij->ij", weights, np.array(covariances))
    offsets = np.array(means) - mean
    mixed += np.einsum("s,si,sj->ij", weights, offsets, offsets)
    # What hangs on the tilt moves with it.
    follow = covariance[:, :2] @ np.linalg.inv(spread)
    step = follow @ (mean - tilt)
    return Levelled(
        a_from_b=moved_about(a_from_b, step, center_a),
        covariance=np.asarray(covariance - follow @ (spread - mixed) @ follow.T),
        is_level=bool(mean @ np.linalg.solve(mixed, mean) < _LEVEL),
    )


def tilt_vector(a_from_b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the level turn (2,) in radians from the vertical of a to the vertical of b."""
    up = apply(a_from_b, np.array([0.0, 0.0, 1.0])) - a_from_b[:3, 3]
    level = float(np.hypot(up[0], up[1]))
    if level < 1e-12:
        return np.zeros(2)
    return np.asarray(np.arctan2(level, up[2]) * np.array([-up[1], up[0]]) / level)
