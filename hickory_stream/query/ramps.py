"""Degrees of truth in 0..1: a word such as "large" begins to hold at one number and holds fully at another."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def ramp(value: NDArray[np.float64], zero_at: float, one_at: float) -> NDArray[np.float64]:
    """Return 0 up to `zero_at`, 1 from `one_at` on and a straight line between; falling where `one_at` is less."""
    return np.asarray(np.clip((value - zero_at) / (one_at - zero_at), 0.0, 1.0))


def rising(value: float, zero_at: float, one_at: float) -> float:
    """Return `ramp` of one number."""
    return float(np.clip((value - zero_at) / (one_at - zero_at), 0.0, 1.0))
