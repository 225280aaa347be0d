"""Mirror planes and vertical axes of objects seen from one side, to complete their unseen side.

The score of a plane: mirrored surface in observed free space, on measured surface, and the growth of the object. The
front of a round object is a semicircle in the view from above; if an arc fits it better than a line, it is rotated by
180 degrees to form the back, unless the views observed free space there.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.geometry import portable
from hickory_stream.geometry.portable_kernels import cos, sin
from hickory_stream.geometry.rigid import apply
from hickory_stream.shapes.reconstruct.tsdf import DepthView

# A plane is rejected with more than this share of the mirrored points in observed free space.
_MAX_MIRRORED_CONTRADICTION = 0.1
# Penalties of the score, which is the share of mirrored points on measured surface: for each doubling of the extent,
# and for the share in free space.
GROWTH_PENALTY = 0.6
_CONTRADICTION_PENALTY = 4.0
# Maximum number of points that are mirrored.
_MAX_POINTS = 800


@dataclass(frozen=True, kw_only=True, slots=True)
class SymmetryConfig(Ranged):
    """How mirror planes are searched."""

    #: Number of directions that are tried over 180 degrees.
    num_yaws: int = number(36, 1, 720, "directions")
    #: Number of positions that are tried along each direction, from the middle of the visible extent to its ends.
    num_offsets: int = number(9, 1, 1000, "places")


def mirror_plane(
    points_world: NDArray[np.float64],
    views: list[DepthView],
    tolerance_m: float,
    min_score: float,
    config: SymmetryConfig,
) -> NDArray[np.float64] | None:
    """Return world_from_mirrored (4, 4), the reflection about the best vertical plane; None if none is plausible."""
    points = points_world[:: max(len(points_world) // _MAX_POINTS, 1)]
    best, best_score = None, min_score
    for yaw in np.pi * np.arange(config.num_yaws) / config.num_yaws:
        normal = np.array([cos(float(yaw)), sin(float(yaw)), 0.0])
        along = portable.matmul(points, normal)
        low, high = np.quantile(along, [0.01, 0.99])
        for offset in _offsets(low, high, config.num_offsets):
            reflection = reflection_about(normal, offset)
            mirrored = apply(reflection, points)
            overlap, contradiction = shares_against(mirrored, views, tolerance_m)
            if contradiction > _MAX_MIRRORED_CONTRADICTION:
                continue
            grown = (max(high, 2 * offset - low) - min(low, 2 * offset - high)) / max(high - low, tolerance_m) - 1
            score = overlap - GROWTH_PENALTY * grown - _CONTRADICTION_PENALTY * contradiction
            if score > best_score:
                best, best_score = reflection, score
    return best


def reflection_about(normal: NDArray[np.float64], offset_m: float) -> NDArray[np.float64]:
    """Return the (4, 4) reflection about the plane normal . p = offset; the normal has unit length."""
    reflection = np.eye(4)
    reflection[:3, :3] -= 2 * np.outer(normal, normal)
    reflection[:3, 3] = 2 * offset_m * normal
    return reflection


def _offsets(low: float, high: float, count: int) -> NDArray[np.float64]:
    return np.concatenate([np.linspace((low + high) / 2, end, count // 2 + 1)[i:] for i, end in ((0, low), (1, high))])


def shares_against(mirrored: NDArray[np.float64], views: list[DepthView], tolerance_m: float) -> tuple[float, float]:
    """Return the shares of (N, 3) world points on measured surface and in observed free space, by any view."""
    on_surface = np.zeros(len(mirrored), dtype=bool)
    in_free = np.zeros(len(mirrored), dtype=bool)
    for view in views:
        states = _against(apply(view.camera_from_world, mirrored), view, tolerance_m)
        on_surface |= states == 1
        in_free |= states == 2
    return float(on_surface.mean()), float(in_free.mean())


def _against(points: NDArray[np.float64], view: DepthView, tolerance_m: float) -> NDArray[np.uint8]:
    # 1 on the object's surface, 2 in free space, 0 occluded or unknown.
    camera, out = view.camera, np.zeros(len(points), np.uint8)
    ahead_of = np.flatnonzero(points[:, 2] > 0.05)
    x, y, z = points[ahead_of].T
    column = np.floor(x / z * camera.fx + camera.cx + 0.5).astype(np.int64)
    row = np.floor(y / z * camera.fy + camera.cy + 0.5).astype(np.int64)
    is_in = (row >= 0) & (column >= 0) & (row < view.depth_m.shape[0]) & (column < view.depth_m.shape[1])
    # The crop contains the whole mask: beside the mask there is no object.
    out[ahead_of[~is_in]] = 2
    seen, at = ahead_of[is_in], (row[is_in], column[is_in])
    ahead = view.depth_m[at] - z[is_in]
    out[seen[(np.abs(ahead) <= tolerance_m) & view.mask[at]]] = 1
    out[seen[ahead > tolerance_m]] = 2
    return out


# A front is measured in this many bins across its width.
_FRONT_BINS = 13
# Maximum RMS misfit of the arc, as a share of the radius, and as a ratio to the misfit of a line.
_MAX_ARC_MISFIT = 0.11
_MAX_ARC_RATIO = 0.7
# Maximum share of the rotated points in observed free space; of open objects, such as a bin from above, some are.
_MAX_TURNED_CONTRADICTION = 0.3


def half_turn_of(
    points_world: NDArray[np.float64], camera_world: NDArray[np.float64], views: list[DepthView], tolerance_m: float
) -> NDArray[np.float64] | None:
    """Return world_from_turned (4, 4), the rotation by 180 degrees about an object's axis; None if it is not round.

    `points_world` (N, 3) were seen from `camera_world` (3,); `views` define free space, `tolerance_m` is their noise.
    """
    forward = points_world[:, :2].mean(axis=0) - camera_world[:2]
    distance = portable.norm(forward)
    if distance < 1e-6:
        return None
    forward /= distance
    sideways = np.array([-forward[1], forward[0]])
    seen = points_world[:, :2] - camera_world[:2]
    axis = _axis(portable.matmul(seen, sideways), portable.matmul(seen, forward))
    if axis is None:
        return None
    middle, depth = axis
    center = camera_world[:2] + depth * forward + middle * sideways
    turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    turn[:2, 3] = 2 * center
    _, in_free = shares_against(apply(turn, points_world[:: max(len(points_world) // 800, 1)]), views, tolerance_m)
    return turn if in_free <= _MAX_TURNED_CONTRADICTION else None


def _axis(across: NDArray[np.float64], ahead: NDArray[np.float64]) -> tuple[float, float] | None:
    # Across and ahead in the view from above; None if the front is not round.
    low, high = np.quantile(across, [0.01, 0.99])
    radius, middle = (high - low) / 2, (high + low) / 2
    if not radius > 0:
        return None
    place = (across - low) / (2 * radius) * _FRONT_BINS
    fronts, places = [], []
    for n in range(_FRONT_BINS):
        mine = ahead[(place >= n) & (place < n + 1)]
        if len(mine) >= 3:
            fronts.append(float(np.quantile(mine, 0.1)))
            places.append(low + (n + 0.5) / _FRONT_BINS * 2 * radius - middle)
    if len(fronts) < 0.8 * _FRONT_BINS:
        return None
    front, offset = np.array(fronts), np.array(places)
    arc = np.sqrt(np.maximum(np.square(1.02 * radius) - np.square(offset), 0.0))
    depth = float(np.median(front + arc))
    misfit = float(np.sqrt(np.mean(np.square(front + arc - depth))))
    flat_misfit = float(np.sqrt(np.mean(np.square(_off_the_line(offset, front)))))
    if misfit > _MAX_ARC_MISFIT * radius or misfit > _MAX_ARC_RATIO * flat_misfit:
        return None
    return float(middle), depth


def _off_the_line(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y = x - x.mean(), y - y.mean()
    return np.asarray(y - portable.dot(x, y) / max(portable.dot(x, x), 1e-300) * x)
