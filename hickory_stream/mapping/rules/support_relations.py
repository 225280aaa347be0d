"""Pairwise relations of support: a leg under its table, a plant in its pot, a panel in its desk, a cup on a tray.

Occluded contact gives two masks on one object, which neither overlap nor votes merge. Support relations do.
"""

from collections.abc import Iterable
from typing import Protocol
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry import portable
from hickory_stream.geometry.boxes import OrientedBox, intersection_volume_m3
from hickory_stream.mapping.entities.cloud import Cloud, is_near, share_near

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
# Tolerance of heights, and of places beside a box: what voxels and a few views leave of the noise of depth.
SLACK_M = 0.04
# This share of a body is most of it.
_MOST = 0.8
# Maximum height of a body's lower end above the top of its leg, foot or pot: the column between them may be too thin
# for the sensor, or hidden.
COLUMN_M = 0.2
# Bodies with a smaller gap may touch: a segmenter can take them for one.
MEET_M = 0.15
# A leg has at least this ratio of height to width, and at least this share of its box inside the table's box.
_LEG_SLENDER = 1.5
_LEG_INSIDE = 0.5
# A leg with less than this share of the table's area may stand beside the visible part of the table; a thicker one
# must have as large a share of its own area covered by the table as of its box inside.
_THIN_LEG = 0.04
# The lowest part of a plant or a seat, by this share of its height, stands on its pot or foot.
_FOOT_SLICE = 0.15
# At least this share of a part's points touches the other body.
_TOUCH_SHARE = 0.03
# At least this share of a patch lies on its thing to within two voxels, and the thing has at least this share of points
# beside it, for the height, of those at its foot.
_PATCH_SHARE = 0.5
# A body rests on a surface that is visible around its foot, over this share of a ring of the tolerance's width, if the
# body rises this far above the surface.
_RING_SHARE = 0.2
_RISE_M = 0.025
# Points of another body are under a body from this far below its box on.
_UNDER_BELOW_M = 0.1
# They are its support surface if they are in this many of eight sectors, at the height of this quantile.
_UNDER_SECTORS = 4
_UNDER_QUANTILE = 0.8
# A supporting body begins at least this much lower than the body on it.
_LOWER_M = 0.01


def _points_over(small: Body, large: Body) -> NDArray[np.float32]:
    top = float(small.bounds[1, 2])
    # A thin leg may stand slightly outside of the visible part of the seat.
    beside_m = SLACK_M if _is_thin(small, large) else 0.0
    above = large.solid.points[small.box.is_over_or_under(large.solid.points, beside_m)]
    return above[(above[:, 2] > top - SLACK_M) & (above[:, 2] < top + COLUMN_M)]


def is_hidden_by(small: Body, large: Body) -> bool:
    """Return whether the upper end of the smaller body is occluded by the larger one."""
    return len(_points_over(small, large)) >= _MIN_POINTS


def is_leg(small: Body, large: Body) -> bool:
    """Return whether the smaller body is a leg of the larger one."""
    # Mostly inside the larger one's box, taller than wide, with points of the larger one above its top.
    size = 2 * small.box.half_extents_m
    if size[2] < _LEG_SLENDER * max(size[0], size[1]):
        return False
    if intersection_volume_m3(small.box, large.box.grown(SLACK_M)) < _LEG_INSIDE * small.box.volume_m3:
        return False
    above = _points_over(small, large)
    if len(above) < _MIN_POINTS:
        return False
    # A thick leg must be covered by a board: above a speaker beside a shelf there is only the side of the shelf.
    return _is_thin(small, large) or _covered_share(small, above) >= _LEG_INSIDE


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
    is_inside = intersection_volume_m3(small.box, large.box) >= _MOST * small.box.volume_m3
    return is_inside and _stands_over(large, small, _FOOT_SLICE * (large.bounds[1, 2] - large.bounds[0, 2]))


def is_on_foot(upper: Body, lower: Body) -> bool:
    """Return whether the lower body is the only support of the upper one: a seat on its swivel foot."""
    # The upper one's lowest points lie over the lower one, closely above its top; no support surface goes on around
    # them.
    (low, high), (base, top) = _ends_m(upper.solid), _ends_m(lower.solid)
    is_above = base < low and abs(low - top) < COLUMN_M
    if not is_above or not _stands_over(upper, lower, max(SLACK_M, _FOOT_SLICE * (high - low))):
        return False
    # A pot rests on a counter, but does not cover it as a seat covers its foot.
    is_cover = float(upper.box.is_over_or_under(lower.solid.points, SLACK_M).mean()) >= _MOST
    return is_cover and not _stands_on(upper, lower)


def _stands_over(upper: Body, lower: Body, slice_m: float) -> bool:
    # Most of the points in the lowest slice of the upper one lie over or under the lower one.
    points = upper.solid.points
    foot = points[points[:, 2] < float(upper.bounds[0, 2]) + slice_m]
    return len(foot) >= _MIN_POINTS and float(lower.box.is_over_or_under(foot, SLACK_M).mean()) >= _MOST


def is_inner_part(
    small: Body, large: Body, others: Iterable[Body], *, was_one: bool = False, may_be_patch: bool = True
) -> bool:
    """Return whether the smaller body is part of the larger one: inside its box, touching it, and resting on nothing.

    E.g. the panel of a desk or the board of a shelf. A mug inside the box of a chair rests on the table, one of the
    `others`. `was_one`: their points were of one track, so they touch. A patch of a surface, as a car's lamp, rests on
    nothing.
    """
    inside_m3 = intersection_volume_m3(small.box, large.box.grown(SLACK_M))
    if inside_m3 < _MOST * small.box.volume_m3 or not (was_one or _touches(small, large)):
        return False
    supports = [body for body in (large, *others) if _stands_on(small, body)]
    return not supports or (may_be_patch and all(_is_patch(small, body) for body in supports))


def _is_patch(small: Body, large: Body) -> bool:
    # Above a support there is room. Beside a patch, which lies on the thing, the thing goes on upwards as densely.
    low, high = _ends_m(small.solid)
    beside_m = large.solid.points[small.box.is_over_or_under(large.solid.points, SLACK_M), 2] - low
    at, above = np.abs(beside_m) < SLACK_M, (beside_m >= SLACK_M) & (beside_m < high - low)
    goes_on = above.sum() * 2 * SLACK_M > _PATCH_SHARE * at.sum() * (high - low - SLACK_M) > 0
    return bool(goes_on) and share_near(small.solid.keys, large.solid, halvings=1) >= _PATCH_SHARE


def _touches(small: Body, large: Body) -> bool:
    keys = small.solid.keys[:: max(1, len(small.solid.keys) // _SAMPLE)]
    return float(is_near(keys, large.solid).mean()) >= _TOUCH_SHARE


def _stands_on(small: Body, large: Body) -> bool:
    # The smaller one occludes the surface right below it, so the surface is searched in a ring around its foot.
    low, high = _ends_m(small.solid)
    around = large.solid.points[small.box.is_over_or_under(large.solid.points, SLACK_M)]
    around = around[(around[:, 2] > low - SLACK_M) & (around[:, 2] < low + SLACK_M)]
    if len(around) < _MIN_POINTS or high - float(np.median(around[:, 2])) < _RISE_M:
        return False
    cells = np.unique(np.floor(around[:, :2] / _RING_CELL_M), axis=0)
    x, y = 2 * small.box.half_extents_m[:2]
    ring = 2 * SLACK_M * float(x + y + 2 * SLACK_M)
    return len(cells) * _RING_CELL_M * _RING_CELL_M > _RING_SHARE * ring


def height_under(body: Body, other: Body) -> float | None:
    """Return the height of another body's surface under a body on most sides of its centre; None if there is none."""
    bottom = bottom_of_box_m(body)
    if bottom_of_box_m(other) > bottom - _LOWER_M:
        return None
    points = other.cloud.points
    near = points[(points[:, 2] > bottom - _UNDER_BELOW_M) & (points[:, 2] < bottom + SLACK_M)]
    under = near[body.box.is_over_or_under(near, SLACK_M)]
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
