"""The tilt between two maps, estimated with a prior: both know gravity, to a tenth of a degree or to several.

The prior is a mixture of normal distributions over that range of scales, each as likely. Its posterior is known in
closed form; the result is its mean and its covariance: in doubt between none and some, the covariance holds both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.alignment.registration import moved_about
from hickory_stream.geometry.rigid import apply

if TYPE_CHECKING:
    from numpy.typing import NDArray

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
    """Return a transform (4, 4) under the prior of a small tilt.

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
