"""Features of pairs of regions by name, from rows of numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    Features = dict[str, NDArray[np.float64]]
    """The features (K,) of K pairs by name."""


def named(names: Sequence[str], rows: NDArray[np.float64]) -> Features:
    """Return the columns (K,) of rows (K, len(names)) by their names."""
    return dict(zip(names, rows.T, strict=True))


def of_both(
    names: Sequence[str], rows: NDArray[np.float64], large: NDArray[np.int64], small: NDArray[np.int64]
) -> Features:
    """Return the features of both regions, `large` and `small` (K,), of pairs, from rows (n, len(names)) of regions."""
    both: Features = {}
    for name, of_large, of_small in zip(names, rows[large].T, rows[small].T, strict=True):
        both[f"large_{name}"], both[f"small_{name}"] = of_large, of_small
    return both
