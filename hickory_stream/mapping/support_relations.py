"""Support relations that make two tracks one object: a leg under its table, a plant in its pot, a panel in its desk.

As long as their contact is occluded, the segmenter sees two masks, so that neither the overlap of their clouds nor the
votes of keyframes merge the two. How one supports the other does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np
from scipy.spatial import cKDTree

from hickory_stream.geometry.boxes import intersection_volume_m3
from hickory_stream.mapping.cloud import is_near

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from hickory_stream.mapping.cloud import Cloud
    from hickory_stream.mapping.track import Track

_SAME_FLOOR_M = 0.15
_BESIDE_M = 0.04
_LEG_BESIDE_M = 0.08
_THIN_LEG = 0.04
_MIN_POINTS = 10
_TOUCH_SHARE = 0.03
_SAMPLE = 600
_PANEL_M = (0.1, 0.2, 0.4)
_PANEL_GAP_M = 0.05
_FOOT_CELL_M = 0.02
_RING_M = 0.04
_RISE_M = 0.025
_CORNER_M = 0.06
_COVER_CELL_M = 0.04
_COVERED = 0.4
_OUTLIERS_PCT = (2, 98)


def is_leg(small: Track, large: Track, *, max_gap_m: float = 0.3, slender: float = 1.5) -> bool:
    """Return whether the smaller track is a leg of the larger one.

    Its box is mostly inside the larger one's, it is `slender` times as tall as wide, both stand at the same height, and
    the larger one has points within `max_gap_m` above its top: the table's edge occludes the upper end of its leg.
    """
    size = 2 * small.box.half_extents_m
    if size[2] < slender * max(size[0], size[1]) or abs(_bottom_m(small) - _bottom_m(large)) > _SAME_FLOOR_M:
        return False
    if intersection_volume_m3(small.box, large.box.grown(_CORNER_M)) < 0.5 * small.box.volume_m3:
        return False
    top = float(small.bounds[1, 2])
    # A thin leg may stand slightly outside of the visible part of the seat.
    is_thin = size[0] * size[1] < _THIN_LEG * 4 * float(np.prod(large.box.half_extents_m[:2]))
    beside_m = _LEG_BESIDE_M if is_thin else 0.0
    above = large.solid.points[small.box.is_over_or_under(large.solid.points, beside_m)]
    above = above[(above[:, 2] > top - 0.05) & (above[:, 2] < top + max_gap_m)]
    if len(above) < _MIN_POINTS:
        return False
    # A thick leg must be covered by a board: a speaker beside a shelf only has the side of the shelf above its edge.
    return is_thin or _covered_share(small, above) >= _COVERED


def _covered_share(track: Track, above: NDArray[np.float32]) -> float:
    """Return the share of a track's footprint that has points above it."""
    plan, cover = (
        {(i, j) for i, j in np.floor(points[:, :2] / _COVER_CELL_M).astype(np.int64).tolist()}
        for points in (track.solid.points, above)
    )
    return len(plan & cover) / len(plan)


def stands_in(large: Track, small: Track) -> bool:
    """Return whether the larger track is supported by the smaller one alone: a plant in its pot.

    The smaller box is mostly inside the larger one, and the lowest points of the larger track are over or under the
    smaller one. A bin under a desk is inside the desk's box, too, but the desk also has legs elsewhere.
    """
    if intersection_volume_m3(small.box, large.box) < 0.6 * small.box.volume_m3:
        return False
    points = large.solid.points
    low, high = float(large.bounds[0, 2]), float(large.bounds[1, 2])
    foot = points[points[:, 2] < low + 0.15 * (high - low)]
    return len(foot) >= _MIN_POINTS and float(small.box.is_over_or_under(foot, _BESIDE_M).mean()) > 0.7


def is_on_foot(upper: Track, lower: Track) -> bool:
    """Return whether the lower track is the only support of the upper one: a seat on its swivel foot.

    The upper one's lowest points lie over the lower one, closely above its top, and no support surface continues around
    them.
    """
    points = upper.solid.points
    (low, high), (base, top) = _ends_m(upper.solid), _ends_m(lower.solid)
    if not -0.2 < low - top < 0.2 or low - base < 0.1:
        return False
    foot = points[points[:, 2] < low + max(0.03, 0.15 * (high - low))]
    if len(foot) < _MIN_POINTS or float(lower.box.is_over_or_under(foot, _BESIDE_M).mean()) < 0.7:
        return False
    # A pot rests on a counter, but does not cover it as a seat covers its foot.
    if float(upper.box.is_over_or_under(lower.solid.points, _CORNER_M).mean()) < 0.8:
        return False
    return not _stands_on(upper, lower)


def is_inner_part(
    small: Track,
    large: Track,
    others: Iterable[Track] = (),
    *,
    inside: float = 0.8,
    max_volume: float = 0.3,
    was_one: bool = False,
) -> bool:
    """Return whether the smaller track is part of the larger one: inside its box, touching it, and resting on nothing.

    The panel of a desk, the board of a shelf, the foot of a chair. An object in a shelf rests on a board, and one under
    a desk does not touch it. A mug rests on the table, one of the `others`, although it is inside the box of a chair
    that is pushed under the table. `was_one`: their points were of one track, so that they touch. A panel may touch
    across a wider gap, since depth at its edges is less complete than on its face.
    """
    box = large.box.grown(0.02)
    if small.box.volume_m3 > max_volume * large.box.volume_m3:
        return False
    if intersection_volume_m3(small.box, box) < inside * small.box.volume_m3:
        return False
    if not was_one:
        touching = _touches_across(small, large, _PANEL_GAP_M) if is_panel(small) else _touches(small, large)
        if not touching:
            return False
    return not any(_stands_on(small, support) for support in (large, *others))


def is_panel(track: Track) -> bool:
    """Return whether a track is a thin board of the size of furniture panels, larger than a book."""
    thin, width, length = sorted(2 * track.box.half_extents_m)
    return bool(thin < _PANEL_M[0] and width > _PANEL_M[1] and length > _PANEL_M[2])


def _touches(small: Track, large: Track) -> bool:
    keys = small.solid.keys[:: max(1, len(small.solid.keys) // _SAMPLE)]
    return float(is_near(keys, large.solid).mean()) >= _TOUCH_SHARE


def _touches_across(small: Track, large: Track, gap_m: float) -> bool:
    points = small.solid.points[:: max(1, len(small.solid.points) // _SAMPLE)]
    around = large.solid.points[small.box.grown(gap_m).contains(large.solid.points)]
    if len(around) == 0:
        return False
    distances_m, _ = cKDTree(around).query(points, distance_upper_bound=gap_m)
    return float(np.isfinite(distances_m).mean()) >= _TOUCH_SHARE


def _stands_on(small: Track, large: Track) -> bool:
    """Return whether the larger track has a horizontal surface around the foot of the smaller one, which rests on it.

    The smaller one occludes the surface right below it. What does not rise above that surface does not rest on it.
    """
    low, high = _ends_m(small.solid)
    around = large.solid.points[small.box.is_over_or_under(large.solid.points, _RING_M)]
    around = around[(around[:, 2] > low - 0.04) & (around[:, 2] < low + 0.02)]
    if len(around) < _MIN_POINTS or high - float(np.median(around[:, 2])) < _RISE_M:
        return False
    cells = np.unique(np.floor(around[:, :2] / _FOOT_CELL_M), axis=0)
    x, y = 2 * small.box.half_extents_m[:2]
    ring = 2 * _RING_M * float(x + y + 2 * _RING_M)
    return len(cells) * _FOOT_CELL_M * _FOOT_CELL_M > 0.2 * ring


_ENDS_M: WeakKeyDictionary[Cloud, tuple[float, float]] = WeakKeyDictionary()


def _ends_m(cloud: Cloud) -> tuple[float, float]:
    """Return the lowest and the highest z of a cloud without outliers; cached, since clouds are in many pairs."""
    ends = _ENDS_M.get(cloud)
    if ends is None:
        low, high = np.percentile(cloud.points[:, 2], _OUTLIERS_PCT)
        ends = _ENDS_M[cloud] = (float(low), float(high))
    return ends


def _bottom_m(track: Track) -> float:
    return float(track.bounds[0, 2])
