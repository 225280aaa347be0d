"""Pieces by what carries what: a leg under its table, a plant in its pot.

A segmenter sees them as two for as long as something hides where they meet, so that neither their clouds nor the votes
of frames say that they are one. How they stand does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.geometry.boxes import intersection_volume_m3

if TYPE_CHECKING:
    from hickory_stream.mapping.track import Track

_SAME_FLOOR_M = 0.15
_BESIDE_M = 0.04
_MIN_POINTS = 10


def is_leg(small: Track, large: Track, *, max_gap_m: float = 0.2, slender: float = 1.5) -> bool:
    """Return whether a slender thing stands where the larger one stands, with the larger one closely above it.

    Its box is mostly inside the larger one's, it is `slender` times as tall as wide, their bottoms are level, and
    within `max_gap_m` above its top the larger one goes on. A leg is seen up to where the table's edge hides it.
    """
    size = 2 * small.box.half_extents_m
    if size[2] < slender * max(size[0], size[1]) or abs(_bottom_m(small) - _bottom_m(large)) > _SAME_FLOOR_M:
        return False
    if intersection_volume_m3(small.box, large.box) < 0.5 * small.box.volume_m3:
        return False
    top = float(small.bounds[1, 2])
    above = large.solid.points[small.box.is_over_or_under(large.solid.points, _BESIDE_M)][:, 2]
    near = above[(above > top - 0.05) & (above < top + max_gap_m)]
    return len(near) >= _MIN_POINTS


def stands_in(large: Track, small: Track) -> bool:
    """Return whether a thing stands in the smaller one and nowhere else: a plant in its pot.

    The smaller box is mostly inside the larger one, and what is lowest of the larger thing lies over the smaller one. A
    bin under a desk is inside the desk's box, too, but the desk has legs of its own.
    """
    if intersection_volume_m3(small.box, large.box) < 0.6 * small.box.volume_m3:
        return False
    points = large.solid.points
    low, high = float(large.bounds[0, 2]), float(large.bounds[1, 2])
    foot = points[points[:, 2] < low + 0.15 * (high - low)]
    return len(foot) >= _MIN_POINTS and float(small.box.is_over_or_under(foot, _BESIDE_M).mean()) > 0.7


def _bottom_m(track: Track) -> float:
    return float(track.bounds[0, 2])
