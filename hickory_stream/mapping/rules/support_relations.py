"""Pairwise relations of support: a leg under its table, a plant in its pot, a panel in its desk, a cup on a tray.

While their contact is occluded, the segmenter finds two masks on one object, and neither the overlap of the clouds nor
the votes of keyframes merge the two. The way in which one supports the other does. `SupportGraph` uses these relations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol
from weakref import WeakKeyDictionary

import numpy as np
from scipy.spatial import cKDTree

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.geometry import portable
from hickory_stream.geometry.boxes import intersection_volume_m3
from hickory_stream.mapping.entities.cloud import is_near

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from hickory_stream.geometry.boxes import OrientedBox
    from hickory_stream.mapping.entities.cloud import Cloud

# The number of a body's points that are tested for lying on another one: gives the share to a few per cent.
_SAMPLE = 600
# The percentiles of z that stand for the lowest and the highest points of a body.
_OUTLIERS_PCT = (2, 98)
# Horizontal areas are counted in cells: of two voxels for a ring around a foot, of four for a board over a leg.
_RING_CELL_M = 0.02
_COVER_CELL_M = 0.04
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


@dataclass(frozen=True, kw_only=True, slots=True)
class SupportConfig(Ranged):
    """When one body supports another.

    Attributes:
        min_points: fewer points are no surface, and no foot.
        beside_m, leg_beside_m, corner_m: horizontal tolerance within which points beside a box still count as over or
            under it: in general, for a thin leg, and for boxes whose corners are uncertain.
        level_m: maximum difference between the heights at which a leg and its table begin.
        leg_slender: a leg has at least this ratio of height to width ...
        leg_inside: ... at least this share of its box inside the table's box ...
        leg_gap_m, leg_overlap_m: ... and points of the table over it, from `leg_overlap_m` below its top to `leg_gap_m`
            above.
        thin_leg: a leg with less than this share of the table's area may stand beside the visible part of the table.
        leg_covered: a thicker leg must have at least this share of its own area covered by the table.
        pot_inside: a pot has at least this share of its box inside the box of the plant that stands in it ...
        pot_slice: ... and the lowest part of the plant, by this share of its height, ...
        pot_under: ... has at least this share of its points over the pot.
        foot_step_m: maximum vertical distance between the lower end of a seat and the top of its foot ...
        foot_height_m: ... minimum height of the seat above the base of the foot ...
        foot_slice_m, foot_slice: ... the lowest part of the seat, by this height or this share of its height, ...
        foot_under, foot_covered: ... has at least `foot_under` of its points over the foot, and covers at least
            `foot_covered` of the foot's area.
        part_inside, part_volume, part_slack_m: a part has at least this share of its box inside the other box (enlarged
            by the slack), and at most this share of its volume ...
        touch_share: ... and at least this share of its points touches it.
        panel_m, panel_width_m, panel_length_m, panel_gap_m: a part that is thinner, wider and longer than these is a
            panel, which counts as touching across this gap: depth is less complete at its edges than on its face.
        ring_m, ring_share: a body rests on a surface that is visible in a ring of this width around its foot, over at
            least this share of the ring ...
        ring_below_m, ring_above_m: ... from this far below the body's lowest points to this far above them ...
        rise_m: ... if the body rises at least this far above the surface.
        under_below_m, under_above_m, under_beside_m: points of another body are under a body if their height is from
            this far below its box to this far above, and they are at most this far beside it ...
        under_sectors: ... they are its support surface if they are in at least this many of eight sectors ...
        under_quantile: ... and the height of the surface is this quantile of their heights.
        lower_m: a supporting body begins at least this much lower than the body on it.
        floor_m: a body that begins this near to the floor rests on it.
    """

    min_points: int = number(10, 1, 1_000_000, "points")
    beside_m: float = number(0.04, 0, 10, "m")
    leg_beside_m: float = number(0.08, 0, 10, "m")
    corner_m: float = number(0.06, 0, 10, "m")
    level_m: float = number(0.15, 0, 10, "m")
    leg_slender: float = number(1.5, 0, 1000, "ratio")
    leg_inside: float = number(0.5, 0, 1, "share")
    leg_gap_m: float = number(0.3, 0, 10, "m")
    leg_overlap_m: float = number(0.05, 0, 10, "m")
    thin_leg: float = number(0.04, 0, 1, "share")
    leg_covered: float = number(0.4, 0, 1, "share")
    pot_inside: float = number(0.6, 0, 1, "share")
    pot_slice: float = number(0.15, 0, 1, "share")
    pot_under: float = number(0.7, 0, 1, "share")
    foot_step_m: float = number(0.2, 0, 10, "m")
    foot_height_m: float = number(0.1, 0, 10, "m")
    foot_slice_m: float = number(0.03, 0, 10, "m")
    foot_slice: float = number(0.15, 0, 1, "share")
    foot_under: float = number(0.7, 0, 1, "share")
    foot_covered: float = number(0.8, 0, 1, "share")
    part_inside: float = number(0.8, 0, 1, "share")
    part_volume: float = number(0.3, 0, 1000, "ratio")
    part_slack_m: float = number(0.02, 0, 10, "m")
    touch_share: float = number(0.03, 0, 1, "share")
    panel_m: float = number(0.1, 0, 10, "m")
    panel_width_m: float = number(0.2, 0, 10, "m")
    panel_length_m: float = number(0.4, 0, 10, "m")
    panel_gap_m: float = number(0.05, 0, 10, "m")
    ring_m: float = number(0.04, 0, 10, "m")
    ring_share: float = number(0.2, 0, 1, "share")
    ring_below_m: float = number(0.04, 0, 10, "m")
    ring_above_m: float = number(0.02, 0, 10, "m")
    rise_m: float = number(0.025, 0, 10, "m")
    under_below_m: float = number(0.1, 0, 10, "m")
    under_above_m: float = number(0.03, 0, 10, "m")
    under_beside_m: float = number(0.03, 0, 10, "m")
    under_sectors: int = number(4, 1, 8, "sectors")
    under_quantile: float = number(0.8, 0, 1, "quantile")
    lower_m: float = number(0.01, 0, 10, "m")
    floor_m: float = number(0.35, 0, 10, "m")


# ---- hidden by: the contact is occluded by what is above ------------------------------------------------------------


def points_over(small: Body, large: Body, config: SupportConfig) -> NDArray[np.float32]:
    """Return the points (N, 3) of a larger body that are just above a smaller one, whose upper end they occlude."""
    top = float(small.bounds[1, 2])
    # A thin leg may stand slightly outside of the visible part of the seat.
    beside_m = config.leg_beside_m if _is_thin(small, large, config) else 0.0
    above = large.solid.points[small.box.is_over_or_under(large.solid.points, beside_m)]
    return above[(above[:, 2] > top - config.leg_overlap_m) & (above[:, 2] < top + config.leg_gap_m)]


def is_hidden_by(small: Body, large: Body, config: SupportConfig) -> bool:
    """Return whether the upper end of the smaller body is occluded by the larger one."""
    return len(points_over(small, large, config)) >= config.min_points


# ---- is part of -----------------------------------------------------------------------------------------------------


def is_leg(small: Body, large: Body, config: SupportConfig) -> bool:
    """Return whether the smaller body is a leg of the larger one.

    Its box is mostly inside the larger one's, it is taller than wide, both stand at the same height, and the larger one
    has points closely above its top: the table's edge occludes the upper end of its leg.
    """
    size = 2 * small.box.half_extents_m
    if (
        size[2] < config.leg_slender * max(size[0], size[1])
        or abs(_bottom_m(small) - _bottom_m(large)) > config.level_m
    ):
        return False
    overlap_m3 = intersection_volume_m3(small.box, large.box.grown(config.corner_m))
    if overlap_m3 < config.leg_inside * small.box.volume_m3:
        return False
    above = points_over(small, large, config)
    if len(above) < config.min_points:
        return False
    # A thick leg must be covered by a board: above a speaker beside a shelf there is only the side of the shelf.
    return _is_thin(small, large, config) or _covered_share(small, above) >= config.leg_covered


def _is_thin(small: Body, large: Body, config: SupportConfig) -> bool:
    """Return whether the smaller body's area, seen from above, is that of a thin leg of the larger one."""
    size = 2 * small.box.half_extents_m
    return bool(size[0] * size[1] < config.thin_leg * 4 * float(np.prod(large.box.half_extents_m[:2])))


def _covered_share(body: Body, above: NDArray[np.float32]) -> float:
    """Return the share of a body's footprint that has points above it."""
    plan = _cells(body.solid.points)
    low = plan.min(axis=0)
    in_plan = np.zeros(plan.max(axis=0) - low + 1, dtype=bool)
    in_plan[tuple((plan - low).T)] = True
    cover = _cells(above) - low
    covered = np.zeros_like(in_plan)
    covered[tuple(cover[((cover >= 0) & (cover < in_plan.shape)).all(axis=1)].T)] = True
    return int((in_plan & covered).sum()) / int(in_plan.sum())


def _cells(points: NDArray[np.float32]) -> NDArray[np.int64]:
    """Return the horizontal cells (N, 2) of points (N, 3)."""
    return np.floor(points[:, :2] / _COVER_CELL_M).astype(np.int64)


def stands_in(large: Body, small: Body, config: SupportConfig) -> bool:
    """Return whether the larger body is supported by the smaller one alone: a plant in its pot.

    The smaller box is mostly inside the larger one, and the lowest points of the larger body are over or under the
    smaller one. A bin under a desk is inside the desk's box, too, but the desk also has legs elsewhere.
    """
    if intersection_volume_m3(small.box, large.box) < config.pot_inside * small.box.volume_m3:
        return False
    points = large.solid.points
    low, high = float(large.bounds[0, 2]), float(large.bounds[1, 2])
    foot = points[points[:, 2] < low + config.pot_slice * (high - low)]
    if len(foot) < config.min_points:
        return False
    return float(small.box.is_over_or_under(foot, config.beside_m).mean()) > config.pot_under


def is_on_foot(upper: Body, lower: Body, config: SupportConfig) -> bool:
    """Return whether the lower body is the only support of the upper one: a seat on its swivel foot.

    The upper one's lowest points lie over the lower one, closely above its top, and no support surface continues around
    them.
    """
    points = upper.solid.points
    (low, high), (base, top) = _ends_m(upper.solid), _ends_m(lower.solid)
    if not -config.foot_step_m < low - top < config.foot_step_m or low - base < config.foot_height_m:
        return False
    foot = points[points[:, 2] < low + max(config.foot_slice_m, config.foot_slice * (high - low))]
    if len(foot) < config.min_points:
        return False
    if float(lower.box.is_over_or_under(foot, config.beside_m).mean()) < config.foot_under:
        return False
    # A pot rests on a counter, but does not cover it as a seat covers its foot.
    if float(upper.box.is_over_or_under(lower.solid.points, config.corner_m).mean()) < config.foot_covered:
        return False
    return not _stands_on(upper, lower, config)


def is_inner_part(
    small: Body,
    large: Body,
    others: Iterable[Body],
    config: SupportConfig,
    *,
    inside: float | None = None,
    max_volume: float | None = None,
    was_one: bool = False,
) -> bool:
    """Return whether the smaller body is part of the larger one: inside its box, touching it, and resting on nothing.

    The panel of a desk, the board of a shelf, the foot of a chair. An object in a shelf rests on a board, and one under
    a desk does not touch it. A mug rests on the table, one of the `others`, although it is inside the box of a chair
    that is pushed under the table. `was_one`: their points were of one track, so that they touch. `inside` and
    `max_volume` take the place of `part_inside` and `part_volume`.
    """
    box = large.box.grown(config.part_slack_m)
    if small.box.volume_m3 > (config.part_volume if max_volume is None else max_volume) * large.box.volume_m3:
        return False
    least = config.part_inside if inside is None else inside
    if intersection_volume_m3(small.box, box) < least * small.box.volume_m3:
        return False
    if not was_one:
        is_board = is_panel(small, config)
        touching = _touches_across(small, large, config) if is_board else _touches(small, large, config)
        if not touching:
            return False
    return not any(_stands_on(small, support, config) for support in (large, *others))


def is_panel(body: Body, config: SupportConfig) -> bool:
    """Return whether a body is a thin board of the size of furniture panels, larger than a book."""
    thin, width, length = sorted(2 * body.box.half_extents_m)
    return bool(thin < config.panel_m and width > config.panel_width_m and length > config.panel_length_m)


def _touches(small: Body, large: Body, config: SupportConfig) -> bool:
    keys = small.solid.keys[:: max(1, len(small.solid.keys) // _SAMPLE)]
    return float(is_near(keys, large.solid).mean()) >= config.touch_share


def _touches_across(small: Body, large: Body, config: SupportConfig) -> bool:
    gap_m = config.panel_gap_m
    points = small.solid.points[:: max(1, len(small.solid.points) // _SAMPLE)]
    around = large.solid.points[small.box.grown(gap_m).contains(large.solid.points)]
    if len(around) == 0:
        return False
    distances_m, _ = cKDTree(around).query(points, distance_upper_bound=gap_m)
    return float(np.isfinite(distances_m).mean()) >= config.touch_share


# ---- rests on -------------------------------------------------------------------------------------------------------


def _stands_on(small: Body, large: Body, config: SupportConfig) -> bool:
    """Return whether the larger body has a horizontal surface around the foot of the smaller one, which rests on it.

    The smaller one occludes the surface right below it. A body that does not rise above a surface does not rest on it.
    """
    low, high = _ends_m(small.solid)
    around = large.solid.points[small.box.is_over_or_under(large.solid.points, config.ring_m)]
    around = around[(around[:, 2] > low - config.ring_below_m) & (around[:, 2] < low + config.ring_above_m)]
    if len(around) < config.min_points or high - float(np.median(around[:, 2])) < config.rise_m:
        return False
    cells = np.unique(np.floor(around[:, :2] / _RING_CELL_M), axis=0)
    x, y = 2 * small.box.half_extents_m[:2]
    ring = 2 * config.ring_m * float(x + y + 2 * config.ring_m)
    return len(cells) * _RING_CELL_M * _RING_CELL_M > config.ring_share * ring


def height_under(body: Body, other: Body, config: SupportConfig) -> float | None:
    """Return the height of another body's surface under a body, which rests on it; None where there is none.

    The surface must be under the box on most sides of its centre: the surface of a body beside it is not.
    """
    bottom = bottom_of_box_m(body)
    if bottom_of_box_m(other) > bottom - config.lower_m:
        return None
    points = other.cloud.points
    near = points[(points[:, 2] > bottom - config.under_below_m) & (points[:, 2] < bottom + config.under_above_m)]
    under = near[body.box.is_over_or_under(near, config.under_beside_m)]
    if len(under) < config.min_points or not _surrounds(under, body.box, config):
        return None
    return float(np.quantile(under[:, 2], config.under_quantile))


def bottom_of_box_m(body: Body) -> float:
    """Return the height at which the box of a body begins."""
    return float(body.box.center[2] - body.box.half_extents_m[2])


def _surrounds(points: NDArray[np.float32], box: OrientedBox, config: SupportConfig) -> bool:
    x, y = (points[:, :2] - box.center[:2]).T
    sectors = np.floor((portable.arctan2(y, x) + np.pi) / (2 * np.pi) * _SECTORS).astype(np.int64) % _SECTORS
    return int((np.bincount(sectors, minlength=_SECTORS) > 0).sum()) >= config.under_sectors


_ENDS_M: WeakKeyDictionary[Cloud, tuple[float, float]] = WeakKeyDictionary()


def _ends_m(cloud: Cloud) -> tuple[float, float]:
    """Return the lowest and the highest z of a cloud without outliers; cached, since clouds are in many pairs."""
    ends = _ENDS_M.get(cloud)
    if ends is None:
        low, high = np.percentile(cloud.points[:, 2], _OUTLIERS_PCT)
        ends = _ENDS_M[cloud] = (float(low), float(high))
    return ends


def _bottom_m(body: Body) -> float:
    return float(body.bounds[0, 2])
