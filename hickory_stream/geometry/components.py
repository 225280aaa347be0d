"""Features as colours: the first three principal components as red, green and blue."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Components:
    """Where three components begin (`low`, (3,)) and how far they reach (`extent`, (3,)).

    `mean` (D,) and `axes` (D, 3): a feature's components are (feature - mean) @ axes.
    """

    mean: NDArray[np.float64]
    axes: NDArray[np.float64]
    low: NDArray[np.float64]
    extent: NDArray[np.float64]

    @property
    def dim(self) -> int:
        """The length D of a feature."""
        return len(self.mean)

    def colors(self, features: NDArray[np.float32]) -> NDArray[np.uint8]:
        """Return (..., 3) uint8 colours of (..., D) features; what lies beyond the ends is held there."""
        values = ((features - self.mean) @ self.axes - self.low) / self.extent
        return np.asarray(np.rint(255 * np.clip(np.nan_to_num(values), 0, 1)), dtype=np.uint8)


def main_components(features: NDArray[np.float32]) -> Components:
    """Return the three main components of (..., D) features, between their 2nd and 98th percentiles.

    Axes point so that their largest entry is positive: the sign of an eigenvector is an accident. Where D is below 3 or
    the features span less, the missing ones are 0.
    """
    flat = features.reshape(-1, features.shape[-1]).astype(np.float64)
    mean = flat.mean(axis=0)
    values, vectors = np.linalg.eigh((flat - mean).T @ (flat - mean))
    axes = np.zeros((len(mean), 3))
    for i, column in enumerate(np.argsort(-values, kind="stable")[:3]):
        axis = vectors[:, column]
        axes[:, i] = axis * np.sign(axis[np.abs(axis).argmax()])
    low, high = np.percentile((flat - mean) @ axes, [2, 98], axis=0)
    return Components(mean=mean, axes=axes, low=low, extent=np.maximum(high - low, 1e-9))
