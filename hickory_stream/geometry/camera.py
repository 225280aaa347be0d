"""The pinhole camera: x right, y down, z forward; images are rectified before they reach a `Camera`."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

MOST_SIDE_PX = 1 << 15
"""More than any camera has; memory is taken for what a calibration claims."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Camera:
    """Pinhole intrinsics in pixels; pixel centres are at integer coordinates."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        if not (1 <= self.width <= MOST_SIDE_PX and 1 <= self.height <= MOST_SIDE_PX):
            raise ValueError(f"camera of {self.width} x {self.height} pixels; expected 1 to {MOST_SIDE_PX} on a side")
        if not (self.fx > 0 and self.fy > 0 and np.isfinite([self.fx, self.fy, self.cx, self.cy]).all()):
            raise ValueError(f"focal lengths must be positive and finite, found fx {self.fx}, fy {self.fy}")

    @property
    def K(self) -> NDArray[np.float64]:
        """The (3, 3) intrinsic matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def scaled(self, factor: float) -> "Camera":
        """Return the camera of the image resized by `factor` (both sides rounded)."""
        width, height = round(self.width * factor), round(self.height * factor)
        sx, sy = width / self.width, height / self.height
        return Camera(
            width=width,
            height=height,
            fx=self.fx * sx,
            fy=self.fy * sy,
            cx=(self.cx + 0.5) * sx - 0.5,
            cy=(self.cy + 0.5) * sy - 0.5,
        )

    def cropped(self, x0: int, y0: int, x1: int, y1: int) -> "Camera":
        """Return the camera of the image part [y0:y1, x0:x1]."""
        return Camera(width=x1 - x0, height=y1 - y0, fx=self.fx, fy=self.fy, cx=self.cx - x0, cy=self.cy - y0)


def whole_reduction(width_px: int) -> int:
    """Return the factor that reduces images of a width to about 640 pixels, for which settings in pixels are made."""
    return max(1, round(width_px / 640))


def backproject(depth_m: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """Return (H, W, 3) float32 camera points of a depth image; NaN where there is no return."""
    u = ((np.arange(camera.width) - camera.cx) / camera.fx).astype(np.float32)
    v = ((np.arange(camera.height) - camera.cy) / camera.fy).astype(np.float32)
    points = np.empty((*depth_m.shape, 3), dtype=np.float32)
    np.multiply(depth_m, u[None, :], out=points[..., 0])
    np.multiply(depth_m, v[:, None], out=points[..., 1])
    points[..., 2] = depth_m
    return points


def project(points_camera: NDArray[Any], camera: Camera) -> NDArray[np.float64]:
    """Return (N, 2) pixel coordinates (x, y) of (N, 3) camera points; NaN at or behind the camera plane."""
    z = np.where(points_camera[..., 2] > 1e-6, points_camera[..., 2], np.nan).astype(np.float64)
    return np.stack(
        [points_camera[..., 0] / z * camera.fx + camera.cx, points_camera[..., 1] / z * camera.fy + camera.cy], axis=-1
    )
