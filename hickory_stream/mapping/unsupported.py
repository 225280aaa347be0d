"""Unsupported tracks: a track that floats in the air, away from every wall, belongs to the nearest other track.

Examples are the branches of a plant and the shade of a lamp: the sensor does not see the thin stem that supports them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from hickory_stream.geometry.voxels import contains, keys_of_points, sorted_unique
from hickory_stream.mapping.observed_space import sees_structure
from hickory_stream.ranges import Ranged, number

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from hickory_stream.mapping.observed_space import SpaceState
    from hickory_stream.mapping.support_relations import Body

# The lowest points of a track: those up to this height above this percentile of z.
_LOWEST_PCT = 2
_FOOT_M = 0.05
# The depths below the lowest points at which free space is checked: beyond the noise of the foot, a few voxels deep.
_BELOW_M = (0.08, 0.13, 0.18)


@dataclass(frozen=True, kw_only=True, slots=True)
class UnsupportedConfig(Ranged):
    """When a track is unsupported, and to which track it is then attached.

    Attributes:
        min_height_m: minimum height of its lowest points above the floor; lower tracks may have thin feet.
        free_share: minimum share of the space below its lowest points that was observed free.
        support_m, support_share: it is supported if more than this share of its lowest points is within this distance
            of another track.
        wall_m: it is supported if structure is within this distance.
        attach_m: maximum distance to the track that it is attached to.
    """

    min_height_m: float = number(0.25, 0, 100, "m")
    free_share: float = number(0.9, 0, 1, "share")
    support_m: float = number(0.06, 0, 10, "m")
    support_share: float = number(0.1, 0, 1, "share")
    wall_m: float = number(0.1, 0, 10, "m")
    attach_m: float = number(0.15, 0, 10, "m")


def attachment_of(body: Body, others: Iterable[Body], space: SpaceState, config: UnsupportedConfig) -> Body | None:
    """Return the body to which an unsupported body is attached; None if it is supported, or no other body is near."""
    points = body.solid.points
    if space.floor_z_m is None or len(points) == 0:
        return None
    low = float(np.percentile(points[:, 2], _LOWEST_PCT))
    if low < space.floor_z_m + config.min_height_m:
        return None
    foot = points[points[:, 2] < low + _FOOT_M]
    if not _is_free_below(foot, points, space, config) or sees_structure(space, body.box, points, config.wall_m):
        return None
    near = [other for other in others if other.id != body.id and _meet(body, other, config.attach_m)]
    clouds = [cKDTree(other.solid.points) for other in near]
    for cloud in clouds:
        distances_m, _ = cloud.query(foot, distance_upper_bound=config.support_m)
        if float(np.isfinite(distances_m).mean()) >= config.support_share:
            return None
    gaps_m = [float(cloud.query(points, distance_upper_bound=config.attach_m)[0].min()) for cloud in clouds]
    closest = min(range(len(near)), key=lambda i: (gaps_m[i], near[i].id), default=None)
    return None if closest is None or not np.isfinite(gaps_m[closest]) else near[closest]


def _is_free_below(
    foot: NDArray[np.float32], points: NDArray[np.float32], space: SpaceState, config: UnsupportedConfig
) -> bool:
    own = sorted_unique(keys_of_points(points, space.voxel_m))
    below = np.concatenate([foot - np.array([0.0, 0.0, depth_m], np.float32) for depth_m in _BELOW_M])
    keys = keys_of_points(below, space.voxel_m)
    keys = keys[~contains(own, keys)]
    return len(keys) > 0 and float(contains(space.free, keys).mean()) >= config.free_share


def _meet(a: Body, b: Body, slack_m: float) -> bool:
    (a_low, a_high), (b_low, b_high) = a.bounds, b.bounds
    return bool((a_low <= b_high + slack_m).all() and (b_low <= a_high + slack_m).all())
