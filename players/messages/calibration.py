"""Pinhole cameras from `CameraInfo` messages, and rectification of images.

In ROS, `K` and `D` describe the raw image and `P` the rectified one; the topic's name says which an image is.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import CalibrationError
from hickory_stream.geometry.camera import Camera
from players.messages.records import CameraInfo

_FISHEYE = ("equidistant", "fisheye", "kannala_brandt4")
# librealsense's three kinds of Brown and Conrady: its inverse one is today computed as the plain one.
_REALSENSE = ("brown_conrady", "inverse_brown_conrady", "modified_brown_conrady")
_RADIAL = ("plumb_bob", "rational_polynomial", "", *_REALSENSE)


@dataclass(frozen=True)
class Lens:
    """A pinhole camera and, if its images are distorted, the distortion coefficients."""

    camera: Camera
    distortion: tuple[float, ...] = ()
    is_fisheye: bool = False

    @property
    def is_distorted(self) -> bool:
        """Whether images have to be rectified."""
        return any(self.distortion)

    def rectified_color(self, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the image (H, W, 3) as the pinhole camera sees it; black where it saw nothing."""
        if not self.is_distorted:
            return rgb
        return np.asarray(cv2.remap(rgb, *self._maps, cv2.INTER_LINEAR))

    def rectified_depth(self, depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the depth (H, W) as the pinhole camera sees it: nearest pixels, since depth must not be blended."""
        if not self.is_distorted:
            return depth_m
        return np.asarray(cv2.remap(depth_m, *self._maps, cv2.INTER_NEAREST, borderValue=float("nan")))

    @cached_property
    def _maps(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        size, k, d = (self.camera.width, self.camera.height), self.camera.K, np.array(self.distortion)
        module = cv2.fisheye if self.is_fisheye else cv2
        x, y = module.initUndistortRectifyMap(k, d, np.eye(3), k, size, cv2.CV_32FC1)
        return np.asarray(x), np.asarray(y)


def lens_of(info: CameraInfo, *, topic: str, image_size: tuple[int, int] | None, is_rectified: bool) -> Lens:
    """Return the lens of a calibration; `image_size` is used if the message leaves the size unset.

    Raises `CalibrationError`: it has no focal length, no size, or an unknown distortion model.
    """
    distortion = tuple(float(d) for d in info.D)
    matrix = info.P if is_rectified and info.P[0, 0] > 0 and any(distortion) else info.K
    size = info.size if all(info.size) else image_size
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0 and np.isfinite(matrix).all()):
        raise CalibrationError(
            f"{topic} holds no intrinsics (K = {np.array2string(info.K.ravel(), precision=1)}); "
            "name another topic with --color-info-topic or --depth-info-topic"
        )
    if size is None:
        raise CalibrationError(f"{topic} has no image size, and the first image of its camera is torn")
    (fx, _, cx), (_, fy, cy) = matrix[:2, :3].tolist()
    camera = Camera(width=size[0], height=size[1], fx=fx, fy=fy, cx=cx, cy=cy)
    if is_rectified or not any(distortion):
        return Lens(camera)
    model = info.distortion_model.lower().replace(" ", "_")
    if model not in (*_FISHEYE, *_RADIAL):
        known = ", ".join((*_RADIAL[:2], *_FISHEYE))
        raise CalibrationError(f"{topic} has the distortion model {info.distortion_model!r}; known are {known}")
    return Lens(camera, distortion, model in _FISHEYE)
