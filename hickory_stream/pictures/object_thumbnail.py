"""Small pictures of single objects, ray cast on the CPU from one side for comparison."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.pictures.raycast import Scene, Surface

_BACKGROUND = np.array([236, 238, 242], dtype=np.float64)
_ELEVATION_RAD = np.radians(28)
_FILL = 0.62


@dataclass(frozen=True, kw_only=True, slots=True)
class CloseUp:
    """An orthographic view: its centre, half its width, and its direction."""

    center_m: tuple[float, float, float]
    half_m: float
    azimuth_rad: float
    size_px: int = 200


def close_up_of(vertices: NDArray[Any], azimuth_rad: float, size_px: int = 200) -> CloseUp:
    """Return the view that shows all of (N, 3) vertices."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    x, y, z = ((low + high) / 2).tolist()
    return CloseUp(
        center_m=(x, y, z), half_m=_FILL * float(np.linalg.norm(high - low)), azimuth_rad=azimuth_rad, size_px=size_px
    )


def draw(surfaces: Sequence[Surface], view: CloseUp) -> NDArray[np.uint8]:
    """Return the (S, S, 3) picture of surfaces, with four rays per pixel."""
    size = 2 * view.size_px
    c, s = np.cos(view.azimuth_rad), np.sin(view.azimuth_rad)
    ce, se = np.cos(_ELEVATION_RAD), np.sin(_ELEVATION_RAD)
    towards_eye = np.array([c * ce, s * ce, se])
    right = np.array([-s, c, 0.0])
    up = np.cross(towards_eye, right)
    steps = (np.arange(size) + 0.5) / size * 2 - 1
    across, down = np.meshgrid(steps, -steps)
    far = 4 * view.half_m
    plane = across[..., None] * right + down[..., None] * up
    origins = np.asarray(view.center_m) + view.half_m * plane.reshape(-1, 3) + far * towards_eye
    hits = Scene(surfaces).cast(origins, np.broadcast_to(-towards_eye, origins.shape))
    light = 0.38 + 0.42 * np.clip(hits.normals @ towards_eye, 0, 1) + 0.25 * np.clip(hits.normals[:, 2], 0, 1)
    is_hit = np.isfinite(hits.distance_m)[:, None]
    colors = np.where(is_hit, 255.0 * hits.colors * light[:, None], _BACKGROUND)
    pixels = colors.reshape(view.size_px, 2, view.size_px, 2, 3).mean(axis=(1, 3))
    return np.clip(pixels, 0, 255).astype(np.uint8)
