"""Fusion of one object from several maps: points, views, features; and its shape where that still contains it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.superquadric import log_implicit_value
from hickory_stream.mapping.entities.cloud import cloud_of, fuse
from hickory_stream.mapping.entities.rigid_motion import moved_object
from hickory_stream.records import ObjectKind, TrackedObject, View

_VOXEL_M = 0.01
_NEW_M, _SAMPLE = 0.02, 2000


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MergedObject:
    """An object of the merged map; `needs_shape`: other maps add so much surface that its shape must be made again."""

    item: TrackedObject
    needs_shape: bool


def placed(
    item: TrackedObject, world_from_map: NDArray[np.float64], *, new_id: int, submap_id: int, first_frame: int
) -> TrackedObject:
    """Return an object in the merged world, under its new id; frames from `first_frame` on keep view names apart."""
    there = moved_object(item, world_from_map)
    views = tuple(replace(view, object_id=new_id, frame_index=view.frame_index + first_frame) for view in there.views)
    best = None if item.best_view is None else views[[v.name for v in item.views].index(item.best_view.name)]
    return replace(there, id=new_id, submap_id=submap_id, views=views, best_view=best)


def united(items: Sequence[TrackedObject], *, max_views: int, changed_share: float) -> MergedObject:
    """Return one object of several in the merged world; its id, phase and submap are the first one's.

    Args:
        items: at least one; a single one is returned unchanged.
        max_views: the views that are kept, the best by score, then by coverage of the object.
        changed_share: of new surface, or of points outside of layer 4, beyond which the shape is made again.
    """
    first = items[0]
    if len(items) == 1:
        return MergedObject(item=first, needs_shape=False)
    points, colors = _fused(items)
    left_out = {item.id: _share_outside(item, points) for item in items}
    keeper = min(items, key=lambda item: (left_out[item.id], -len(item.points_world)))
    views = tuple(sorted(_best_views(items, max_views), key=lambda view: view.name))
    scored = [view for view in views if view.score is not None]
    shape = keeper.shape
    fixed = float(np.average([item.fixture_probability for item in items], weights=[item.sightings for item in items]))
    item = replace(
        first,
        sightings=sum(item.sightings for item in items),
        first_seen_ns=min(item.first_seen_ns for item in items),
        last_seen_ns=max(item.last_seen_ns for item in items),
        points_world=points,
        colors=colors,
        box=gravity_aligned_box(points, _VOXEL_M / 2) if len(points) else first.box,
        feature=_mean_feature(items),
        views=tuple(replace(view, object_id=first.id) for view in views),
        best_view=replace(max(scored, key=lambda view: view.score or 0.0), object_id=first.id) if scored else None,
        shape=shape,
        sketch=keeper.sketch,
        kind=ObjectKind.of(fixed),
        fixture_probability=fixed,
    )
    # Without views there is nothing to make a shape of but what made none before.
    changed = max(left_out[keeper.id], _new_share(keeper.points_world, points))
    needs_shape = bool(views) and changed > changed_share
    return MergedObject(item=item, needs_shape=needs_shape)


def _fused(items: Sequence[TrackedObject]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    cloud = cloud_of(items[0].points_world, items[0].colors, _VOXEL_M)
    for item in items[1:]:
        cloud = fuse(cloud, cloud_of(item.points_world, item.colors, _VOXEL_M))
    return cloud.points, np.clip(np.rint(cloud.colors), 0, 255).astype(np.uint8)


def _best_views(items: Sequence[TrackedObject], most: int) -> list[View]:
    # The best view of each map, then the others of all maps in turn, best score first.
    ranked = [sorted(item.views, key=lambda view: (-(view.score or 0.0), view.name)) for item in items]
    longest = max((len(views) for views in ranked), default=0)
    turns = [views[turn] for turn in range(longest) for views in ranked if turn < len(views)]
    return turns[:most]


def _mean_feature(items: Sequence[TrackedObject]) -> NDArray[np.float32] | None:
    # Every map weighs as its views; of unit norm.
    known = [(item.feature, max(len(item.views), 1)) for item in items if item.feature is not None]
    if not known:
        return None
    if len({len(feature) for feature, _ in known}) > 1:
        return known[0][0]
    total = np.sum([weight * feature.astype(np.float64) for feature, weight in known], axis=0)
    return (total / max(float(np.linalg.norm(total)), 1e-12)).astype(np.float32)


def _share_outside(item: TrackedObject, points: NDArray[np.float32]) -> float:
    if item.shape is None or not len(points):
        return 1.0
    some = points[:: max(1, len(points) // _SAMPLE)].astype(np.float64)
    inflated = item.shape.inflated
    values = np.array([log_implicit_value(inflated, i, some) for i in range(len(inflated))])
    return float((values > 0).all(axis=0).mean())


def _new_share(old: NDArray[np.float32], points: NDArray[np.float32]) -> float:
    if not len(old) or not len(points):
        return 1.0 if len(points) else 0.0
    distances, _ = cKDTree(old.astype(np.float64)).query(points[::4].astype(np.float64))
    return float((distances > _NEW_M).mean())
