"""Which words for a shape hold of an object, from its superquadrics and its sides."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.superquadric import volumes_m3
from hickory_stream.query.ramps import ramp, rising

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.geometry.superquadric import Superquadrics

SHAPE_WORDS = ("box", "cylinder", "ball", "flat", "thin", "hollow")

# A flat thing's smallest side, and a thin one's middle side, over the next larger one: fully, not at all.
_FLAT = (0.25, 0.45)
_THIN = (0.25, 0.45)
# Exponents of a superquadric: an edge is sharp up to the first and gone from the second; one near 1 is round.
_SHARP = (0.5, 0.95)
_ROUND = (0.25, 0.55)
# The ratio of two semi-axes that are equal, and that are not.
_EQUAL = (0.85, 0.6)
# The volume of the primitives over that of the box around them: of one body, and of a frame of bars and boards.
_BODY = (0.3, 0.5)


def shape_scores(primitives: Superquadrics | None, sides_m: NDArray[np.float64], hollow: float) -> NDArray[np.float64]:
    """Return how far each of `SHAPE_WORDS` holds of an object, in 0..1.

    Args:
        primitives: its layer 3, or its sketch; None: it is no box, cylinder or ball.
        sides_m: (3,) of its upright box.
        hollow: whether it is hollow, in 0..1.
    """
    shortest, middle, longest = np.sort(sides_m)
    flat = 1.0 - rising(shortest / middle, *_FLAT)
    thin = 1.0 - rising(middle / longest, *_THIN)
    if primitives is None or not len(primitives):
        return np.array([0.0, 0.0, 0.0, flat, thin, hollow])
    volumes = volumes_m3(primitives)
    body = rising(float(volumes.sum() / sides_m.prod()), *_BODY)
    shares = volumes / volumes.sum()
    e1, e2 = primitives.exponents.T
    axes = primitives.semi_axes_m
    is_turned = _is_round(e2) * _are_equal(axes[:, 0], axes[:, 1])
    box = _is_sharp(e1) * _is_sharp(e2)
    cylinder = _is_sharp(e1) * is_turned
    ball = _is_round(e1) * is_turned * _are_equal(axes[:, 0], axes[:, 2])
    found = [min(body, float((shares * kind).sum())) for kind in (box, cylinder, ball)]
    return np.array([*found, flat, thin, hollow])


def _is_sharp(exponents: NDArray[np.float64]) -> NDArray[np.float64]:
    return 1.0 - ramp(exponents, *_SHARP)


def _is_round(exponents: NDArray[np.float64]) -> NDArray[np.float64]:
    return 1.0 - ramp(np.abs(exponents - 1.0), *_ROUND)


def _are_equal(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return ramp(np.minimum(a, b) / np.maximum(a, b), _EQUAL[1], _EQUAL[0])
