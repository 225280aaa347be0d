"""Graduated non-convexity with truncated least squares (Yang et al., RA-L 2020): weights of factors that are doubted.

A factor counts fully up to a limit of its squared residual, and not at all above it. That has many local minima, so the
weights begin with those of a smooth cost, in which every factor counts a little, and come nearer to it by steps of
`sharper`; once each weight is 0 or 1 they are those of the limit itself.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_STEP = 1.4
"""Greater steps accepted wrong loops in simulation."""
_SHARPEST = 1e6


def smoothest(chi2: NDArray[np.float64], limit: float) -> float:
    """Return the sharpness to begin with for squared residuals (K,): none of them is beyond what counts a little."""
    over = 2.0 * float(chi2.max(initial=0.0)) - limit
    return limit / max(over, limit / _SHARPEST)


def sharper(sharpness: float) -> float:
    """Return the sharpness of the next round."""
    return _STEP * sharpness


def weights_of(chi2: NDArray[np.float64], limit: float, sharpness: float) -> NDArray[np.float64]:
    """Return the weights (K,), 0..1, of squared residuals (K,)."""
    share = sharpness / (sharpness + 1.0)
    between = np.sqrt(sharpness * (sharpness + 1.0) * limit / np.maximum(chi2, 1e-12)) - sharpness
    return np.where(chi2 <= share * limit, 1.0, np.where(chi2 >= limit / share, 0.0, between))
