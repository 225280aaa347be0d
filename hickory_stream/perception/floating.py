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
    """How a floating piece finds what holds it.

    Attributes:
        gap_m: it joins what is at most this far away.
        near_m: two pieces of which neither is small are at most this far apart.
        leaf_m2: a piece with less surface in view is small.
        like_color: difference in Lab (lightness at half weight) above which pieces that do not meet are not one thing.
        color_m: a difference of one in Lab counts as this much distance.
        foot_gap_m: a foot is at most this far below what it carries, and a back this far from its seat.
        foot_aside_m: a foot that is farther from what is seen of its load has its centre at most this far aside.
        foot_color: difference in Lab above which a foot is another thing.
        back_low_m, back_high_m: a back begins below the first and ends above the second, from its seat upwards.
        rounds: pieces join pieces, and the joined ones others, at most this often.
    """

    gap_m: float = 0.2
    near_m: float = 0.1
    leaf_m2: float = 0.05
    like_color: float = 15.0
    color_m: float = 0.001
    foot_gap_m: float = 0.07
    foot_aside_m: float = 0.15
    foot_color: float = 40.0
    back_low_m: float = 0.1
    back_high_m: float = 0.2
    rounds: int = 5


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Loose:
    """The pieces so far: `groups` (h, w) their labels, their measures and standing, and which carry or are bare seats.

    `carries` (count,): large planes, which are carried by legs and do not take what merely is near. `is_seat` (count,):
    seats without anything joined to them yet.
    """

    groups: NDArray[np.int32]
    pieces: Pieces
    standing: Standing
    carries: NDArray[np.bool_]
    is_seat: NDArray[np.bool_]


def holders(surface: Surface, loose: Loose, config: FloatConfig) -> list[tuple[int, int]]:
    """Return (floating, holder) pairs: for each floating piece the nearest that may hold it and is not on it."""
    standing, pieces = loose.standing, loose.pieces
    carries = loose.carries | standing.carries()
    floats = (standing.floats() & ~carries) | loose.is_seat
    if not floats.any():
        return []
    reach_px = np.float32(config.gap_m * max(surface.camera.fx, surface.camera.fy))
    gaps = _gaps(loose.groups, surface.depth_m, surface.points_world, floats, reach_px, np.float32(config.gap_m))
    found = []
    for i in map(int, np.flatnonzero(floats)):
        best, holder = config.gap_m, 0
        for j in map(int, np.flatnonzero(gaps[i] < config.gap_m)):
            if carries[j] or standing.stands_on(j, i) or not _may_hold(loose, i, j, float(gaps[i, j]), config):
                continue
            cost = float(gaps[i, j]) + config.color_m * pieces.color_difference(i, j)
            if cost < best:
                best, holder = cost, j
        if holder:
            found.append((i, holder))
    return found


def _may_hold(loose: Loose, i: int, j: int, gap_m: float, config: FloatConfig) -> bool:
    """Return whether piece j may hold i: a seat's back, a foot right below, or what is near and of one colour."""
    pieces = loose.pieces
    if pieces.support[i] > 0 and pieces.support[j] > 0:
        return False  # two levels: chairs side by side
    if loose.is_seat[i] and gap_m < config.foot_gap_m and _rises_from(pieces, j, float(pieces.z_high_m[i]), config):
        return True
    color = pieces.color_difference(i, j)
    if _is_foot(pieces, i, j, gap_m, config):
        return color < config.foot_color
    is_near = gap_m < config.near_m or min(pieces.area_m2[i], pieces.area_m2[j]) < config.leaf_m2
    return bool(is_near and color < config.like_color)


def _is_foot(pieces: Pieces, i: int, j: int, gap_m: float, config: FloatConfig) -> bool:
    """Return whether piece j ends below i: right there, or somewhat deeper inside but in its middle (a lamp's pole)."""
    above = float(pieces.z_low_m[i] - pieces.z_high_m[j])
    if above < -config.foot_gap_m:
        return False
    aside = float(np.linalg.norm(pieces.center_m[i] - pieces.center_m[j]))
    return gap_m < config.foot_gap_m or (above < config.foot_gap_m and aside < config.foot_aside_m)


def _rises_from(pieces: Pieces, back: int, seat_z_m: float, config: FloatConfig) -> bool:
    """Return whether a piece reaches from about the height of a seat to well above it."""
    low, high = pieces.z_low_m[back] - seat_z_m, pieces.z_high_m[back] - seat_z_m
    return bool(low < config.back_low_m and high > config.back_high_m)


@numba.njit(cache=True, nogil=True)
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
