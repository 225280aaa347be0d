"""Pinhole cameras from `CameraInfo` messages, and rectification of images.

In ROS, `K` and `D` describe the raw image and `P` the rectified one; the topic's name says which an image is.
All three are of the whole sensor; an image is its region of interest, binned, or has been resized since.
"""

from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import CalibrationError
from hickory_stream.geometry.camera import Camera
from players.messages.records import CameraInfo

# librealsense's three kinds of Brown and Conrady: its inverse one is today computed as the plain one.
_REALSENSE = ("brown_conrady", "inverse_brown_conrady", "modified_brown_conrady")
_FISHEYE = ("equidistant", "fisheye", "kannala_brandt4", "kannala_brandt", "opencv_fisheye", "equi")
_RADIAL = ("plumb_bob", "rational_polynomial", "", "radtan", "opencv", *_REALSENSE)
# Numbers of coefficients that OpenCV takes.
_FISHEYE_LENGTHS, _RADIAL_LENGTHS = (4,), (4, 5, 8, 12, 14)
_MOST_COEFFICIENT = 1e4
# Beyond this share of both sides, or within the rest of it, a principal point is of another size of image.
_OFF_CENTER, _LEAST_FOCAL = 0.7, 0.1


@dataclass(frozen=True)
class Lens:
    """A pinhole camera and, if its images are distorted, the distortion coefficients."""

    camera: Camera
    distortion: tuple[float, ...] = ()
    is_fisheye: bool = False
    #: How the calibration was fitted to the images, "" if it was not.
    note: str = field(default="", compare=False)

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
    """Return the lens of a calibration for images of `image_size`, None if it is unknown.

    Raises `CalibrationError`: it has no focal length, no size, or coefficients or a model that cannot be used.
    """
    matrix = info.P if is_rectified and info.P[0, 0] > 0 and info.D.any() else info.K
    size = info.size if all(info.size) else image_size
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0 and np.isfinite(matrix).all()):
        raise CalibrationError(
            f"{topic} holds no intrinsics (K = {np.array2string(info.K.ravel(), precision=1)}); "
            "name another topic with --color-info-topic or --depth-info-topic"
        )
    if size is None:
        raise CalibrationError(f"{topic} has no image size, and the first image of its camera is torn")
    (fx, _, cx), (_, fy, cy) = matrix[:2, :3].tolist()
    check_center(Camera(width=size[0], height=size[1], fx=fx, fy=fy, cx=cx, cy=cy), topic)
    x, y, width, height = info.region
    if not (width and height and x + width <= size[0] and y + height <= size[1]):
        x, y, width, height = 0, 0, *size
    binned = (width // info.binning[0], height // info.binning[1])
    note = ""
    # Some drivers publish the calibration of the binned or cropped image itself.
    if image_size in (None, binned) or image_size != size:
        note = f"region {width}x{height} at {x}, {y}, binned to {binned[0]}x{binned[1]}" if binned != size else ""
        scale_x, scale_y = 1 / info.binning[0], 1 / info.binning[1]
        fx, fy, cx, cy = fx * scale_x, fy * scale_y, (cx - x) * scale_x, (cy - y) * scale_y
        size = binned
    camera = Camera(width=size[0], height=size[1], fx=fx, fy=fy, cx=cx, cy=cy)
    if image_size is not None and has_shape(camera, image_size):
        note = note if image_size == size else f"scaled from {size[0]}x{size[1]} to {image_size[0]}x{image_size[1]}"
        camera = scaled(camera, image_size)
    if is_rectified or not info.D.any():
        return Lens(camera, note=note)
    model = info.distortion_model.lower().replace(" ", "_").replace("-", "_")
    if model not in (*_FISHEYE, *_RADIAL):
        known = ", ".join((*_RADIAL[:2], *_FISHEYE[:3]))
        raise CalibrationError(f"{topic} has the distortion model {info.distortion_model!r}; known are {known}")
    distortion = _coefficients(info, topic, _FISHEYE_LENGTHS if model in _FISHEYE else _RADIAL_LENGTHS)
    return Lens(camera, distortion, model in _FISHEYE, note)


def check_center(camera: Camera, where: str) -> None:
    """Check that intrinsics are those of images of their size. Raises `CalibrationError`: they are not, by far."""
    center = np.array([(camera.cx + 0.5) / camera.width, (camera.cy + 0.5) / camera.height])
    if (center > _OFF_CENTER).all() or (center < 1 - _OFF_CENTER).all() or camera.fx < _LEAST_FOCAL * camera.width:
        raise CalibrationError(
            f"{where}: fx {camera.fx:g}, cx {camera.cx:g}, cy {camera.cy:g} are not those of images of "
            f"{camera.width}x{camera.height} pixels: they were never written, or are of another size; "
            "give the intrinsics of these images"
        )


def has_shape(camera: Camera, size: tuple[int, int]) -> bool:
    """Return whether images of (width, height) have the camera's ratio of sides, to a pixel."""
    return abs(size[0] * camera.height - size[1] * camera.width) <= max(camera.width, camera.height, *size)


def scaled(camera: Camera, size: tuple[int, int]) -> Camera:
    """Return the camera of the same images, resized to (width, height); pixel centres are at integer coordinates."""
    if size == (camera.width, camera.height):
        return camera
    x, y = size[0] / camera.width, size[1] / camera.height
    cx, cy = (camera.cx + 0.5) * x - 0.5, (camera.cy + 0.5) * y - 0.5
    return Camera(width=size[0], height=size[1], fx=camera.fx * x, fy=camera.fy * y, cx=cx, cy=cy)


def _coefficients(info: CameraInfo, topic: str, lengths: tuple[int, ...]) -> tuple[float, ...]:
    # In the order of OpenCV, whose models differ in their numbers of coefficients only: zeros complete them.
    d = np.trim_zeros(info.D, "b")
    length = next((number for number in lengths if number >= len(d)), None)
    if length is None or not (np.abs(d) < _MOST_COEFFICIENT).all():
        raise CalibrationError(
            f"{topic}: D = {np.array2string(info.D, precision=3, max_line_width=1000)} cannot be used; expected at "
            f"most {lengths[-1]} coefficients of {info.distortion_model or 'plumb_bob'}, all finite"
        )
    return tuple(np.pad(d, (0, length - len(d))).tolist())
