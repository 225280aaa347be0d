"""Degrees of relations (on, under, beside, in front of) for each pair of neighbours."""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.query.map_index import ON_FLOOR, MapIndex, Pairs
from hickory_stream.query.question import Relation, Room
from hickory_stream.query.shape_scores import ramp

# Gaps between boxes, metres: not at all, fully.
_NEAR = (1.5, 0.5)
_BESIDE = (0.5, 0.2)
# Of the smaller footprint, the share that two have in common.
_OVER = (0.2, 0.5)
_BESIDE_OVER = (0.5, 0.25)
# Of an object's box, the share inside another one's.
_INSIDE = (0.5, 0.8)
_TOUCH_M = 0.05
# In front, or to the left: how far that way at most, and how far off that way, beyond half of the width.
_FRONT = (2.0, 1.2)
_ASIDE = (0.4, 0.1)


def related(
    index: MapIndex, pairs: Pairs, relation: Relation, viewer: tuple[float, float] | None
) -> NDArray[np.float64]:
    """Return (P,) degrees in 0..1 of a relation of object i to object j of each pair.

    `viewer` is the viewpoint of "in front of" and "left of"; None: the best viewpoint of each j.
    """
    turned = Pairs(i=pairs.j, j=pairs.i)
    if relation is Relation.ON:
        return _is_held(index, pairs)
    if relation is Relation.CARRYING:
        return _is_held(index, turned)
    if relation is Relation.UNDER:
        return np.maximum(_is_held(index, turned), _is_over(index, turned))
    if relation is Relation.ABOVE:
        return np.maximum(_is_held(index, pairs), _is_over(index, pairs))
    if relation is Relation.IN:
        volumes = np.maximum((index.highs - index.lows).prod(axis=1), 1e-12)
        return ramp(_overlaps(index, pairs).prod(axis=1) / volumes[pairs.i], *_INSIDE)
    if relation is Relation.BESIDE:
        return _is_beside(index, pairs)
    if relation is Relation.NEAR:
        return ramp(np.linalg.norm(_gaps(index, pairs), axis=1), *_NEAR)
    return _seen_beside(index, pairs, viewer, relation)


def related_to_place(index: MapIndex, relation: Relation, x: float, y: float) -> NDArray[np.float64] | None:
    """Return (N,) degrees of a relation to a place on the floor plan; None for relations other than near and beside."""
    distances_m = distances_to_place(index, x, y)
    if relation is Relation.NEAR:
        return ramp(distances_m, *_NEAR)
    return ramp(distances_m, *_BESIDE) if relation is Relation.BESIDE else None


def related_to_room(index: MapIndex, relation: Relation, room: Room) -> NDArray[np.float64] | None:
    """Return (N,) degrees of a relation to the floor or a wall; None for other relations."""
    if room == "floor":
        return (index.held_by == ON_FLOOR).astype(np.float64) if relation is Relation.ON else None
    fits = relation in (Relation.ON, Relation.NEAR, Relation.BESIDE)
    return index.is_at_wall.astype(np.float64) if fits else None


def distances_to_place(index: MapIndex, x: float, y: float) -> NDArray[np.float64]:
    """Return the (N,) horizontal distances from the objects' boxes to a place."""
    here = np.array([x, y])
    outside = np.maximum(np.maximum(index.lows[:, :2] - here, here - index.highs[:, :2]), 0.0)
    return np.asarray(np.linalg.norm(outside, axis=1))


def distances_to(index: MapIndex, places: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the (N,) distances from the objects' boxes to the nearest of some others; infinite without any."""
    nearest = np.full(len(index), np.inf)
    for k in places:
        away = np.maximum(np.maximum(index.lows - index.highs[k], index.lows[k] - index.highs), 0.0)
        squares = (away * away).sum(axis=1)
        squares[k] = np.inf
        nearest = np.minimum(nearest, squares)
    return np.sqrt(nearest)


def _is_held(index: MapIndex, pairs: Pairs) -> NDArray[np.float64]:
    return (index.held_by[pairs.i] == pairs.j).astype(np.float64)


def _gaps(index: MapIndex, pairs: Pairs) -> NDArray[np.float64]:
    # (P, 3) gap of the bounds along each axis, 0 where they overlap.
    i, j = pairs.i, pairs.j
    return np.maximum(np.maximum(index.lows[i] - index.highs[j], index.lows[j] - index.highs[i]), 0.0)


def _overlaps(index: MapIndex, pairs: Pairs) -> NDArray[np.float64]:
    """Return (P, 3) the lengths that the bounds have in common along each axis."""
    i, j = pairs.i, pairs.j
    return np.maximum(np.minimum(index.highs[i], index.highs[j]) - np.maximum(index.lows[i], index.lows[j]), 0.0)


def _shared_footprint(index: MapIndex, pairs: Pairs) -> NDArray[np.float64]:
    areas = np.maximum((index.highs - index.lows)[:, :2].prod(axis=1), 1e-9)
    shared = _overlaps(index, pairs)[:, :2].prod(axis=1)
    return np.asarray(shared / np.minimum(areas[pairs.i], areas[pairs.j]))


def _is_over(index: MapIndex, pairs: Pairs) -> NDArray[np.float64]:
    # (P,) i is above the top of j, or its middle is, as of a table that spans a box.
    top_m = index.highs[pairs.j, 2]
    middles_m = (index.lows[pairs.i, 2] + index.highs[pairs.i, 2]) / 2
    is_above = (index.lows[pairs.i, 2] >= top_m - _TOUCH_M) | (middles_m >= top_m - _TOUCH_M)
    return ramp(_shared_footprint(index, pairs), *_OVER) * is_above


def _is_beside(index: MapIndex, pairs: Pairs) -> NDArray[np.float64]:
    gaps = _gaps(index, pairs)
    level = (gaps[:, 2] <= _TOUCH_M).astype(np.float64)
    apart = ramp(_shared_footprint(index, pairs), *_BESIDE_OVER)
    return np.asarray(ramp(np.hypot(gaps[:, 0], gaps[:, 1]), *_BESIDE) * level * apart * _is_free(index, pairs))


def _seen_beside(
    index: MapIndex, pairs: Pairs, viewer: tuple[float, float] | None, relation: Relation
) -> NDArray[np.float64]:
    # (P,) i lies near j in this direction, as the viewer sees it.
    centers = index.centers[:, :2]
    eyes = index.seen_from[:, :2] if viewer is None else np.broadcast_to(np.array(viewer), centers.shape)
    sight = centers - eyes
    lengths = np.linalg.norm(sight, axis=1, keepdims=True)
    # Who was never seen, or stands where the viewer is, has no front.
    sight = np.divide(sight, lengths, out=np.zeros_like(sight), where=np.isfinite(lengths) & (lengths > 0))[pairs.j]
    offsets = centers[pairs.i] - centers[pairs.j]
    beyond = (offsets * sight).sum(axis=1)
    left = sight[:, 0] * offsets[:, 1] - sight[:, 1] * offsets[:, 0]
    ways = {
        Relation.IN_FRONT_OF: (-beyond, left),
        Relation.BEHIND: (beyond, left),
        Relation.LEFT_OF: (left, beyond),
        Relation.RIGHT_OF: (-left, beyond),
    }
    that_way, across = ways[relation]
    half = ((index.highs - index.lows)[:, :2].max(axis=1) / 2)[pairs.j]
    near = ramp(that_way, *_FRONT) * ramp(np.abs(across) - half, *_ASIDE)
    return np.asarray(near * (that_way > 0) * _is_free(index, pairs))


def _is_free(index: MapIndex, pairs: Pairs) -> NDArray[np.float64]:
    # (P,) neither holds the other: an object on a table is neither beside it nor in front of it.
    return 1.0 - np.maximum(_is_held(index, pairs), _is_held(index, Pairs(i=pairs.j, j=pairs.i)))
