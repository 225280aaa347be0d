"""Pairwise relations of support: a leg under its table, a plant in its pot, a panel in its desk, a cup on a tray.

Occluded contact gives two masks on one object, which neither overlap nor votes merge. Support relations do.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hickory_stream.geometry import portable
from hickory_stream.geometry.boxes import OrientedBox, intersection_volume_m3
from hickory_stream.mapping.entities.cloud import Cloud, is_near

# The number of a body's points that are tested for lying on another one: gives the share to a few per cent.
_SAMPLE = 600
# The percentile of z that stands for the lowest points of a body, and from 100 for the highest.
LOWEST_PCT = 2
# Horizontal areas are counted in cells: of two voxels for a ring around a foot, of four for a board over a leg.
_RING_CELL_M = 0.02
_COVER_CELL_M = 2 * _RING_CELL_M
# The number of sectors around a body's centre in which points under it are counted.
_SECTORS = 8


class Body(Protocol):
    """A node of the support graph: a track, or an object of a map."""

    @property
    def id(self) -> int:
        """Its number."""

    @property
    def cloud(self) -> Cloud:
        """The whole cloud."""

    @property
    def solid(self) -> Cloud:
        """The part of the cloud without voxels that are likely to be noise."""

    @property
    def box(self) -> OrientedBox:
        """The box of the solid part."""

    @property
    def bounds(self) -> NDArray[np.float32]:
        """The least and greatest coordinates of the solid part, (2, 3)."""


# Fewer points are no surface, and no foot.
_MIN_POINTS = 10
# Horizontal tolerance within which points beside a box count as over or under it: in general, for a thin leg, and for
# boxes whose corners are uncertain.
_BESIDE_M = 0.04
_LEG_BESIDE_M = 2 * _BESIDE_M
_CORNER_M = 0.06
# A leg and its table begin at heights that differ by at most this.
_LEVEL_M = 0.15
# A leg has at least this ratio of height to width, and at least this share of its box inside the table's box.
_LEG_SLENDER = 1.5
_LEG_INSIDE = 0.5
# Points of the table are over a leg from this far below its top to this far above.
_LEG_OVERLAP_M = 0.05
_LEG_GAP_M = 0.3
# A leg with less than this share of the table's area may stand beside the visible part of the table; a thicker one
# must have at least this share of its own area covered by the table.
_THIN_LEG = 0.04
_LEG_COVERED = 0.4
# A pot has this share of its box inside the box of the plant that stands in it.
_POT_INSIDE = 0.6
# Maximum vertical distance between the lower end of a seat and the top of its foot, and minimum height of the seat
# above the base of the foot.
_FOOT_STEP_M = 0.2
_FOOT_HEIGHT_M = 0.1
# The lowest part of a plant or a seat, by this share of its height, of a seat at least this high, has this share of its
# points over the pot or foot; a seat covers this share of the foot's area.
_FOOT_SLICE_M = 0.03
_FOOT_SLICE = 0.15
_FOOT_UNDER = 0.7
_FOOT_COVERED = 0.8
# A part has this share of its box inside the other box, enlarged by the slack, and at most this share of its volume.
_PART_INSIDE = 0.8
_PART_SLACK_M = 0.02
_PART_VOLUME = 0.3
# At least this share of a part's points touches the other body.
_TOUCH_SHARE = 0.03
# A part that is thinner, wider and longer than these is a panel, which counts as touching across this gap: depth is
# less complete at its edges than on its face.
_PANEL_M = 0.1
_PANEL_WIDTH_M = 0.2
_PANEL_LENGTH_M = 0.4
_PANEL_GAP_M = 0.05
# A body rests on a surface that is visible in a ring of this width around its foot, over this share of the ring, from
# this far below the body's lowest points to this far above them, if the body rises this far above the surface.
_RING_M = 0.04
_RING_SHARE = 0.2
_RING_BELOW_M = 0.04
_RING_ABOVE_M = 0.02
_RISE_M = 0.025
# Points of another body are under a body from this far below its box to this far above or beside it.
_UNDER_BELOW_M = 0.1
_UNDER_SLACK_M = 0.03
# They are its support surface if they are in this many of eight sectors, at the height of this quantile.
_UNDER_SECTORS = 4
_UNDER_QUANTILE = 0.8
# A supporting body begins at least this much lower than the body on it.
_LOWER_M = 0.01


def _points_over(small: Body, large: Body) -> NDArray[np.float32]:
    top = float(small.bounds[1, 2])
    # A thin leg may stand slightly outside of the visible part of the seat.
    beside_m = _LEG_BESIDE_M if _is_thin(small, large) else 0.0
    above = large.solid.points[small.box.is_over_or_under(large.solid.points, beside_m)]
    return above[(above[:, 2] > top - _LEG_OVERLAP_M) & (above[:, 2] < top + _LEG_GAP_M)]


def is_hidden_by(small: Body, large: Body) -> bool:
    """Return whether the upper end of the smaller body is occluded by the larger one."""
    return len(_points_over(small, large)) >= _MIN_POINTS


def is_leg(small: Body, large: Body) -> bool:
    """Return whether the smaller body is a leg of the larger one."""
    # Mostly inside the larger one's box, taller than wide, from one height, with points of the larger one above its
    # top.
    size = 2 * small.box.half_extents_m
    is_level = abs(float(small.bounds[0, 2]) - float(large.bounds[0, 2])) <= _LEVEL_M
    if size[2] < _LEG_SLENDER * max(size[0], size[1]) or not is_level:
        return False
    if intersection_volume_m3(small.box, large.box.grown(_CORNER_M)) < _LEG_INSIDE * small.box.volume_m3:
        return False
    above = _points_over(small, large)
    if len(above) < _MIN_POINTS:
        return False
    # A thick leg must be covered by a board: above a speaker beside a shelf there is only the side of the shelf.
    return _is_thin(small, large) or _covered_share(small, above) >= _LEG_COVERED


def _is_thin(small: Body, large: Body) -> bool:
    size = 2 * small.box.half_extents_m
    return bool(size[0] * size[1] < _THIN_LEG * 4 * float(np.prod(large.box.half_extents_m[:2])))


def _covered_share(body: Body, above: NDArray[np.float32]) -> float:
    plan = _cells(body.solid.points)
    low = plan.min(axis=0)
    in_plan = np.zeros(plan.max(axis=0) - low + 1, dtype=bool)
    in_plan[tuple((plan - low).T)] = True
    cover = _cells(above) - low
    covered = np.zeros_like(in_plan)
    covered[tuple(cover[((cover >= 0) & (cover < in_plan.shape)).all(axis=1)].T)] = True
    return int((in_plan & covered).sum()) / int(in_plan.sum())


def _cells(points: NDArray[np.float32]) -> NDArray[np.int64]:
    return np.floor(points[:, :2] / _COVER_CELL_M).astype(np.int64)


def stands_in(large: Body, small: Body) -> bool:
    """Return whether the smaller body alone supports the larger one: a plant in its pot."""
    # Mostly inside its box, with its lowest points over or under it. A desk around a bin has legs elsewhere.
    if intersection_volume_m3(small.box, large.box) < _POT_INSIDE * small.box.volume_m3:
        return False
    points = large.solid.points
    low, high = float(large.bounds[0, 2]), float(large.bounds[1, 2])
    foot = points[points[:, 2] < low + _FOOT_SLICE * (high - low)]
    if len(foot) < _MIN_POINTS:
        return False
    return float(small.box.is_over_or_under(foot, _BESIDE_M).mean()) > _FOOT_UNDER


def is_on_foot(upper: Body, lower: Body) -> bool:
    """Return whether the lower body is the only support of the upper one: a seat on its swivel foot."""
    # The upper one's lowest points lie over the lower one, closely above its top; no support surface goes on around
    # them.
    points = upper.solid.points
    (low, high), (base, top) = _ends_m(upper.solid), _ends_m(lower.solid)
    if not -_FOOT_STEP_M < low - top < _FOOT_STEP_M or low - base < _FOOT_HEIGHT_M:
        return False
    foot = points[points[:, 2] < low + max(_FOOT_SLICE_M, _FOOT_SLICE * (high - low))]
    if len(foot) < _MIN_POINTS:
        return False
    if float(lower.box.is_over_or_under(foot, _BESIDE_M).mean()) < _FOOT_UNDER:
        return False
    # A pot rests on a counter, but does not cover it as a seat covers its foot.
    if float(upper.box.is_over_or_under(lower.solid.points, _CORNER_M).mean()) < _FOOT_COVERED:
        return False
    return not _stands_on(upper, lower)


def is_inner_part(
    small: Body,
    large: Body,
    others: Iterable[Body],
    *,
    inside: float | None = None,
    max_volume: float | None = None,
    was_one: bool = False,
) -> bool:
    """Return whether the smaller body is part of the larger one: inside its box, touching it, and resting on nothing.

    E.g. the panel of a desk or the board of a shelf. A mug inside the box of a chair rests on the table, one of the
    `others`. `was_one`: their points were of one track, so they touch. `inside` and `max_volume` replace the shares.
    """
    box = large.box.grown(_PART_SLACK_M)
    if small.box.volume_m3 > (_PART_VOLUME if max_volume is None else max_volume) * large.box.volume_m3:
        return False
    least = _PART_INSIDE if inside is None else inside
    if intersection_volume_m3(small.box, box) < least * small.box.volume_m3:
        return False
    if not (was_one or (_touches_across if is_panel(small) else _touches)(small, large)):
        return False
    return not any(_stands_on(small, support) for support in (large, *others))


def is_panel(body: Body) -> bool:
    """Return whether a body is a thin board of the size of furniture panels, larger than a book."""
    thin, width, length = sorted(2 * body.box.half_extents_m)
    return bool(thin < _PANEL_M and width > _PANEL_WIDTH_M and length > _PANEL_LENGTH_M)


def _touches(small: Body, large: Body) -> bool:
    keys = small.solid.keys[:: max(1, len(small.solid.keys) // _SAMPLE)]
    return float(is_near(keys, large.solid).mean()) >= _TOUCH_SHARE


def _touches_across(small: Body, large: Body) -> bool:
    gap_m = _PANEL_GAP_M
    points = small.solid.points[:: max(1, len(small.solid.points) // _SAMPLE)]
    around = large.solid.points[small.box.grown(gap_m).contains(large.solid.points)]
    if len(around) == 0:
        return False
    distances_m, _ = cKDTree(around).query(points, distance_upper_bound=gap_m)
    return float(np.isfinite(distances_m).mean()) >= _TOUCH_SHARE


def _stands_on(small: Body, large: Body) -> bool:
    # The smaller one occludes the surface right below it, so the surface is searched in a ring around its foot.
    low, high = _ends_m(small.solid)
    around = large.solid.points[small.box.is_over_or_under(large.solid.points, _RING_M)]
    around = around[(around[:, 2] > low - _RING_BELOW_M) & (around[:, 2] < low + _RING_ABOVE_M)]
    if len(around) < _MIN_POINTS or high - float(np.median(around[:, 2])) < _RISE_M:
        return False
    cells = np.unique(np.floor(around[:, :2] / _RING_CELL_M), axis=0)
    x, y = 2 * small.box.half_extents_m[:2]
    ring = 2 * _RING_M * float(x + y + 2 * _RING_M)
    return len(cells) * _RING_CELL_M * _RING_CELL_M > _RING_SHARE * ring


def height_under(body: Body, other: Body) -> float | None:
    """Return the height of another body's surface under a body on most sides of its centre; None if there is none."""
    bottom = bottom_of_box_m(body)
    if bottom_of_box_m(other) > bottom - _LOWER_M:
        return None
    points = other.cloud.points
    near = points[(points[:, 2] > bottom - _UNDER_BELOW_M) & (points[:, 2] < bottom + _UNDER_SLACK_M)]
    under = near[body.box.is_over_or_under(near, _UNDER_SLACK_M)]
    if len(under) < _MIN_POINTS or not _surrounds(under, body.box):
        return None
    return float(np.quantile(under[:, 2], _UNDER_QUANTILE))


def bottom_of_box_m(body: Body) -> float:
    """Return the height at which the box of a body begins."""
    return float(body.box.center[2] - body.box.half_extents_m[2])


def _surrounds(points: NDArray[np.float32], box: OrientedBox) -> bool:
    x, y = (points[:, :2] - box.center[:2]).T
    sectors = np.floor((portable.arctan2(y, x) + np.pi) / (2 * np.pi) * _SECTORS).astype(np.int64) % _SECTORS
    return int((np.bincount(sectors, minlength=_SECTORS) > 0).sum()) >= _UNDER_SECTORS


_ENDS_M: WeakKeyDictionary[Cloud, tuple[float, float]] = WeakKeyDictionary()


def _ends_m(cloud: Cloud) -> tuple[float, float]:
    # The lowest and the highest z without outliers; cached, since clouds are in many pairs.
    ends = _ENDS_M.get(cloud)
    if ends is None:
        low, high = np.percentile(cloud.points[:, 2], (LOWEST_PCT, 100 - LOWEST_PCT))
        ends = _ENDS_M[cloud] = (float(low), float(high))
    return ends
