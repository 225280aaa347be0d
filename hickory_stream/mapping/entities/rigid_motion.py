"""Rigid motion of an object: points, box, views, mesh and superquadrics are transformed, nothing is recomputed."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.geometry.rigid import apply, compose
from hickory_stream.geometry.superquadric import moved
from hickory_stream.records import ObjectShape, TrackedObject, View


def moved_object(
    item: TrackedObject, new_from_old: NDArray[np.float64], before: tuple[TrackedObject, TrackedObject] | None = None
) -> TrackedObject:
    """Return an object with all its data in another world frame; `new_from_old` (4, 4) is rigid.

    `before`: an earlier record of it and its motion to the same frame, whose views and shape stay where they are equal.
    """
    known = {} if before is None else {id(a): b for a, b in zip(*map(_parts_of, before), strict=True)}
    views = tuple(known.get(id(view)) or moved_view(view, new_from_old) for view in item.views)
    best = None if item.best_view is None else views[[v.name for v in item.views].index(item.best_view.name)]
    return replace(
        item,
        points_world=apply(new_from_old, item.points_world),
        box=moved_box(item.box, new_from_old),
        views=views,
        best_view=best,
        shape=None if item.shape is None else known.get(id(item.shape)) or moved_shape(item.shape, new_from_old),
        sketch=None if item.sketch is None else moved(item.sketch, new_from_old),
    )


def _parts_of(item: TrackedObject) -> tuple[Any, ...]:
    return (*item.views, item.shape)


def moved_box(box: OrientedBox, new_from_old: NDArray[np.float64]) -> OrientedBox:
    """Return a box in another world frame; `new_from_old` (4, 4) is rigid."""
    return OrientedBox(world_from_box=compose(new_from_old, box.world_from_box), half_extents_m=box.half_extents_m)


def moved_view(view: View, new_from_old: NDArray[np.float64]) -> View:
    """Return a view with its camera in another world frame; `new_from_old` (4, 4) is rigid."""
    return replace(view, world_from_camera=compose(new_from_old, view.world_from_camera))


def moved_shape(shape: ObjectShape, new_from_old: NDArray[np.float64]) -> ObjectShape:
    """Return layers 2 to 4 of an object in another world frame; `new_from_old` (4, 4) is rigid."""
    return replace(
        shape,
        world_from_object=compose(new_from_old, shape.world_from_object),
        fitted=moved(shape.fitted, new_from_old),
        inflated=moved(shape.inflated, new_from_old),
    )
