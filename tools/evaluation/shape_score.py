"""How alike two objects are by their superquadrics: the paper's s_geo, computed so that equal shapes score 1."""
# The paper compares the k-th primitives, whose order and parameters are no invariants. Here primitives are matched one
# to one for the highest score, over all orders of axes; volume without a partner counts as 0.

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.superquadric import Superquadrics, volumes_m3


def shape_score(a: Superquadrics, b: Superquadrics, *, sigma_geo: float = 1.0) -> float:
    """Return s_geo of Eq. (sgeo) over the best one-to-one matching, in 0..1; 0 where either has no primitive."""
    # Symmetric in `a` and `b`; independent of their poses, of the order of their primitives and of equal
    # parameterisations. A matched pair weighs the smaller of its two shares of volume.
    if len(a) == 0 or len(b) == 0:
        return 0.0
    one, other = _features(a), _features(b)
    weighted = _pair_scores(one, other, sigma_geo) * np.minimum(one[:, None, 5], other[None, :, 5])
    rows, columns = linear_sum_assignment(weighted, maximize=True)
    return float(min(weighted[rows, columns].sum(), 1.0))


def _features(primitives: Superquadrics) -> NDArray[np.float64]:
    volumes = volumes_m3(primitives)
    return np.column_stack([primitives.exponents, primitives.semi_axes_m, volumes / max(volumes.sum(), 1e-300)])


@kernel
def _pair_scores(a, b, sigma):
    out = np.zeros((len(a), len(b)))
    for i in range(len(a)):
        for j in range(len(b)):
            best = _over_orders(a[i, 0], a[i, 1], a[i, 2:5], b[j, 0], b[j, 1], b[j, 2:5], sigma)
            for swap in range(2):
                one, other = (b[j], a[i]) if swap else (a[i], b[j])
                likeness = min(one[2], one[3]) / max(one[2], one[3])
                if one[1] > 1.0 and likeness > 0.0:
                    # A column of equal axes, turned by 45 degrees: exact for a diamond and for a circle.
                    axis = np.sqrt(one[2] * one[3]) * (1.0 - (one[1] - 1.0) * (1.0 - 0.70710678))
                    turned = np.array([axis, axis, one[4]])
                    score = _over_orders(one[0], 2.0 - one[1], turned, other[0], other[1], other[2:5], sigma)
                    best = max(best, score * likeness)
            out[i, j] = best
    return out


@kernel
def _over_orders(e1, e2, axes, f1, f2, other, sigma):
    # The outline in the plane of x and y is drawn by e2, in the two others by e1: |de1| + |de2| of the paper is the
    # mean difference over the two upright planes plus the level one, which has a meaning for any order of axes.
    best = 0.0
    for z in range(3):
        # The axis of the other that lies on z, and the two orders of the rest.
        x, y = (z + 1) % 3, (z + 2) % 3
        for _ in range(2):
            if z == 2:
                gap = abs(e1 - f1) + abs(e2 - f2)
            else:
                from_one = abs(e2 - f1) + 0.5 * (abs(e1 - f2) + abs(e1 - f1))
                from_other = abs(f2 - e1) + 0.5 * (abs(f1 - e2) + abs(f1 - e1))
                gap = 0.5 * (from_one + from_other)
            ratio = (
                min(axes[0], other[x]) / max(axes[0], other[x])
                + min(axes[1], other[y]) / max(axes[1], other[y])
                + min(axes[2], other[z]) / max(axes[2], other[z])
            ) / 3.0
            best = max(best, ratio * np.exp(-gap / sigma))
            x, y = y, x
    return best
