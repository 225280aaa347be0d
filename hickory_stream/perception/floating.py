"""What would fall is held by something: floating pieces join the nearest piece in 3D.

A leaf, the shade of a lamp, a screen before its stand: the thin part that carries them is often not seen at all.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numba
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.perception.pieces import Pieces
    from hickory_stream.perception.standing import Standing
    from hickory_stream.perception.surface import Surface


@dataclass(frozen=True, kw_only=True, slots=True)
class FloatConfig:
    """How far a floating piece looks for what holds it.

    Attributes:
        gap_m: it joins what is at most this far away.
        color_m: a difference of one in Lab counts as this much distance.
        plane_area_m2: a larger plane is carried by legs and does not take what merely is near.
        rounds: pieces join pieces, and the joined ones others, at most this often.
    """

    gap_m: float = 0.2
    color_m: float = 0.001
    like_color: float = 15.0
    leaf_m2: float = 0.05
    near_m: float = 0.1
    foot_gap_m: float = 0.07
    foot_color: float = 40.0
    back_low_m: float = 0.1
    back_high_m: float = 0.2
    plane_area_m2: float = 0.4
    rounds: int = 5


def holders(
    surface: Surface,
    groups: NDArray[np.int32],
    standing: Standing,
    pieces: Pieces,
    carries: NDArray[np.bool_],
    is_seat: NDArray[np.bool_],
    config: FloatConfig,
) -> list[tuple[int, int]]:
    """Return (floating, holder) pairs: for each floating piece the nearest that does not itself stand on it.

    `groups` (h, w) are the pieces as joined so far, and `pieces` their measures.
    """
    carries = carries | standing.carries()
    floats = (standing.floats() & ~carries) | is_seat
    if not floats.any():
        return []
    reach = config.gap_m * max(surface.camera.fx, surface.camera.fy)
    gaps = _gaps(groups, surface.depth_m, surface.points_world, floats, np.float32(reach), np.float32(config.gap_m))
    found = []
    for i in np.flatnonzero(floats):
        best, holder = config.gap_m, 0
        for j in np.flatnonzero(gaps[i] < config.gap_m):
            if (
                carries[j]
                or standing.stands_on(int(j), int(i))
                or not _may_hold(pieces, i, j, gaps[i, j], bool(is_seat[i]), config)
            ):
                continue
            cost = float(gaps[i, j]) + config.color_m * pieces.color_difference(int(i), int(j))
            if cost < best:
                best, holder = cost, int(j)
        if holder:
            found.append((int(i), holder))
    return found


def _may_hold(pieces: Pieces, i: int, j: int, gap_m: float, is_seat: bool, config: FloatConfig) -> bool:
    """Return whether piece j may hold i: like colours, near unless one is small, or a foot of any colour right below."""
    if pieces.support[i] > 0 and pieces.support[j] > 0:
        return False
    if is_seat:
        seat = float(pieces.z_high_m[i])
        rises = pieces.z_low_m[j] < seat + config.back_low_m and pieces.z_high_m[j] > seat + config.back_high_m
        if rises and gap_m < config.foot_gap_m:
            return True
    color = pieces.color_difference(i, j)
    if gap_m < config.foot_gap_m and pieces.z_high_m[j] < pieces.z_low_m[i] + config.foot_gap_m:
        return color < config.foot_color
    is_near = gap_m < config.near_m or min(pieces.area_m2[i], pieces.area_m2[j]) < config.leaf_m2
    return is_near and color < config.like_color


@numba.njit(cache=True)
def _gaps(groups, depth, points, floats, reach, limit):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return (count, count) the least distance of each floating group to each other group, every other pixel."""
    height, width = groups.shape
    out = np.full((len(floats), len(floats)), np.inf, dtype=np.float32)
    for y in range(0, height, 2):
        for x in range(0, width, 2):
            i = groups[y, x]
            if i == 0 or not floats[i]:
                continue
            radius = int(reach / depth[y, x]) + 1
            for yy in range(max(y % 2, y - radius // 2 * 2), min(height, y + radius + 1), 2):
                for xx in range(max(x % 2, x - radius // 2 * 2), min(width, x + radius + 1), 2):
                    j = groups[yy, xx]
                    if j == 0 or j == i or abs(depth[yy, xx] - depth[y, x]) > limit:
                        continue
                    d0 = points[yy, xx, 0] - points[y, x, 0]
                    d1 = points[yy, xx, 1] - points[y, x, 1]
                    d2 = points[yy, xx, 2] - points[y, x, 2]
                    distance = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
                    if distance < out[i, j]:
                        out[i, j] = distance
    return out
