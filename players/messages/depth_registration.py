"""Registration of depth into another camera, pixel by pixel, with a z-buffer.

A depth pixel is a small square of surface. It covers its projected square, slightly enlarged against holes.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import compose

_GROWTH = 1.15
"""The enlargement of a square. It closes the gaps that parallax opens between neighbours on a slanted surface."""

_MAX_MAGNIFICATION = 8.0
"""The maximum side of a square: a point close to the target's camera plane would otherwise fill the image."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Registration:
    """The transform of depth into the colour image: both cameras, and `color_from_depth` (4, 4) between them."""

    depth_camera: Camera
    color_camera: Camera
    color_from_depth: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze(self, "color_from_depth", np.float64, (4, 4))

    @property
    def is_identity(self) -> bool:
        """Whether the depth image is already registered to colour."""
        return self.depth_camera == self.color_camera and bool(np.abs(self.color_from_depth - np.eye(4)).max() < 1e-9)


def with_motion(registration: Registration, color_from_then: NDArray[np.float64]) -> Registration:
    """Return the registration of depth that was taken at another stamp than colour, while the camera moved.

    `color_from_then` (4, 4) is the transform from the colour camera at the stamp of depth to the one at its own stamp.
    """
    return replace(registration, color_from_depth=compose(color_from_then, registration.color_from_depth))


def register_depth(depth_m: NDArray[np.float32], registration: Registration) -> NDArray[np.float32]:
    """Return depth (H, W) float32 in the image of the colour camera, NaN where no depth pixel projects to."""
    if registration.is_identity:
        return depth_m
    depth, color = registration.depth_camera, registration.color_camera
    seen = _splat(
        np.ascontiguousarray(depth_m, dtype=np.float32),
        np.array([depth.fx, depth.fy, depth.cx, depth.cy]),
        np.array([color.fx, color.fy, color.cx, color.cy]),
        np.ascontiguousarray(registration.color_from_depth[:3]),
        (color.height, color.width),
    )
    return np.asarray(seen)


@kernel
def _splat(depth_m, source, target, target_from_source, size):
    # A depth pixel is a square in a z-buffer of `size`; intrinsics are (fx, fy, cx, cy).
    height, width = size
    seen = np.full((height, width), np.nan, dtype=np.float32)
    m = target_from_source
    for row in range(depth_m.shape[0]):
        for column in range(depth_m.shape[1]):
            z = float(depth_m[row, column])
            if not z > 0.0:
                continue
            x = (column - source[2]) / source[0] * z
            y = (row - source[3]) / source[1] * z
            z_seen = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
            if z_seen <= 1e-3:
                continue
            u = (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / z_seen * target[0] + target[2]
            v = (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / z_seen * target[1] + target[3]
            half_u = 0.5 * _GROWTH * min(target[0] / source[0] * z / z_seen, _MAX_MAGNIFICATION)
            half_v = 0.5 * _GROWTH * min(target[1] / source[1] * z / z_seen, _MAX_MAGNIFICATION)
            # Compared as floats first: a coordinate far outside does not fit an integer.
            if u + half_u < 0.0 or v + half_v < 0.0 or u - half_u > width - 1 or v - half_v > height - 1:
                continue
            for j in range(max(0, int(np.ceil(v - half_v))), min(height - 1, int(np.floor(v + half_v))) + 1):
                for i in range(max(0, int(np.ceil(u - half_u))), min(width - 1, int(np.floor(u + half_u))) + 1):
                    if not seen[j, i] <= z_seen:
                        seen[j, i] = z_seen
    return seen
