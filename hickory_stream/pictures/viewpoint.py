"""Viewpoints of pictures: from above, or from a raised position that shows everything."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.geometry.display import looking, nearest_eye
from hickory_stream.geometry.rigid import apply, from_rotation_translation, invert

_HALF_FOV_TANGENT = np.tan(np.deg2rad(16.0))


def corners_of(boxes: Sequence[OrientedBox]) -> NDArray[np.float64]:
    """Return the corners (N, 3) of all boxes, or those of a cube of 2 m without any."""
    if not boxes:
        return np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (0.0, 1.0)])
    return np.concatenate([box.corners_world() for box in boxes])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Viewpoint:
    """A camera (x right, y down, z forward) with an unbounded image."""

    world_from_camera: NDArray[np.float64]
    #: focal length of a perspective view, pixels per metre of an orthographic one
    focal_px: float
    is_orthographic: bool
    width: int
    height: int

    def __post_init__(self) -> None:
        freeze(self, "world_from_camera", np.float64, (4, 4))

    def rays(self, places_px: NDArray[Any]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the origins and unit directions, (N, 3) each, of the rays through (N, 2) positions in the image."""
        rotation = self.world_from_camera[:3, :3].astype(np.float32)
        offsets = (
            places_px.astype(np.float32) - np.array([self.width, self.height], dtype=np.float32) / 2
        ) / np.float32(self.focal_px)
        sideways = offsets @ rotation[:, :2].T
        eye, forward = self.world_from_camera[:3, 3].astype(np.float32), rotation[:, 2]
        if self.is_orthographic:
            return _f32(sideways + eye), _f32(np.broadcast_to(forward, sideways.shape))
        directions = sideways + forward
        directions /= np.sqrt(np.einsum("nc,nc->n", directions, directions))[:, None]
        return _f32(np.broadcast_to(eye, directions.shape)), _f32(directions)

    def centers_px(self) -> NDArray[np.float32]:
        """Return the (H * W, 2) centres of the pixels, row by row."""
        row, column = np.indices((self.height, self.width), dtype=np.float32)
        return np.stack([column.reshape(-1), row.reshape(-1)], axis=1) + np.float32(0.5)

    def project(self, points_world: NDArray[Any]) -> NDArray[np.float64]:
        """Return the (N, 2) pixels of (N, 3) points in front of the camera."""
        camera = apply(invert(self.world_from_camera), np.asarray(points_world, dtype=np.float64))
        depth = 1.0 if self.is_orthographic else camera[:, 2:3]
        return camera[:, :2] / depth * self.focal_px + (self.width / 2, self.height / 2)

    def towards_eye(self, points_world: NDArray[Any]) -> NDArray[np.float64]:
        """Return the (N, 3) unit directions from points to the camera."""
        if self.is_orthographic:
            return np.broadcast_to(-self.world_from_camera[:3, 2], (len(points_world), 3))
        offsets = self.world_from_camera[:3, 3] - points_world
        return np.asarray(offsets / np.linalg.norm(offsets, axis=1, keepdims=True))

    def pixel_m(self, points_world: NDArray[Any]) -> float:
        """Return the side of a pixel, in metres, at the nearest of (N, 3) points in front of the camera."""
        if self.is_orthographic:
            return 1.0 / self.focal_px
        depths = (points_world - self.world_from_camera[:3, 3]) @ self.world_from_camera[:3, 2]
        return float(depths.min(initial=np.inf, where=depths > 0)) / self.focal_px if (depths > 0).any() else 0.0


def from_above(points_world: NDArray[Any], width: int, height: int, margin_px: int) -> Viewpoint:
    """Return the orthographic view from above, x to the right and y up, with all (N, 3) points in the frame."""
    low, high = points_world.min(axis=0), points_world.max(axis=0)
    middle = (low + high) / 2
    rotation = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    eye = np.array([middle[0], middle[1], high[2] + 5.0])
    room = np.array([width, height]) - 2 * margin_px
    return Viewpoint(
        world_from_camera=from_rotation_translation(rotation, eye),
        focal_px=float((room / np.maximum(high - low, 0.5)[:2]).min()),
        is_orthographic=True,
        width=width,
        height=height,
    )


def from_corner(
    points_world: NDArray[Any], azimuth_rad: float, elevation_rad: float, width: int, height: int, margin_px: int
) -> Viewpoint:
    """Return the closest perspective view along a direction that has all (N, 3) points in the frame."""
    rotation = looking(azimuth_rad, elevation_rad)
    focal_px = (height / 2) / _HALF_FOV_TANGENT
    tangents = (width / 2 - margin_px) / focal_px, (height / 2 - margin_px) / focal_px
    eye = nearest_eye(points_world, rotation, tangents)
    return Viewpoint(
        world_from_camera=from_rotation_translation(rotation, eye),
        focal_px=float(focal_px),
        is_orthographic=False,
        width=width,
        height=height,
    )


def _f32(values: NDArray[Any]) -> NDArray[np.float32]:
    return values.astype(np.float32, copy=False)
