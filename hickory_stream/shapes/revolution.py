"""Detection of solids of revolution with a vertical axis, whose unseen side is completed by rotation.

In the view from above, the visible front of a round object is a semicircle: half as deep as it is wide. The front of a
box is a line or a corner. If an arc fits the front better than a line, the front is rotated by 180 degrees to form the
back, unless the views observed free space there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import apply
from hickory_stream.ranges import Ranged, number
from hickory_stream.shapes.symmetry import shares_against

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.shapes.tsdf import DepthView


@dataclass(frozen=True, kw_only=True, slots=True)
class RevolutionConfig(Ranged):
    """The criteria for round fronts.

    The front is measured in `num_bins` across the width. The RMS misfit of the arc may be at most `max_misfit` of the
    radius and `max_ratio` of the misfit of a line. At most `max_contradiction` of the rotated points may lie in
    observed free space; for open objects, such as a bin seen from above, some do.
    """

    num_bins: int = number(13, 3, 1000, "bins")
    max_misfit: float = number(0.11, 0, 10, "ratio")
    max_ratio: float = number(0.7, 0, 10, "ratio")
    max_contradiction: float = number(0.3, 0, 1, "share")


def half_turn_of(
    points_world: NDArray[np.float64],
    camera_world: NDArray[np.float64],
    views: list[DepthView],
    tolerance_m: float,
    config: RevolutionConfig,
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
    axis = _axis(portable.matmul(seen, sideways), portable.matmul(seen, forward), config)
    if axis is None:
        return None
    middle, depth = axis
    center = camera_world[:2] + depth * forward + middle * sideways
    turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    turn[:2, 3] = 2 * center
    _, in_free = shares_against(apply(turn, points_world[:: max(len(points_world) // 800, 1)]), views, tolerance_m)
    return turn if in_free <= config.max_contradiction else None


def _axis(
    across: NDArray[np.float64], ahead: NDArray[np.float64], config: RevolutionConfig
) -> tuple[float, float] | None:
    """Return the position of the axis in the view from above, across and ahead; None if the front is not round."""
    low, high = np.quantile(across, [0.01, 0.99])
    radius, middle = (high - low) / 2, (high + low) / 2
    if not radius > 0:
        return None
    place = (across - low) / (2 * radius) * config.num_bins
    fronts, places = [], []
    for n in range(config.num_bins):
        mine = ahead[(place >= n) & (place < n + 1)]
        if len(mine) >= 3:
            fronts.append(float(np.quantile(mine, 0.1)))
            places.append(low + (n + 0.5) / config.num_bins * 2 * radius - middle)
    if len(fronts) < 0.8 * config.num_bins:
        return None
    front, offset = np.array(fronts), np.array(places)
    arc = np.sqrt(np.maximum(np.square(1.02 * radius) - np.square(offset), 0.0))
    depth = float(np.median(front + arc))
    misfit = float(np.sqrt(np.mean(np.square(front + arc - depth))))
    flat_misfit = float(np.sqrt(np.mean(np.square(_off_the_line(offset, front)))))
    if misfit > config.max_misfit * radius or misfit > config.max_ratio * flat_misfit:
        return None
    return float(middle), depth


def _off_the_line(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the residuals (N,) of y from the least-squares line through (x, y)."""
    x, y = x - x.mean(), y - y.mean()
    return np.asarray(y - portable.dot(x, y) / max(portable.dot(x, x), 1e-300) * x)
