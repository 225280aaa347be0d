"""Where a camera sits on a body, from the motions of both: hand-eye calibration, A X = X B.

A are motions of the body as its odometry has them, B those of the camera as it has seen them, X is `body_from_camera`.
All six numbers are found together: a robot that only turns about the vertical leaves the height of the camera open, and
its turn about the vertical is told by the translations. What the motion left open is found in the uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.rigid import (
    compose,
    from_rotation_translation,
    invert,
    rotation_angle_rad,
    rotation_of_vector,
    rotation_vector,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

FLU_FROM_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Axes of a camera (x right, y down, z forward) in those of a body (x forward, y left, z up)."""

OPEN_M, OPEN_RAD = 0.03, float(np.radians(1.0))
"""What is not known to this, by two sigma, is called open."""

_UNKNOWN = 7.0
"""So many times less sure, 10 cm and 3.5 degrees, and what was assumed is as good."""

_SCALE = np.repeat([1.0 / OPEN_RAD, 1.0 / OPEN_M], 3)
"""By which rotations and translations count alike."""

_ALIKE = 4.0
"""Motions that overlap by half, of an odometry whose errors last for seconds, are worth a quarter of their number."""

_LEAST_MOTIONS = 10
_ROUNDS = 30
_PRIOR_M, _PRIOR_RAD = 3.0, 1.5
"""Nobody mounts a camera farther from a body; keeps what is open near where it began."""

_HUBER = 1.5
_AXES = ("roll", "pitch", "yaw", "forward", "left", "up")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class HandEye:
    """`body_from_camera` (4, 4); `covariance` (6, 6) of its error in the body's axes, rotation (rad) first, then m.

    `open_directions` (K, 6), unit: what the motion did not determine to 3 cm or 1 degree,
    those counted alike. `num_motions` were used.
    """

    body_from_camera: NDArray[np.float64]
    covariance: NDArray[np.float64]
    open_directions: NDArray[np.float64]
    num_motions: int

    def __post_init__(self) -> None:
        freeze(self, "body_from_camera", "f8", (4, 4))
        freeze(self, "covariance", "f8", (6, 6))
        freeze(self, "open_directions", "f8", (None, 6))

    def open_names(self) -> tuple[str, ...]:
        """Return the names of the axes that are open, wholly or to some part."""
        shares = np.square(self.open_directions).sum(axis=0)
        return tuple(name for name, share in zip(_AXES, shares, strict=True) if share > 0.2)

    def disagrees_with(self, assumed: NDArray[np.float64]) -> tuple[float, float] | None:
        """Return by how many metres and radians an assumed `body_from_camera` (4, 4) is off; None where it may hold.

        It is off along those directions where it is by three sigma; and by 3 cm or 1 degree in all.
        """
        spread, axes = np.linalg.eigh(self.covariance * np.outer(_SCALE, _SCALE))
        off = axes.T @ (_difference(self.body_from_camera, assumed) * _SCALE)
        error = axes @ np.where(np.square(off) > 9.0 * spread, off, 0.0) / _SCALE
        turned, moved = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
        return (moved, turned) if moved > OPEN_M or turned > OPEN_RAD else None


@dataclass(frozen=True, kw_only=True, slots=True)
class NoHandEye:
    """It cannot be said where the camera sits: an expected outcome."""

    reason: str


def hand_eye(
    body_motions: Sequence[NDArray[np.float64]],
    camera_motions: Sequence[NDArray[np.float64]],
    assumed: NDArray[np.float64] | None = None,
) -> HandEye | NoHandEye:
    """Return where the camera sits by pairs of motions (4, 4), each `before_from_after`, of body and camera.

    Gauss-Newton with Huber's weights from the usual mountings and the `assumed` one (4, 4), near which stays what is
    open; errors of rotations and of translations are weighted by what is left of them.
    """
    turns = [rotation_angle_rad(motion[:3, :3]) for motion in camera_motions]
    ways = [float(np.linalg.norm(motion[:3, 3])) for motion in camera_motions]
    pairs = [
        (a, b)
        for a, b, turn, way in zip(body_motions, camera_motions, turns, ways, strict=True)
        if turn > np.radians(2.0) or way > 0.05
    ]
    if len(pairs) < _LEAST_MOTIONS:
        return NoHandEye(reason=f"the camera moved in {len(pairs)} of {len(turns)} steps; expected {_LEAST_MOTIONS}")
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
    """Return the best X from a start, the information (6, 6) of it, and the cost by which starts compare."""
    x = start
    sigma = np.array([np.radians(1.0), 0.02])
    prior = np.diag(np.repeat([_PRIOR_RAD**-2, _PRIOR_M**-2], 3))
    information = prior
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
    """Return the information (6, 6) without what noise alone pretends, nowhere less than the prior.

    Errors of the rotations make each I - R look as if it turned about all axes, by 2 sigma^2 in its square.
    """
    pretended = np.repeat([2.0 * number, 2.0 * number * float(sigma[0] / sigma[1]) ** 2], 3)
    root = np.sqrt(np.diag(prior))
    values, axes = np.linalg.eigh((information - np.diag(pretended)) / np.outer(root, root))
    return np.asarray((axes * np.maximum(values, 1.0)) @ axes.T * np.outer(root, root))


def _linearised(
    a: NDArray[np.float64], b: NDArray[np.float64], x: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the residual (6,) of A = X B X^-1 and its derivative (6, 6) by a small motion of X in the body's axes.

    With X' = exp(d) X: exp(d) X B X^-1 exp(-d), so that a rotation residual goes with (I - R) and a translation with
    (I - R) and with the turn of the translations.
    """
    seen = compose(x, b, invert(x))
    residual = np.concatenate([rotation_vector(seen[:3, :3] @ a[:3, :3].T), seen[:3, 3] - a[:3, 3]])
    rotation, translation = seen[:3, :3], seen[:3, 3]
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = np.eye(3) - rotation
    # The turn moves the camera's place, too: about the body's origin.
    jacobian[3:, :3] = -_cross(translation)
    jacobian[3:, 3:] = np.eye(3) - rotation
    return residual, jacobian


def _moved(x: NDArray[np.float64], step: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return X after a small rigid motion of the body's axes (rotation about the body's origin, then translation)."""
    return compose(from_rotation_translation(rotation_of_vector(step[:3]), step[3:]), x)


def _difference(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (6,): the rotation from Y to X as a vector in the body's axes, and the difference of their places."""
    return np.concatenate([rotation_vector(x[:3, :3] @ y[:3, :3].T), x[:3, 3] - y[:3, 3]])


def _cross(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
