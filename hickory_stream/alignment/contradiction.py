"""Evidence against a transform: objects of one map where the other observed free space.

A point of an object is missing if the other map observed free space there and nothing solid nearby. An object is
expected in the other map if most of its points were observed there; it is missing if most of these are missing.

A missing fixture counts as three objects. Under a wrong transform 0.74 of the objects of a dense room are missing;
under the right one, a day later, 8 of 35 that can be carried, and 0.02 of fixtures, by assumption: 0.5 and 1.5 decades.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.answer import Contradictions
from hickory_stream.alignment.object_map import ObjectMap
from hickory_stream.base.ranges import Ranged, number
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.geometry.voxels import are_near, contains, keys_of_cells
from hickory_stream.records import Submap

_MAX_POINTS = 100
_FIXTURE = 3.0
_NEAR_VOXELS = 3.5
"""Points in the same or in adjacent voxels are less than the root of twelve voxels apart, however the axes lie."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ContradictionConfig(Ranged):
    """When an object counts as missing.

    Attributes:
        min_looked_at: an object is expected if at least this share of its points was observed ...
        max_missed: ... and missing if more than this share of those is in free space.
        price: each missing object adds this to the log10 of the expected number of false alarms.
        max_missing: maximum share of the expected objects that may be missing ...
        min_expected: ... applied if at least this many are expected.
    """

    min_looked_at: float = number(0.5, 0, 1, "share")
    max_missed: float = number(0.6, 0, 1, "share")
    price: float = number(0.5, 0, 1000, "log10")
    max_missing: float = number(0.4, 0, 1, "share")
    min_expected: int = number(5, 0, 1_000_000, "objects")


def contradictions(
    map_a: ObjectMap, map_b: ObjectMap, a_from_b: NDArray[np.float64], config: ContradictionConfig
) -> Contradictions:
    """Return the evidence against a transform; all counts are 0 if a map has no observed space or no points."""
    a_expected, a_missing = _missing(map_a, invert(a_from_b), map_b, config)
    b_expected, b_missing = _missing(map_b, a_from_b, map_a, config)
    a_weights, b_weights = (1 + (_FIXTURE - 1) * objects.fixed for objects in (map_a, map_b))
    return Contradictions(
        num_expected=int(a_expected.sum() + b_expected.sum()),
        num_missing=int(a_missing.sum() + b_missing.sum()),
        ids_a=tuple(map_a.ids[a_missing].tolist()),
        ids_b=tuple(map_b.ids[b_missing].tolist()),
        expected=float(a_weights[a_expected].sum() + b_weights[b_expected].sum()),
        missing=float(a_weights[a_missing].sum() + b_weights[b_missing].sum()),
    )


def _missing(
    objects: ObjectMap, other_from_here: NDArray[np.float64], other: ObjectMap, config: ContradictionConfig
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    # (N,) which objects are expected in the other map, and which are missing there.
    known = [(i, thinned(points)) for i, points in enumerate(objects.points) if points is not None]
    if not known or not other.submaps:
        return np.zeros(len(objects), dtype=bool), np.zeros(len(objects), dtype=bool)
    owners = np.concatenate([np.full(len(points), i) for i, points in known])
    points_other = apply(other_from_here, np.concatenate([points for _, points in known]).astype(np.float64))
    is_free = np.zeros(len(owners), dtype=bool)
    is_solid = np.zeros(len(owners), dtype=bool)
    bodies = np.concatenate([np.empty((0, 3)), *(points for points in other.points if points is not None)])
    for submap in other.submaps:
        space, cells = submap.observed_space, _cells(points_other, submap)
        is_free |= contains(space.free, keys_of_cells(cells))
        # What one submap has as solid no other has to be asked for, nor points of objects that are near nothing else.
        left = np.flatnonzero(~is_solid)
        is_solid[left] = are_near(space.structure, keys_of_cells(cells[left]))
        left = left[~is_solid[left]]
        bodies = bodies[_within(_NEAR_VOXELS * space.voxel_m, bodies, points_other[left])]
        is_solid[left] = are_near(np.unique(keys_of_cells(_cells(bodies, submap))), keys_of_cells(cells[left]))
    for points, box in zip(other.points, other.boxes, strict=True):
        if points is None:
            is_solid |= box.contains(points_other)
    looked_at, missed = is_free | is_solid, is_free & ~is_solid
    count = len(objects)
    totals = np.bincount(owners, minlength=count)
    seen, lost = np.bincount(owners[looked_at], minlength=count), np.bincount(owners[missed], minlength=count)
    is_expected = (totals > 0) & (seen >= config.min_looked_at * totals)
    return is_expected, is_expected & (lost > config.max_missed * seen)


def thinned(points: NDArray[np.float32], most: int = _MAX_POINTS) -> NDArray[np.float32]:
    """Return at most `most` of the points, at an even stride."""
    if len(points) <= most:
        return points
    return points[np.linspace(0, len(points) - 1, most).astype(np.int64)]


def _within(reach_m: float, points: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.bool_]:
    around = np.array(list(np.ndindex(3, 3, 3))) - 1
    cells = np.unique(np.floor(others / reach_m).astype(np.int64), axis=0)
    keys = np.unique(keys_of_cells((cells[:, None] + around).reshape(-1, 3)))
    return contains(keys, keys_of_cells(np.floor(points / reach_m).astype(np.int64)))


def _cells(points_world: NDArray[Any], submap: Submap) -> NDArray[np.int64]:
    local = apply(invert(submap.world_from_submap), points_world)
    return np.floor(local / submap.observed_space.voxel_m).astype(np.int64)
