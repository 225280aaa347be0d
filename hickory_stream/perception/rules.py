"""The rules by which two fragments that touch, or a plane and its legs, are one thing.

Every rule looks at two fragments and the seam between them. Rules only join; what no rule joins stays apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.perception.pieces import Pieces
    from hickory_stream.perception.seams import Contacts, Seam
    from hickory_stream.perception.standing import Standing
    from hickory_stream.perception.surface import Surface


@dataclass(frozen=True, kw_only=True, slots=True)
class RuleConfig:
    """When two fragments are one thing.

    Attributes:
        seam_share: a seam must be at least this share of the square root of the smaller fragment's pixels.
        like_color: difference in Lab (lightness at half weight) under which two fragments are of one colour.
        rim_m: a seam within this distance of a plane's rim lies on the rim (a chair's back on its seat).
        foot_m, foot_rim: what stands on something of its colour with a wider foot than this, and farther from the rim
            than this share of the size of what carries it, was put there: a box on a box.
        below_m: a fragment whose top is at most this far above a plane hangs below it.
        leg_gap_m: a leg is seen up to this far below the plane that it carries.
        carrier_area_m2: a smaller plane carries nothing.
        seat_low_m, seat_high_m: heights above the floor between which one sits.
        seat_area_m2: a larger plane is no seat.
        back_m: what reaches this far above a seat from its rim is its back, whatever the colours.
        body_share: a plane to which more than this share of its area is joined is the top of a body, and no seat.
    """

    seam_share: float = 0.3
    like_color: float = 11.0
    rim_m: float = 0.07
    foot_m: float = 0.06
    foot_rim: float = 0.25
    below_m: float = 0.012
    leg_gap_m: float = 0.2
    seat_low_m: float = 0.25
    seat_high_m: float = 0.6
    seat_area_m2: float = 0.4
    back_m: float = 0.2
    body_share: float = 0.8
    carrier_area_m2: float = 0.08


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Scene:
    """What the rules look at: the surface, the fragments `labels` (h, w) and what was measured of them."""

    surface: Surface
    labels: NDArray[np.int32]
    pieces: Pieces
    standing: Standing
    is_seat: NDArray[np.bool_]


def is_one_thing(scene: Scene, seam: Seam, config: RuleConfig) -> bool:
    """Return whether two fragments that touch along a seam are one thing."""
    a, b, pieces = seam.a, seam.b, scene.pieces
    is_long = len(seam.points_world) >= config.seam_share * np.sqrt(min(pieces.pixels[a], pieces.pixels[b]))
    color = pieces.color_difference(a, b)
    is_plane_a, is_plane_b = pieces.support[a] > 0, pieces.support[b] > 0
    if is_plane_a and is_plane_b:
        # Two levels that touch: a step of one thing if of one colour, else a thing on another.
        return is_long and color < 0.6 * config.like_color
    if is_plane_a or is_plane_b:
        plane, other = (a, b) if is_plane_a else (b, a)
        return _belongs_to_plane(scene, seam, plane, other, is_long, config)
    if not is_long or color >= config.like_color or _stand_side_by_side(scene.standing, a, b):
        return False
    return not any(_is_put_on(scene, seam, upper, lower, config) for upper, lower in ((a, b), (b, a)))


def seats(pieces: Pieces, floor_z_m: float | None, config: RuleConfig) -> NDArray[np.bool_]:
    """Return (count,) which pieces are planes to sit on, by their height and size; none while no floor is known."""
    if floor_z_m is None:
        return np.zeros(len(pieces.pixels), dtype=bool)
    height = (pieces.z_high_m + pieces.z_low_m) / 2 - floor_z_m
    at_height = (height > config.seat_low_m) & (height < config.seat_high_m)
    return np.asarray((pieces.support > 0) & at_height & (pieces.area_m2 < config.seat_area_m2))


def carriers(scene: Scene, config: RuleConfig) -> NDArray[np.bool_]:
    """Return (count,) which fragments are planes that carry things: tables, shelves, boards, but no seats."""
    pieces = scene.pieces
    return (pieces.support > 0) & (pieces.area_m2 > config.carrier_area_m2) & ~scene.is_seat


def is_back(scene: Scene, seam: Seam, is_bare: NDArray[np.bool_], config: RuleConfig) -> bool:
    """Return whether one fragment is a seat and the other its back, whatever their colours: it rises from the rim.

    `is_bare` (count,): fragments to which little is joined: the top of a box before a higher one is no seat.
    """
    for seat, back in ((seam.a, seam.b), (seam.b, seam.a)):
        if scene.is_seat[seat] and is_bare[seat] and scene.pieces.support[back] == 0:
            rises = scene.pieces.z_high_m[back] > scene.pieces.z_high_m[seat] + config.back_m
            # Two posts that meet a seat at its corners make a seam of few pixels and of its whole width.
            return bool(rises) and len(seam.points_world) >= 4 and _stands_on_rim(scene, seam, seat, config)
    return False


def bare_planes(pieces: Pieces, groups: NDArray[np.int64], config: RuleConfig) -> NDArray[np.bool_]:
    """Return (count,) to which fragments little else is joined, by its area, in `groups` (count,)."""
    area_m2 = np.bincount(groups, weights=pieces.area_m2, minlength=len(groups))[groups]
    return np.asarray(area_m2 - pieces.area_m2 < config.body_share * pieces.area_m2)


def _belongs_to_plane(scene: Scene, seam: Seam, plane: int, other: int, is_long: bool, config: RuleConfig) -> bool:
    """Return whether a fragment hangs below a plane, or rises from its rim in its colour."""
    pieces = scene.pieces
    height = float(pieces.z_high_m[plane] + pieces.z_low_m[plane]) / 2
    if pieces.z_high_m[other] < height + config.below_m:
        return is_long
    if not is_long or pieces.color_difference(plane, other) >= config.like_color:
        return False
    return _stands_on_rim(scene, seam, plane, config)


def _is_put_on(scene: Scene, seam: Seam, upper: int, lower: int, config: RuleConfig) -> bool:
    """Return whether a fragment stands on another with a wide foot, away from its rim: a box on a box, no pole."""
    if not scene.standing.stands_on(upper, lower):
        return False
    extent = float(np.linalg.norm(np.ptp(seam.points_world[:, :2], axis=0)))
    return extent > config.foot_m and not _stands_on_rim(scene, seam, lower, config, config.foot_rim)


def _stand_side_by_side(standing: Standing, a: int, b: int) -> bool:
    """Return whether two fragments stand on the same thing: then they touch, but each stands for itself."""
    return any(standing.stands_on(a, c) and standing.stands_on(b, c) for c in map(int, np.flatnonzero(standing.on[a])))


def _stands_on_rim(scene: Scene, seam: Seam, plane: int, config: RuleConfig, share: float = np.inf) -> bool:
    """Return whether a seam runs along the rim of a plane and is as long as half of it: a back on its seat.

    The rim is no wider than a `share` of the plane's size.
    """
    at = scene.surface.points_world[scene.labels == plane][:, :2]
    hull = cv2.convexHull(np.ascontiguousarray(at))
    if len(hull) < 3:
        return False
    inside = np.array([cv2.pointPolygonTest(hull, (float(x), float(y)), True) for x, y, _ in seam.points_world])
    extent = float(np.linalg.norm(np.ptp(seam.points_world[:, :2], axis=0)))
    size = float(np.sqrt(max(cv2.contourArea(hull), 1e-6)))
    return bool(np.mean(inside < min(config.rim_m, share * size)) > 0.8) and extent > 0.5 * size


def legs(scene: Scene, contacts: Contacts, groups: NDArray[np.int64], config: RuleConfig) -> list[tuple[int, int]]:
    """Return (plane, leg) pairs: a leg vanishes upwards behind the edge of what it carries, and stands under it."""
    count, pieces = len(groups), scene.pieces
    vanishes = contacts.is_below & ~contacts.touches & ~contacts.nearer
    vanishes &= (contacts.here < count) & (contacts.there < count)
    upper, lower = groups[contacts.here[vanishes]], contacts.there[vanishes].astype(np.int64)
    pairs, counts = np.unique(upper * count + lower, return_counts=True)
    found: list[tuple[int, int]] = []
    for pair, number in zip(pairs, counts, strict=True):
        group, leg = int(pair) // count, int(pair) % count
        if groups[leg] == group or pieces.support[leg] > 0:
            continue
        columns = np.flatnonzero((scene.labels == leg).any(axis=0)).size
        if number <= 0.4 * columns:
            continue
        for plane in np.flatnonzero((groups == group) & (pieces.support > 0)):
            top = float(pieces.z_low_m[plane])
            reaches = top - config.leg_gap_m < pieces.z_high_m[leg] < top + config.below_m
            if reaches and _is_under(scene, int(plane), leg):
                found.append((int(plane), leg))
                break
    return found


def _is_under(scene: Scene, plane: int, leg: int) -> bool:
    """Return whether 80 % of a fragment's points lie under the convex hull of a plane, to 6 cm."""
    points = scene.surface.points_world
    hull = cv2.convexHull(np.ascontiguousarray(points[scene.labels == plane][:, :2]))
    below = points[scene.labels == leg][::7, :2]
    return float(np.mean([cv2.pointPolygonTest(hull, (float(x), float(y)), True) > -0.06 for x, y in below])) > 0.8
