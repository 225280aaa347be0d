"""The place of a camera on a body, from the motions of both: hand-eye calibration, A X = X B.

A are motions of the body by its odometry, B motions of the camera, X is `body_from_camera`. All six numbers are found
together, with the uncertainty of what the motion left open: turns about the vertical leave the camera's height open.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.rigid import (
    compose,
    from_rotation_translation,
    invert,
    rotation_angle_rad,
    rotation_of_vector,
    rotation_vector,
)

# Axes of a camera (x right, y down, z forward) in the axes of a body (x forward, y left, z up).
FLU_FROM_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
# A direction that is not known to this, by two sigma, is open.
OPEN_M, OPEN_RAD = 0.03, float(np.radians(1.0))
# With so many times this uncertainty, 10 cm and 3.5 degrees, the assumed place is as good.
_UNKNOWN = 7.0
# Rotations and translations count alike in these units.
_SCALE = np.repeat([1.0 / OPEN_RAD, 1.0 / OPEN_M], 3)
# Motions that overlap by half, of an odometry whose errors last for seconds, are worth a quarter of their number.
_ALIKE = 4.0
_LEAST_MOTIONS = 10
_ROUNDS = 30
# No camera is mounted farther from a body; the prior keeps open directions near the start.
_PRIOR_M, _PRIOR_RAD = 3.0, 1.5
_HUBER = 1.5
_AXES = ("roll", "pitch", "yaw", "forward", "left", "up")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class HandEye:
    """The result of a calibration."""

    body_from_camera: NDArray[np.float64]
    #: (6, 6) of its error in the body's axes, rotation (rad) first, then m
    covariance: NDArray[np.float64]
    #: (K, 6) unit; the motion did not determine them to 3 cm or 1 degree, which count alike
    open_directions: NDArray[np.float64]
    num_motions: int

    def __post_init__(self) -> None:
        freeze(self, "body_from_camera", "f8", (4, 4))
        freeze(self, "covariance", "f8", (6, 6))
        freeze(self, "open_directions", "f8", (None, 6))

    def open_names(self) -> tuple[str, ...]:
        """Return the names of the axes that are open, at least in part."""
        shares = np.square(self.open_directions).sum(axis=0)
        return tuple(name for name, share in zip(_AXES, shares, strict=True) if share > 0.2)

    def disagrees_with(self, assumed: NDArray[np.float64]) -> tuple[float, float] | None:
        """Return the error of an assumed `body_from_camera` (4, 4) in metres and radians; None if it may hold."""
        # Only directions off by three sigma count, together by 3 cm or 1 degree.
        spread, axes = np.linalg.eigh(self.covariance * np.outer(_SCALE, _SCALE))
        off = axes.T @ (_difference(self.body_from_camera, assumed) * _SCALE)
        error = axes @ np.where(np.square(off) > 9.0 * spread, off, 0.0) / _SCALE
        turned, moved = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
        return (moved, turned) if moved > OPEN_M or turned > OPEN_RAD else None


@dataclass(frozen=True, kw_only=True, slots=True)
class NoHandEye:
    """The calibration failed: an expected outcome."""

    reason: str


def hand_eye(
    body_motions: Sequence[NDArray[np.float64]],
    camera_motions: Sequence[NDArray[np.float64]],
    assumed: NDArray[np.float64] | None = None,
) -> HandEye | NoHandEye:
    """Return the place of the camera from pairs of motions (4, 4), each `before_from_after`, of body and camera.

    Gauss-Newton with Huber's weights from the usual mountings and the `assumed` one (4, 4), which open directions keep;
    residuals weight the errors of rotations and translations.
    """
    pairs = [
        (a, b)
        for a, b in zip(body_motions, camera_motions, strict=True)
        if rotation_angle_rad(b[:3, :3]) > np.radians(2.0) or float(np.linalg.norm(b[:3, 3])) > 0.05
    ]
    if len(pairs) < _LEAST_MOTIONS:
        steps = f"{len(pairs)} of {len(camera_motions)} steps"
        return NoHandEye(reason=f"the camera moved in {steps}; expected {_LEAST_MOTIONS}")
    starts = [from_rotation_translation(FLU_FROM_OPTICAL, np.zeros(3)), np.eye(4)]
    starts = starts if assumed is None else [assumed, *starts]
    solved = [_solved(pairs, start) for start in starts]
    found, information, cost = min(solved, key=lambda one: one[2])
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    if not np.isfinite(cost) or not np.isfinite(covariance).all():
        return NoHandEye(reason="the motions of body and camera fit no place of the camera")
    spread, axes = np.linalg.eigh(covariance * np.outer(_SCALE, _SCALE))
    unknown = axes[:, 4.0 * spread > _UNKNOWN * _UNKNOWN]
    back = unknown @ (unknown.T @ (_difference(found, starts[0]) * _SCALE)) / _SCALE
    return HandEye(
        body_from_camera=_moved(found, -back),
        covariance=covariance,
        open_directions=axes[:, 4.0 * spread > 1.0].T,
        num_motions=len(pairs),
    )


def _solved(
    pairs: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]], start: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    # The best X from a start, its information (6, 6), and the cost by which starts compare.
    x, sigma = start, np.array([np.radians(1.0), 0.02])
    information = prior = np.diag(np.repeat([_PRIOR_RAD**-2, _PRIOR_M**-2], 3))
    for _ in range(_ROUNDS):
        rows, jacobians = zip(*(_linearised(a, b, x) for a, b in pairs), strict=True)
        residuals, jacobian = np.array(rows), np.array(jacobians)
        sizes = np.stack([np.linalg.norm(residuals[:, :3], axis=1), np.linalg.norm(residuals[:, 3:], axis=1)], axis=1)
        # The median of the length of three normal numbers is 1.54 sigma; no odometry is surer than a tenth of these.
        sigma = np.maximum(np.median(sizes, axis=0) / 1.54, [np.radians(0.05), 0.001])
        weights = np.minimum(1.0, _HUBER * 1.54 / np.maximum(sizes / sigma, 1e-9)) / sigma**2
        each = np.repeat(weights, 3, axis=1)
        information = prior + np.einsum("nij,ni,nik->jk", jacobian, each, jacobian)
        gradient = np.einsum("nij,ni,ni->j", jacobian, each, residuals) + prior @ _difference(x, start)
        step = -np.linalg.solve(information, gradient)
        x = _moved(x, step)
        if np.abs(step).max() < 1e-9:
            break
    cost = float(np.log(sigma).sum())
    return x, _without_noise(information / _ALIKE, prior, len(pairs) / _ALIKE, sigma), cost


def _without_noise(
    information: NDArray[np.float64], prior: NDArray[np.float64], number: float, sigma: NDArray[np.float64]
) -> NDArray[np.float64]:
    # Errors of the rotations make each I - R look as if it turned about all axes, by 2 sigma^2 in its square.
    pretended = np.repeat([2.0 * number, 2.0 * number * float(sigma[0] / sigma[1]) ** 2], 3)
    root = np.sqrt(np.diag(prior))
    values, axes = np.linalg.eigh((information - np.diag(pretended)) / np.outer(root, root))
    return np.asarray((axes * np.maximum(values, 1.0)) @ axes.T * np.outer(root, root))


def _linearised(
    a: NDArray[np.float64], b: NDArray[np.float64], x: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # The residual (6,) of A = X B X^-1 and its derivative (6, 6) by a small motion of X in the body's axes: X' = exp(d)
    # X gives exp(d) X B X^-1 exp(-d).
    seen = compose(x, b, invert(x))
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = jacobian[3:, 3:] = np.eye(3) - seen[:3, :3]
    # The turn moves the camera's place, too: about the body's origin.
    jacobian[3:, :3] = -_cross(seen[:3, 3])
    return _difference(seen, a), jacobian


def _moved(x: NDArray[np.float64], step: NDArray[np.float64]) -> NDArray[np.float64]:
    # Rotation about the body's origin, then translation, in the body's axes.
    return compose(from_rotation_translation(rotation_of_vector(step[:3]), step[3:]), x)


def _difference(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    # (6,) the rotation from Y to X as a vector in the body's axes, and the difference of their places.
    return np.concatenate([rotation_vector(x[:3, :3] @ y[:3, :3].T), x[:3, 3] - y[:3, 3]])


def _cross(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
