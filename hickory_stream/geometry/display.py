"""Display: colours of ids and features, labels without overlap, and the nearest camera that sees all points."""

import colorsys
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_GOLDEN_RATIO = 0.6180339887498949
_SATURATIONS = (0.72, 0.5, 0.88)


def color_of_id(object_id: int, *, is_fixture: bool = False) -> tuple[int, int, int]:
    """Return the (r, g, b) uint8 colour of an object; hues step by the golden ratio, so that neighbours differ.

    Fixtures are blue-grey, and differ in brightness alone.
    """
    step = (0.07 + object_id * _GOLDEN_RATIO) % 1.0
    if is_fixture:
        r, g, b = colorsys.hsv_to_rgb(0.59, 0.45, 0.5 + 0.35 * step)
    else:
        r, g, b = colorsys.hsv_to_rgb(step, _SATURATIONS[object_id % len(_SATURATIONS)], 0.96)
    return round(255 * r), round(255 * g), round(255 * b)


def shaded(color: tuple[int, int, int], factor: float) -> tuple[int, int, int]:
    """Return a colour made darker (factor < 1) or, up to white, lighter (factor > 1)."""
    if factor <= 1.0:
        r, g, b = (round(factor * c) for c in color)
    else:
        r, g, b = (round(255 - (255 - c) / factor) for c in color)
    return r, g, b


def readable_on_dark(color: tuple[int, int, int]) -> tuple[int, int, int]:
    """Return a colour mixed with white until text in it can be read on a dark ground (Rec. 601 luma of 185)."""
    luma = 0.299 * color[0] + 0.587 * color[1] + 0.114 * color[2]
    share = max(0.0, (185.0 - luma) / (255.0 - luma)) if luma < 255.0 else 0.0
    r, g, b = (round(c + share * (255 - c)) for c in color)
    return r, g, b


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Components:
    """The three main components of features (D,): (feature - `mean`) @ `axes` (D, 3), `low` to `low` + `extent`."""

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

    The largest entry of an axis is positive, since the sign of an eigenvector is arbitrary; missing components are 0.
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


_LEAST_DEPTH_M = 0.5


def looking(azimuth_rad: float, elevation_rad: float) -> NDArray[np.float64]:
    """Return world_from_camera's rotation for an eye that stands at an azimuth and looks down by the elevation."""
    c, s = np.cos(azimuth_rad), np.sin(azimuth_rad)
    forward = np.array([-c * np.cos(elevation_rad), -s * np.cos(elevation_rad), -np.sin(elevation_rad)])
    right = np.array([-s, c, 0.0])
    return np.stack([right, np.cross(forward, right), forward], axis=1)


def nearest_eye(
    points_world: NDArray[Any], rotation: NDArray[np.float64], tangents: tuple[float, float]
) -> NDArray[np.float64]:
    """Return the (3,) place of the nearest eye that has all (N, 3) points in its frame.

    `rotation` is world_from_camera's (x right, y down, z forward); `tangents` of half the angles of view: side, up.
    """
    local = np.asarray(points_world, dtype=np.float64) @ rotation
    tan_x, tan_y = tangents
    # A point is within the right border when x - eye_x <= tan (z - eye_z): four bounds, two by two on one line.
    right, left = (local[:, 0] - tan_x * local[:, 2]).max(), (-local[:, 0] - tan_x * local[:, 2]).max()
    below, above = (local[:, 1] - tan_y * local[:, 2]).max(), (-local[:, 1] - tan_y * local[:, 2]).max()
    depth = min(-(right + left) / (2 * tan_x), -(below + above) / (2 * tan_y), local[:, 2].min() - _LEAST_DEPTH_M)
    return np.asarray(rotation @ np.array([(right - left) / 2, (below - above) / 2, depth]))


def rises(centers: NDArray[np.float64], sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (N,) how far up each label moves, so that none overlap; `centers` (N, 2), y down, `sizes` (N, 2)."""
    half = np.asarray(sizes, dtype=np.float64) / 2
    found = np.zeros(len(centers))
    placed = np.empty((0, 4))
    for i in np.argsort(-centers[:, 1], kind="stable"):
        (x, y), (w, h) = centers[i], half[i]
        beside = placed[(placed[:, 0] < x + w) & (x - w < placed[:, 2])]
        # From the lowest up: each that is in the way is passed, and none that was passed can be met again.
        for _, top, _, bottom in beside[np.argsort(-beside[:, 3], kind="stable")]:
            if top < y + h and y - h < bottom:
                y = top - h
        found[i] = centers[i, 1] - y
        placed = np.vstack([placed, (x - w, y - h, x + w, y + h)])
    return found
