"""The input of alignment: the objects of a map as arrays, in one frame; data that a map lacks are never filled in."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.boxes import OrientedBox, gravity_aligned_box
from hickory_stream.geometry.superquadric import Superquadrics, centroid_world, support_reach
from hickory_stream.records import MapSnapshot, Phase, Submap, TrackedObject

_MIN_HALF_EXTENT_M = 0.005


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ObjectMap:
    """N objects in one frame, z up, metres; None where an object or the map lacks the data."""

    ids: NDArray[np.int64]
    #: (N, 3) of layer 3 in closed form, else of layer 1
    centroids: NDArray[np.float64]
    #: (N, D) of unit norm, NaN for objects without
    features: NDArray[np.float32] | None
    #: layer 3, or the sketch fitted to the points
    shapes: tuple[Superquadrics | None, ...]
    #: upright
    boxes: tuple[OrientedBox, ...]
    #: layer 1
    points: tuple[NDArray[np.float32] | None, ...]
    submap_ids: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    #: with the observed space
    submaps: tuple[Submap, ...] = ()
    #: of the features, "" if unknown
    extractor: str = ""
    #: (N,) probabilities of a fixture, which stays; 0 if unknown
    fixed: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        freeze(self, "ids", np.int64, (None,))
        count = len(self.ids)
        freeze(self, "centroids", np.float64, (count, 3))
        if self.features is not None:
            freeze(self, "features", np.float32, (count, None))
        if not len(self.submap_ids):
            object.__setattr__(self, "submap_ids", np.zeros(count, dtype=np.int64))
        freeze(self, "submap_ids", np.int64, (count,))
        if not len(self.fixed):
            object.__setattr__(self, "fixed", np.zeros(count))
        freeze(self, "fixed", np.float64, (count,))
        for name in ("shapes", "boxes", "points"):
            if len(getattr(self, name)) != count:
                raise ValueError(f"{name} has {len(getattr(self, name))} entries for {count} objects")

    def __len__(self) -> int:
        return len(self.ids)


def object_map(snapshot: MapSnapshot, extractor: str = "") -> ObjectMap:
    """Return the objects of a snapshot in its world, without tentative ones; features compare by `extractor`."""
    objects = [tracked for tracked in snapshot.objects if tracked.phase != Phase.TENTATIVE]
    shapes = tuple(tracked.superquadrics for tracked in objects)
    points = tuple(tracked.points_world if len(tracked.points_world) else None for tracked in objects)
    boxes = tuple(tracked.box for tracked in objects)
    centroids = [_centroid(*parts) for parts in zip(shapes, points, boxes, strict=True)]
    return ObjectMap(
        ids=np.array([tracked.id for tracked in objects], dtype=np.int64),
        centroids=np.array(centroids).reshape(-1, 3),
        features=_features(objects),
        shapes=shapes,
        boxes=boxes,
        points=points,
        submap_ids=np.array([tracked.submap_id for tracked in objects], dtype=np.int64),
        submaps=snapshot.submaps,
        extractor=extractor,
        fixed=np.array([tracked.fixture_probability for tracked in objects]),
    )


def taken(objects: ObjectMap, indices: NDArray[np.int64]) -> ObjectMap:
    """Return the map of the objects at `indices`, in that order; its observed space is the whole map's."""
    return replace(
        objects,
        ids=objects.ids[indices],
        centroids=objects.centroids[indices],
        features=None if objects.features is None else objects.features[indices],
        shapes=tuple(objects.shapes[i] for i in indices),
        boxes=tuple(objects.boxes[i] for i in indices),
        points=tuple(objects.points[i] for i in indices),
        submap_ids=objects.submap_ids[indices],
        fixed=objects.fixed[indices],
    )


def shape_box(shape: Superquadrics) -> OrientedBox:
    """Return the upright box of minimum footprint around superquadrics, from their support in 24 level directions."""
    angles = np.arange(24) * (2 * np.pi / 24)
    directions = np.concatenate(
        [np.stack([np.cos(angles), np.sin(angles), np.zeros(24)], axis=1), [[0, 0, 1], [0, 0, -1]]]
    )
    centers = shape.world_from_local[:, :3, 3]
    reach = support_reach(shape, directions)
    outline = (centers[:, None, :2] + directions[None, :24, :2] * reach[:, :24, None]).reshape(-1, 2)
    top, bottom = (centers[:, 2] + reach[:, 24]).max(), (centers[:, 2] - reach[:, 25]).min()
    corners = np.concatenate([np.column_stack([outline, np.full(len(outline), z)]) for z in (bottom, top)])
    return gravity_aligned_box(corners, _MIN_HALF_EXTENT_M)


def _centroid(shape: Superquadrics | None, points: NDArray[np.float32] | None, box: OrientedBox) -> NDArray[np.float64]:
    if shape is not None:
        return centroid_world(shape)
    return box.center if points is None else points.mean(axis=0, dtype=np.float64)


def _features(objects: list[TrackedObject]) -> NDArray[np.float32] | None:
    found = [tracked.feature for tracked in objects if tracked.feature is not None]
    if not found:
        return None
    rows = np.full((len(objects), len(found[0])), np.nan, dtype=np.float32)
    for row, tracked in zip(rows, objects, strict=True):
        if tracked.feature is not None and len(tracked.feature) == len(row):
            row[:] = tracked.feature
    return rows
