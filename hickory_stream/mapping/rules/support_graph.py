"""The support graph: which body rests on, hangs from, leans on, is part of or is hidden by which other body.

An edge is computed from the current bodies when it is queried; `edges` computes all. Three measures of contact differ:
`rests_on` needs the height of the surface, from the points under the box, but masks reach below their objects;
`foot_of` and `part_of` must not merge objects, so the surface must be visible as a ring around the foot; `hangs_from`
must not attach a supported body, so any contact of its lowest points counts. With `height_under` in place of the other
two, `home` keeps other tracks. An unsupported track, e.g. the shade of a lamp with an unseen stem, belongs to the
nearest track.
"""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import scipy
from numpy.typing import NDArray

from hickory_stream.geometry.voxels import contains, keys_of_points, sorted_unique
from hickory_stream.mapping.entities.observed_space import SpaceState, sees_structure
from hickory_stream.mapping.rules.support_relations import (
    COLUMN_M,
    LOWEST_PCT,
    MEET_M,
    SLACK_M,
    Body,
    bottom_of_box_m,
    height_under,
    is_hidden_by,
    is_inner_part,
    is_leg,
    is_on_foot,
    stands_in,
)

# The depths below the lowest points at which free space is checked: beyond the noise of the foot, a few voxels deep.
_BELOW_M = (2 * SLACK_M, 3 * SLACK_M, 4 * SLACK_M)
# A body that begins this near to the floor rests on it.
_ON_FLOOR_M = 0.35
# Minimum height of an unsupported track's lowest points above the floor: lower tracks may have thin feet.
_MIN_HEIGHT_M = 0.25
# Minimum share of the space below its lowest points that was observed free.
_FREE_SHARE = 0.9
# It is supported if more than this share of its lowest points is beside another track, or if structure is near.
_SUPPORT_SHARE = 0.1
_NEAR_WALL_M = 2 * SLACK_M


def attachment_of(body: Body, others: Iterable[Body], space: SpaceState) -> Body | None:
    """Return the nearest body of an unsupported body; None if it is supported, or no other body is near."""
    points = body.solid.points
    if space.floor_z_m is None or len(points) == 0:
        return None
    low = float(np.percentile(points[:, 2], LOWEST_PCT))
    if low < space.floor_z_m + _MIN_HEIGHT_M:
        return None
    foot = points[points[:, 2] < low + SLACK_M]
    if not _is_free_below(foot, points, space) or sees_structure(space, body.box, points, _NEAR_WALL_M):
        return None
    near = [other for other in others if other.id != body.id and _meet(body, other, MEET_M)]
    clouds = [scipy.spatial.cKDTree(other.solid.points) for other in near]
    for cloud in clouds:
        distances_m, _ = cloud.query(foot, distance_upper_bound=SLACK_M)
        if float(np.isfinite(distances_m).mean()) >= _SUPPORT_SHARE:
            return None
    gaps_m = [float(cloud.query(points, distance_upper_bound=MEET_M)[0].min()) for cloud in clouds]
    closest = min(range(len(near)), key=lambda i: (gaps_m[i], near[i].id), default=None)
    return None if closest is None or not np.isfinite(gaps_m[closest]) else near[closest]


def _is_free_below(foot: NDArray[np.float32], points: NDArray[np.float32], space: SpaceState) -> bool:
    own = sorted_unique(keys_of_points(points, space.voxel_m))
    below = np.concatenate([foot - np.array([0.0, 0.0, depth_m], np.float32) for depth_m in _BELOW_M])
    keys = keys_of_points(below, space.voxel_m)
    keys = keys[~contains(own, keys)]
    return len(keys) > 0 and float(contains(space.free, keys).mean()) >= _FREE_SHARE


def _meet(a: Body, b: Body, slack_m: float) -> bool:
    (a_low, a_high), (b_low, b_high) = a.bounds, b.bounds
    return bool((a_low <= b_high + slack_m).all() and (b_low <= a_high + slack_m).all())


# Bodies whose bounds are farther apart have no relation.
REACH_M = COLUMN_M


class Relation(StrEnum):
    """How a body is supported."""

    RESTS_ON = "rests on"
    HANGS_FROM = "hangs from"
    LEANS_ON = "leans on"
    PART_OF = "is part of"
    HIDDEN_BY = "is hidden by"


@dataclass(frozen=True, kw_only=True, slots=True)
class Support:
    """The relation of `body` to another body `by`; None is the room, its floor or a wall."""

    body: int
    relation: Relation
    by: int | None
    #: height of the support surface
    height_m: float | None = None
    #: the contact that makes a body a part
    reason: str = ""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SupportGraph:
    """The relations between `bodies`, by id, and to the room of a `space`."""

    bodies: Mapping[int, Body]
    space: SpaceState

    def rests_on(self, body: Body) -> Support | None:
        """Return the highest surface that a body rests on, another body's or the floor; None if none is known."""
        found: Support | None = None
        for other in self.bodies.values():
            if other.id == body.id or (height_m := height_under(body, other)) is None:
                continue
            if found is None or found.height_m is None or height_m > found.height_m:
                found = Support(body=body.id, relation=Relation.RESTS_ON, by=other.id, height_m=height_m)
        floor_m = self.space.floor_z_m
        if found is not None or floor_m is None or bottom_of_box_m(body) - floor_m >= _ON_FLOOR_M:
            return found
        return Support(body=body.id, relation=Relation.RESTS_ON, by=None, height_m=floor_m)

    def leans_on(self, body: Body) -> Support | None:
        """Return the edge to the room if structure is beside a body, or None."""
        is_beside = sees_structure(self.space, body.box, body.solid.points, _NEAR_WALL_M)
        return Support(body=body.id, relation=Relation.LEANS_ON, by=None) if is_beside else None

    def hangs_from(self, body: Body, others: Iterable[Body] | None = None) -> Support | None:
        """Return the edge to the nearest of `others` (None: all bodies) that an unsupported body touches, or None."""
        candidates = self.bodies.values() if others is None else others
        host = attachment_of(body, candidates, self.space)
        return None if host is None else Support(body=body.id, relation=Relation.HANGS_FROM, by=host.id)

    def foot_of(self, a: Body, b: Body) -> Support | None:
        """Return the edge by which the lower of two bodies is the foot of the upper one, or None."""
        upper, lower = (a, b) if a.bounds[0, 2] > b.bounds[0, 2] else (b, a)
        is_foot = is_on_foot(upper, lower)
        return _part(lower, upper, "the lower is the foot of the upper") if is_foot else None

    def part_of(
        self, small: Body, large: Body, near: Iterable[Body], *, seen_apart: bool = False, may_be_patch: bool = True
    ) -> Support | None:
        """Return the edge by which `small` is a leg, pot or inner part of `large`, resting on none `near`, or None.

        What keyframes saw apart (`seen_apart`) is no leg: a stool stands under its table as a leg does.
        """
        if not seen_apart and is_leg(small, large):
            return _part(small, large, "the smaller stands under the larger like a leg")
        if stands_in(large, small):
            return _part(small, large, "the larger stands in the smaller")
        others = [body for body in near if body.id not in (small.id, large.id)]
        is_part = is_inner_part(small, large, others, may_be_patch=may_be_patch)
        return _part(small, large, "the smaller is a part inside the larger") if is_part else None

    def still_part_of(self, small: Body, large: Body, near: Iterable[Body]) -> Support | None:
        """Return the edge by which the smaller body, split off the larger one, is an inner part of it, or None."""
        is_part = is_inner_part(small, large, near, was_one=True)
        return _part(small, large, "the smaller was a part inside the larger") if is_part else None

    def hidden_by(self, small: Body, large: Body) -> Support | None:
        """Return the edge by which the larger body occludes the upper end of the smaller one, or None."""
        is_hidden = is_hidden_by(small, large)
        return Support(body=small.id, relation=Relation.HIDDEN_BY, by=large.id) if is_hidden else None

    def edges(self, of: Collection[int] | None = None) -> tuple[Support, ...]:
        """Return all relations of the bodies `of` (None: all). A body rests on, or hangs from, at most one other."""
        found: list[Support | None] = []
        for body in (self.bodies[i] for i in sorted(self.bodies if of is None else of)):
            rests = self.rests_on(body)
            found += [rests, self.leans_on(body), None if rests is not None else self.hangs_from(body)]
            near = self._near(body)
            for other in near:
                if body.box.volume_m3 < other.box.volume_m3:
                    found += [self.part_of(body, other, near), self.hidden_by(body, other)]
                foot = self.foot_of(body, other)
                found.append(foot if foot is not None and foot.body == body.id else None)
        return tuple(edge for edge in found if edge is not None)

    def _near(self, body: Body) -> list[Body]:
        ordered = (self.bodies[i] for i in sorted(self.bodies))
        return [other for other in ordered if other.id != body.id and _meet(body, other, REACH_M)]


def _part(part: Body, whole: Body, reason: str) -> Support:
    return Support(body=part.id, relation=Relation.PART_OF, by=whole.id, reason=reason)
