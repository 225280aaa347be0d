"""Observations of one map where another has an object: free space, a surface, or nothing.

Only points that stand clear of everything else in the object's own map count: most points of a plate lie within a few
centimetres of the table, so that a surface there does not prove the plate.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hickory_stream.alignment.contradiction import thinned
from hickory_stream.changes.records import Evidence
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.geometry.voxels import are_near, bounds_of_keys, contains, keys_of_cells
from hickory_stream.records import MapSnapshot, Phase, Submap, TrackedObject

_POINTS_OF_SURFACE = 2500
_POINTS_OF_EVIDENCE = 200
_MIN_CLEAR = 12
# More than what turning corners into the world rounds off.
_ROUNDING_M = 1e-6


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SeenPlaces:
    """A map as evidence: N objects with a tree of all their points, and the observed space of each submap.

    `owners` (P,) are the indices in `objects` of the tree's points; `bounds` (S, 2, 3) are the world bounds of each
    submap with a voxel around.
    """

    objects: tuple[TrackedObject, ...]
    submaps: tuple[Submap, ...]
    bounds: NDArray[np.float64]
    tree: cKDTree | None
    owners: NDArray[np.int64]


def compared_objects(snapshot: MapSnapshot) -> tuple[TrackedObject, ...]:
    """Return the objects of a map without tentative ones and those without points."""
    return tuple(item for item in snapshot.objects if item.phase is not Phase.TENTATIVE and len(item.points_world))


def seen_places(objects: Sequence[TrackedObject], submaps: Sequence[Submap]) -> SeenPlaces:
    """Return a map as evidence."""
    clouds = [thinned(item.points_world, _POINTS_OF_SURFACE) for item in objects]
    points = np.concatenate([np.empty((0, 3), np.float32), *clouds]).astype(np.float64)
    owners = np.repeat(np.arange(len(clouds)), [len(cloud) for cloud in clouds])
    tree = cKDTree(points) if len(points) else None
    bounds = np.array([_bounds(submap) for submap in submaps]).reshape(-1, 2, 3)
    return SeenPlaces(objects=tuple(objects), submaps=tuple(submaps), bounds=bounds, tree=tree, owners=owners)


def _bounds(submap: Submap) -> NDArray[np.float64]:
    ends = [bounds_of_keys(keys) for keys in (submap.observed_space.free, submap.observed_space.structure) if len(keys)]
    if not ends:
        return np.array([np.full(3, np.inf), np.full(3, -np.inf)])
    low = np.min([low for low, _ in ends], axis=0) - 1
    high = np.max([high for _, high in ends], axis=0) + 2
    corners = np.where(list(np.ndindex(2, 2, 2)), high, low) * submap.observed_space.voxel_m
    world = apply(submap.world_from_submap, corners)
    return np.array([world.min(axis=0) - _ROUNDING_M, world.max(axis=0) + _ROUNDING_M])


def clear_points(own: SeenPlaces, i: int, near_m: float) -> NDArray[np.float64]:
    """Return (N, 3) points of object i that are near no other object and no structure of its own map."""
    points = thinned(own.objects[i].points_world, _POINTS_OF_EVIDENCE).astype(np.float64)
    is_clear = ~_on_structure(own, points) & ~_on_objects(own, points, near_m, apart_from=i)
    return points[is_clear]


def evidence_at(other: SeenPlaces, points: NDArray[np.float64], near_m: float) -> Evidence:
    """Return the observations of a map at (N, 3) points in its world; too few points are no evidence."""
    if len(points) < _MIN_CLEAR:
        return Evidence(free=0.0, structure=0.0, objects=0.0, unseen=0.0, num_clear=len(points))
    on_object = _on_objects(other, points, near_m)
    on_structure = _on_structure(other, points) & ~on_object
    is_free = _in_free_space(other, points) & ~on_object & ~on_structure
    free, structure, objects = (float(mask.mean()) for mask in (is_free, on_structure, on_object))
    unseen = float((~(is_free | on_structure | on_object)).mean())
    return Evidence(free=free, structure=structure, objects=objects, unseen=unseen, num_clear=len(points))


def not_in_free_space(places: SeenPlaces, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (N, 3) points at which a map saw no free space; even an object's own voxels may be free."""
    return points[~_in_free_space(places, points)]


def _on_objects(
    places: SeenPlaces, points: NDArray[np.float64], near_m: float, apart_from: int = -1
) -> NDArray[np.bool_]:
    if places.tree is None or not len(points):
        return np.zeros(len(points), dtype=bool)
    num_near = places.tree.query_ball_point(points, near_m, return_length=True)
    if apart_from >= 0:
        first, last = np.searchsorted(places.owners, [apart_from, apart_from + 1])
        own = cKDTree(places.tree.data[first:last])
        num_near = num_near - own.query_ball_point(points, near_m, return_length=True)
    return np.asarray(num_near > 0)


def _on_structure(places: SeenPlaces, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    found = np.zeros(len(points), dtype=bool)
    for submap, inside in _around(places, points):
        left = inside[~found[inside]]
        found[left] = are_near(submap.observed_space.structure, keys_of_cells(_cells(points[left], submap)))
    return found


def _in_free_space(places: SeenPlaces, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    found = np.zeros(len(points), dtype=bool)
    for submap, inside in _around(places, points):
        found[inside] |= contains(submap.observed_space.free, keys_of_cells(_cells(points[inside], submap)))
    return found


def _around(places: SeenPlaces, points: NDArray[np.float64]) -> Iterator[tuple[Submap, NDArray[np.int64]]]:
    # Submaps near (N, 3) points, each with the indices of these points.
    if not len(points):
        return
    low, high = points.min(axis=0), points.max(axis=0)
    meets = (places.bounds[:, 0] <= high).all(axis=1) & (places.bounds[:, 1] >= low).all(axis=1)
    for s in np.flatnonzero(meets):
        is_inside = ((points >= places.bounds[s, 0]) & (points <= places.bounds[s, 1])).all(axis=1)
        yield places.submaps[s], np.flatnonzero(is_inside)


def _cells(points: NDArray[np.float64], submap: Submap) -> NDArray[np.int64]:
    local = apply(invert(submap.world_from_submap), points)
    return np.floor(local / submap.observed_space.voxel_m).astype(np.int64)
