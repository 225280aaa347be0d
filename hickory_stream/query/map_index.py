"""Arrays about the objects of a map, computed once, from which questions are answered."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.arrays import freeze, freeze_all
from hickory_stream.inspection.supports import supports_of
from hickory_stream.mapping.rules.support_graph import Relation, Support
from hickory_stream.query.colors import COLOR_NAMES, name_shares
from hickory_stream.query.shape_scores import (
    NUM_LEVELS,
    SHAPE_WORDS,
    hollow_score,
    level_areas_m2,
    shape_scores,
    top_map,
)
from hickory_stream.records import MapSnapshot, Phase, TrackedObject
from hickory_stream.storeys import floor_beneath, floor_of, floors_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hickory_stream.mapping.config import MappingConfig

# What holds an object that no other object holds.
ON_FLOOR, ON_NOTHING = -1, -2


# Objects whose bounds are farther apart on the floor than this have no relation.
_REACH_M = 2.5


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Pairs:
    """P ordered pairs of different objects: `i` and `j` (P,) are their indices."""

    i: NDArray[np.int64]
    j: NDArray[np.int64]

    def __post_init__(self) -> None:
        freeze_all(self, np.int64, i=(None,), j=(len(self.i),))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MapIndex:
    """N objects, sorted by id; lengths are metres, heights are above the floor."""

    ids: NDArray[np.int64]
    #: (N, 3) of their boxes in the world, as `lows` and `highs`
    centers: NDArray[np.float64]
    lows: NDArray[np.float64]
    highs: NDArray[np.float64]
    #: (N, 3) longer and shorter horizontal side, and height
    sides_m: NDArray[np.float64]
    bottom_m: NDArray[np.float64]
    #: (N,) probability of a fixture
    fixed: NDArray[np.float64]
    #: (N, 12) shares of `COLOR_NAMES`
    colors: NDArray[np.float64]
    #: (N, 6) degrees of `SHAPE_WORDS`
    shapes: NDArray[np.float64]
    #: (N, L) area that is open above, by height
    levels_m2: NDArray[np.float64]
    #: (N,) index of the object that holds it, or `ON_FLOOR`, `ON_NOTHING`
    held_by: NDArray[np.int64]
    is_at_wall: NDArray[np.bool_]
    #: (N, 3) camera position of its best view, NaN without one
    seen_from: NDArray[np.float64]
    #: near enough for a relation
    pairs: Pairs

    def __post_init__(self) -> None:
        count = len(self.ids)
        freeze(self, "ids", np.int64, (count,))
        for name in ("centers", "lows", "highs", "sides_m", "seen_from"):
            freeze(self, name, np.float64, (count, 3))
        freeze_all(self, np.float64, bottom_m=(count,), fixed=(count,), colors=(count, len(COLOR_NAMES)))
        freeze_all(self, np.float64, shapes=(count, len(SHAPE_WORDS)), levels_m2=(count, NUM_LEVELS))
        freeze(self, "held_by", np.int64, (count,))
        freeze(self, "is_at_wall", np.bool_, (count,))

    def __len__(self) -> int:
        return len(self.ids)


def index_of(snapshot: MapSnapshot, config: MappingConfig) -> MapIndex:
    """Return the index of a map's objects without tentative ones and those without points."""
    objects = [item for item in snapshot.objects if item.phase is not Phase.TENTATIVE and len(item.points_world)]
    objects.sort(key=lambda item: item.id)
    floors_m = floors_of(snapshot) or (floor_of(snapshot),)
    ids = [item.id for item in objects]
    supports = supports_of(snapshot, config)
    corners = np.array([item.box.corners_world() for item in objects]).reshape(-1, 8, 3)
    lows, highs = corners.min(axis=1), corners.max(axis=1)
    tops = [top_map(item.points_world, item.box) for item in objects]
    halves = np.array([item.box.half_extents_m for item in objects]).reshape(-1, 3)
    sides_m = np.column_stack([2 * np.sort(halves[:, :2])[:, ::-1], 2 * halves[:, 2]])
    bottom_m = lows[:, 2] - np.array([floor_beneath(floors_m, low) for low in lows[:, 2].tolist()])
    shapes = [
        shape_scores(item.superquadrics, sides, hollow_score(top, float(sides[2])))
        for item, top, sides in zip(objects, tops, sides_m, strict=True)
    ]
    levels = [level_areas_m2(top, float(bottom)) for top, bottom in zip(tops, bottom_m, strict=True)]
    return MapIndex(
        ids=np.array(ids, dtype=np.int64),
        centers=(lows + highs) / 2,
        lows=lows,
        highs=highs,
        sides_m=sides_m,
        bottom_m=bottom_m,
        fixed=np.array([item.fixture_probability for item in objects]),
        colors=np.array([name_shares(item.colors) for item in objects]).reshape(-1, len(COLOR_NAMES)),
        shapes=np.array(shapes).reshape(-1, len(SHAPE_WORDS)),
        levels_m2=np.array(levels).reshape(-1, NUM_LEVELS),
        held_by=np.array([_holder(supports[i], ids) for i in ids], dtype=np.int64),
        is_at_wall=np.array([_is_at_wall(supports[i]) for i in ids], dtype=bool),
        seen_from=np.array([_seen_from(item) for item in objects]).reshape(-1, 3),
        pairs=neighbours(lows[:, :2], highs[:, :2]),
    )


def neighbours(lows: NDArray[np.float64], highs: NDArray[np.float64]) -> Pairs:
    """Return all pairs of (N, 2) horizontal bounds near enough for a relation."""
    found = []
    for k in range(len(lows)):
        is_near = ((lows - _REACH_M <= highs[k]) & (highs + _REACH_M >= lows[k])).all(axis=1)
        is_near[k] = False
        found.append(np.flatnonzero(is_near))
    i = np.repeat(np.arange(len(lows)), [len(row) for row in found])
    return Pairs(i=i, j=np.concatenate([np.empty(0, np.int64), *found]))


def _holder(supports: Sequence[Support], ids: list[int]) -> int:
    for relation in (Relation.RESTS_ON, Relation.HANGS_FROM):
        for edge in supports:
            if edge.relation is relation:
                return ON_FLOOR if edge.by is None else ids.index(edge.by) if edge.by in ids else ON_NOTHING
    return ON_NOTHING


def _is_at_wall(supports: Sequence[Support]) -> bool:
    return any(edge.relation is Relation.LEANS_ON for edge in supports)


def _seen_from(item: TrackedObject) -> NDArray[np.float64]:
    return np.full(3, np.nan) if item.best_view is None else item.best_view.world_from_camera[:3, 3]
