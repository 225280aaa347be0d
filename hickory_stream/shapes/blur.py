"""Gaussian blur of a voxel block with portable weights: SciPy's use `exp`, whose last bit depends on the processor."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from scipy import ndimage

from hickory_stream.geometry import portable

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


def gaussian_blurred(
    values: NDArray[np.float32], sigma_voxels: float, mode: Literal["reflect", "nearest"] = "reflect"
) -> NDArray[np.float32]:
    """Return the result of `scipy.ndimage.gaussian_filter`, truncated at four standard deviations."""
    radius = int(4 * sigma_voxels + 0.5)
    weights = portable.gaussian_weights(sigma_voxels, radius)
    for axis in range(values.ndim):
        values = ndimage.correlate1d(values, weights, axis=axis, mode=mode)
    return values
