"""Footprints (rectangles) on a horizontal surface: an exact and fast test of whether a place is free."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hickory_stream.worlds.object_models import Model


def rectangle(half_m: tuple[float, float], at: tuple[float, float], yaw_rad: float) -> NDArray[np.float64]:
    """Return the (4, 2) corners of a turned rectangle, counter-clockwise."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    x, y = half_m
    corners = np.array([[x, y], [-x, y], [-x, -y], [x, -y]])
    return np.asarray(corners @ np.array([[c, s], [-s, c]]) + at)


def corners_of(model: Model, frame_from_model: NDArray[np.float64], grow_m: float = 0.0) -> NDArray[np.float64]:
    """Return the (4, 2) corners of an upright model's bounds in the frame that it is placed in."""
    (x0, y0, _), (x1, y1, _) = model.bounds_m() + np.array([[-grow_m], [grow_m]])
    corners = np.array([[x1, y1], [x0, y1], [x0, y0], [x1, y0]])
    return np.asarray(corners @ frame_from_model[:2, :2].T + frame_from_model[:2, 3])


def do_overlap(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    """Return whether convex outlines (K, 2), (L, 2) overlap by more than a border (separating axis theorem)."""
    for one in (a, b):
        edges = np.roll(one, -1, axis=0) - one
        normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1)
        of_a, of_b = a @ normals.T, b @ normals.T
        slack = 1e-6 * np.abs(normals).sum(axis=1)
        apart = (of_a.max(axis=0) <= of_b.min(axis=0) + slack) | (of_b.max(axis=0) <= of_a.min(axis=0) + slack)
        if apart.any():
            return False
    return True


@dataclass(frozen=True, slots=True)
class Taken:
    """The occupied rectangles on one surface."""

    corners: list[NDArray[np.float64]] = field(default_factory=list)

    def take(self, corners: NDArray[np.float64]) -> bool:
        if any(do_overlap(corners, other) for other in self.corners):
            return False
        self.corners.append(corners)
        return True
