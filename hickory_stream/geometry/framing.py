"""The nearest camera position from which all points are within the image."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

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

    `rotation` is world_from_camera's (x right, y down, z forward); `tangents` are those of half the angles of view, to
    the side and up.
    """
    local = np.asarray(points_world, dtype=np.float64) @ rotation
    tan_x, tan_y = tangents
    # A point is within the right border when x - eye_x <= tan (z - eye_z): four bounds, two by two on one line.
    right, left = (local[:, 0] - tan_x * local[:, 2]).max(), (-local[:, 0] - tan_x * local[:, 2]).max()
    below, above = (local[:, 1] - tan_y * local[:, 2]).max(), (-local[:, 1] - tan_y * local[:, 2]).max()
    depth = min(-(right + left) / (2 * tan_x), -(below + above) / (2 * tan_y), local[:, 2].min() - _LEAST_DEPTH_M)
    return np.asarray(rotation @ np.array([(right - left) / 2, (below - above) / 2, depth]))
