"""One representative of the many equal parameterisations of a superquadric.

The rule, in this order:

1. A column of equal axes with e2 > 1 is written as its dual, turned by 45 degrees about z with 2 - e2, where this is a
   body the same to within `DUAL_TOLERANCE` of its radius: near a circle and near a square.
2. For e1 = e2 every order of the axes is the same body: the semi-axes fall. Else x and y may change places: a1 >= a2.
3. Of the rotations that are left (half turns; quarter turns about z for a1 = a2) it is the one closest to the frame's
   own axes, and of equally close ones the one whose matrix, row by row, is largest.
4. Primitives come by volume, largest first; of equal volumes by their semi-axes, then exponents, then centres.

All but the first step leave the body exactly as it is.
"""

from __future__ import annotations

from itertools import permutations, product
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry import portable
from hickory_stream.geometry.portable_kernels import power
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.geometry.superquadric import MIN_EXPONENT, Superquadrics, taken, volumes_m3

if TYPE_CHECKING:
    from numpy.typing import NDArray

# How far, in shares of the radius, the dual may be from the body that it replaces.
DUAL_TOLERANCE = 0.02
# Exponents and ratios of semi-axes that differ by less are equal.
_EQUAL = 1e-6
_ROUGHLY_EQUAL = 0.01


def canonical(primitives: Superquadrics) -> Superquadrics:
    """Return the same bodies in canonical form: one set of parameters for each, in a stated order."""
    rows = [_canonical_one(primitives, i) for i in range(len(primitives))]
    if not rows:
        return primitives
    found = Superquadrics(
        exponents=np.stack([exponents for exponents, _, _ in rows]),
        semi_axes_m=np.stack([axes for _, axes, _ in rows]),
        world_from_local=np.stack([pose for _, _, pose in rows]),
    )
    return taken(found, _order(found))


def _canonical_one(
    primitives: Superquadrics, index: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the exponents (2,), the semi-axes (3,) and the pose (4, 4) of one primitive."""
    exponents, axes = primitives.exponents[index].copy(), primitives.semi_axes_m[index].copy()
    pose = primitives.world_from_local[index]
    rotation = pose[:3, :3]
    if exponents[1] > 1 and abs(axes[0] - axes[1]) <= _ROUGHLY_EQUAL * axes[:2].max():
        dual = max(2 - float(exponents[1]), MIN_EXPONENT)
        if _dual_gap(float(exponents[1]), dual) <= DUAL_TOLERANCE:
            axes[:2] *= power(2.0, (1 - exponents[1]) / 2)
            exponents[1] = dual
            c = np.sqrt(0.5)
            rotation = portable.matmul(rotation, np.array([[c, -c, 0], [c, c, 0], [0, 0, 1.0]]))
    orders = permutations(range(3)) if abs(exponents[0] - exponents[1]) <= _EQUAL else ((0, 1, 2), (1, 0, 2))
    forms = [(tuple(axes[list(order)]), order) for order in orders]
    largest = max(form for form, _ in forms)
    equal = [order for form, order in forms if np.allclose(form, largest, rtol=_EQUAL, atol=0)]
    turned = _closest_to_identity([rotation[:, list(order)] for order in equal])
    return exponents, np.array(largest), from_rotation_translation(turned, pose[:3, 3])


def _closest_to_identity(candidates: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return the candidate, with the signs of its columns that make it a rotation, of largest trace."""
    signed = [c * np.array(signs) for c in candidates for signs in product((1.0, -1.0), repeat=3)]
    proper = [c for c in signed if portable.det3(c) > 0]
    return max(proper, key=lambda c: (round(float(np.trace(c)), 9), *np.round(c, 9).ravel()))


def _dual_gap(exponent: float, dual: float) -> float:
    """Return the largest relative difference of radius between an outline and its dual, over all directions."""
    angles = np.linspace(0, np.pi / 4, 17)
    first = _radius(angles, exponent)
    second = power(2.0, (1 - exponent) / 2) * _radius(np.pi / 4 - angles, dual)
    return float(np.abs(second / first - 1).max())


def _radius(angles: NDArray[np.float64], exponent: float) -> NDArray[np.float64]:
    p = 2 / exponent
    c, s = np.abs(portable.cos(angles)), np.abs(portable.sin(angles))
    return portable.power(portable.power(c, p) + portable.power(s, p), -1 / p)


def _order(primitives: Superquadrics) -> NDArray[np.int64]:
    # Six digits: what is equal but for rounding is ordered by the next rule.
    def rounded(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.array([float(f"{value:.5e}") for value in values.ravel().tolist()]).reshape(values.shape)

    keys = [rounded(volumes_m3(primitives)), *rounded(primitives.semi_axes_m).T]
    keys += [*rounded(primitives.exponents).T, *primitives.world_from_local[:, :3, 3].T]
    return np.asarray(np.lexsort([-key for key in reversed(keys)]))
