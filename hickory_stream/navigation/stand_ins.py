"""Early obstacles of a live run: stand-ins for objects without a layer 4, and observed surface of no object.

A stand-in contains all points of a track from its first keyframe on: its sketch, or a few horizontal slabs of its box,
by least volume. Slabs are not divided vertically, so that the inside of a half-seen object stays occupied.
"""

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.geometry.superquadric import (
    MIN_EXPONENT,
    Superquadrics,
    implicit_value,
    joined,
    log_implicit_value,
    sorted_by_volume,
    volumes_m3,
    world_bounds,
)
from hickory_stream.geometry.voxels import (
    are_near,
    centers_of_keys,
    contains,
    difference,
    dilate,
    keys_of_points,
    sorted_unique,
    union,
)
from hickory_stream.navigation.observed import NO_HULLS, Band, above_floor, box_corners, rectangles
from hickory_stream.records import MapSnapshot, SpaceObservation, TrackedObject

MARGIN_M = 0.02
SEEN_SURFACE = -1
"""The id used for surface that belongs to no object yet."""

_MOST_SLABS, _CUTS = 4, 15
_LEAST_SAVED = 0.1
_THINNEST_M = 0.001
_SAMPLED = 64
_GONE = 2
"""The number of keyframes with free space or structure at a voxel after which it is no longer surface."""


@dataclass(frozen=True, kw_only=True)
class Obstacle:
    """The space that an object occupies; `is_observed_only`: it is a stand-in, in the absence of a layer 4."""

    id: int
    body: Superquadrics
    is_observed_only: bool

    @cached_property
    def bounds(self) -> NDArray[np.float64]:
        """The (N, 2, 3) bounds of the primitives in the world."""
        return world_bounds(self.body)


def early_obstacles(objects: Sequence[TrackedObject]) -> list[Obstacle]:
    """Return the obstacles of all objects, also of objects that were seen only once."""
    return _MADE.of(objects)


class _Made:
    # Several sinks ask for the same objects, and most objects do not change. Their threads wait for one another.
    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._last: Mapping[int, tuple[TrackedObject, Obstacle]] = {}

    def of(self, objects: Sequence[TrackedObject]) -> list[Obstacle]:
        """Return the obstacles of objects."""
        with self._lock:
            found: dict[int, tuple[TrackedObject, Obstacle]] = {}
            for tracked in objects:
                before = self._last.get(tracked.id)
                is_same = before is not None and before[0] is tracked
                found[tracked.id] = before if before is not None and is_same else (tracked, _obstacle_of(tracked))
            self._last = found
        return [obstacle for _, obstacle in found.values()]


_MADE = _Made()


def _obstacle_of(tracked: TrackedObject) -> Obstacle:
    if tracked.shape is None or len(tracked.shape.inflated) == 0:
        return Obstacle(id=tracked.id, body=stand_in_of(tracked), is_observed_only=True)
    return Obstacle(id=tracked.id, body=tracked.shape.inflated, is_observed_only=False)


def stand_in_of(tracked: TrackedObject) -> Superquadrics:
    """Return superquadrics that contain all points of an object and a margin: its slabs or its sketch, by least volume.

    The sketch keeps the margin along its axes, slabs keep it everywhere.
    """
    points = tracked.points_world.astype(np.float64)
    slabs = _slabs(_around(tracked.box, points), points, MARGIN_M)
    boxed = sorted_by_volume(joined([box_as_superquadric(slab, MARGIN_M) for slab in slabs]))
    if tracked.sketch is None or len(tracked.sketch) != 1:
        return boxed
    sketched = _grown(tracked.sketch, points, MARGIN_M)
    return sketched if volumes_m3(sketched).sum() < volumes_m3(boxed).sum() else boxed


def box_as_superquadric(box: OrientedBox, margin_m: float) -> Superquadrics:
    """Return the superquadric with the sharpest edges that contains a box and a margin around it."""
    # At a corner of the box, G would be 3 otherwise: 1 for each axis.
    axes = (box.half_extents_m + margin_m) * 3 ** (MIN_EXPONENT / 2) * (1 + 1e-9)
    return Superquadrics(
        exponents=np.full((1, 2), MIN_EXPONENT), semi_axes_m=axes[None], world_from_local=box.world_from_box[None]
    )


def _around(box: OrientedBox, points: NDArray[np.float64]) -> OrientedBox:
    if len(points) == 0:
        return box
    (low,), (high,) = _extents(apply(invert(box.world_from_box), points), np.empty(0))
    return _box_of(box, np.minimum(low, -box.half_extents_m), np.maximum(high, box.half_extents_m))


def _slabs(box: OrientedBox, points: NDArray[np.float64], margin_m: float) -> list[OrientedBox]:
    local = apply(invert(box.world_from_box), points)
    parts = [_Part.of(local, margin_m)] if len(local) else []
    for _ in range(_MOST_SLABS - 1):
        least_m3 = _LEAST_SAVED * sum(part.volume_m3 for part in parts)
        saves_m3, n = max(((part.saves_m3, -n) for n, part in enumerate(parts)), default=(0.0, 0))
        if saves_m3 <= least_m3:
            break
        part = parts[-n]
        is_low = part.local[:, 2] <= part.cut_m
        parts[-n : 1 - n or None] = [_Part.of(part.local[side], margin_m) for side in (is_low, ~is_low)]
    return [box] if len(parts) < 2 else [_box_of(box, part.low, part.high) for part in parts]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Part:
    # Points (N, 3) in the frame of a box, their extents, the volume around them, and the cut of least volume.
    local: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    volume_m3: float
    cut_m: float
    saves_m3: float

    @classmethod
    def of(cls, local: NDArray[np.float64], margin_m: float) -> "_Part":
        heights = local[:, 2]
        cuts = np.linspace(heights.min(), heights.max(), _CUTS + 2)[1:-1]
        low, high = _extents(local, cuts)
        filled = np.flatnonzero(low[:, 0] <= high[:, 0])
        low, high = low[filled], high[filled]
        # Of the layers below and above each border between two that have points.
        below = np.maximum.accumulate(high)[:-1] - np.minimum.accumulate(low)[:-1]
        above = (np.maximum.accumulate(high[::-1]) - np.minimum.accumulate(low[::-1]))[:-1][::-1]
        lowest, highest = low.min(axis=0), high.max(axis=0)
        volume_m3 = float((highest - lowest + 2 * margin_m).prod())
        saves_m3 = volume_m3 - sum((sides + 2 * margin_m).prod(axis=1) for sides in (below, above))
        best = int(np.argmax(saves_m3)) if len(saves_m3) else -1
        return cls(
            local=local,
            low=lowest,
            high=highest,
            volume_m3=volume_m3,
            cut_m=float(cuts[filled[best]]) if best >= 0 else np.inf,
            saves_m3=float(saves_m3[best]) if best >= 0 else 0.0,
        )


@kernel
def _extents(local, cuts):
    # Lowest and highest corners (C + 1, 3) of the points (N, 3) between cuts (C,) of their heights.
    low, high = np.full((len(cuts) + 1, 3), np.inf), np.full((len(cuts) + 1, 3), -np.inf)
    for i in range(len(local)):
        layer = 0
        while layer < len(cuts) and cuts[layer] < local[i, 2]:
            layer += 1
        for k in range(3):
            low[layer, k] = min(low[layer, k], local[i, k])
            high[layer, k] = max(high[layer, k], local[i, k])
    return low, high


def _box_of(box: OrientedBox, low: NDArray[np.float64], high: NDArray[np.float64]) -> OrientedBox:
    pose = box.world_from_box.copy()
    pose[:3, 3] = apply(box.world_from_box, (low + high)[None] / 2)[0]
    return OrientedBox(world_from_box=pose, half_extents_m=np.maximum((high - low) / 2, _THINNEST_M))


def _grown(sketch: Superquadrics, points: NDArray[np.float64], margin_m: float) -> Superquadrics:
    # Enlarged by the margin along its axes, and by a common factor if points are still outside.
    exponent = float(sketch.exponents[0, 0])
    local = np.abs(apply(invert(sketch.world_from_local[0]), points))
    larger = replace(sketch, semi_axes_m=sketch.semi_axes_m + margin_m, world_from_local=np.eye(4)[None])
    most = float(log_implicit_value(larger, 0, larger.semi_axes_m)[0])
    reach = np.maximum.reduce([(local[:, k] + margin_m) / larger.semi_axes_m[0, k] for k in range(3)])
    log_g, some = 0.0, local[::_SAMPLED]
    for _ in range(2):
        held = np.concatenate([some + margin_m * axis for axis in np.eye(3)])
        log_g = float(log_implicit_value(larger, 0, held).max(initial=log_g))
        # G of a point is at most that of the corner of the box through it: most are not worth the logarithms.
        some = local[reach >= np.exp((log_g - most) * exponent / 2) * (1 - 1e-9)]
    axes = larger.semi_axes_m * np.exp(log_g * exponent / 2) * (1 + 1e-9)
    return replace(sketch, semi_axes_m=axes)


class SeenSurface:
    """The voxels in which keyframes have seen surface other than structure, submap by submap."""

    def __init__(self) -> None:
        self._seen: dict[int, tuple[NDArray[np.int64], NDArray[np.uint8]]] = {}
        self._voxel_m = 0.0
        self._lock = threading.Lock()
        self._last: tuple[tuple[object, ...], NDArray[np.float64]] | None = None

    def add(self, seen: SpaceObservation, snapshot: MapSnapshot) -> None:
        """Add the surface seen by a keyframe; `snapshot` is the map after it."""
        if snapshot.submaps:
            submap = snapshot.submaps[-1]
            self.add_to(submap.id, seen, submap.observed_space.voxel_m)

    def add_to(self, open_id: int, seen: SpaceObservation, voxel_m: float) -> None:
        """Add the surface seen by a keyframe while this submap was open."""
        self._last = None
        if voxel_m != self._voxel_m:
            self._seen, self._voxel_m = {}, voxel_m
        self._seen.setdefault(open_id, (np.empty(0, np.int64), np.empty(0, np.uint8)))
        against = union(seen.free_keys, seen.structure_keys)
        new = seen.surface_keys
        # All keys are in the odometry's world: a later submap may see free space at the surface of an earlier one.
        for submap_id, (keys, misses) in self._seen.items():
            is_seen = contains(seen.surface_keys, keys)
            counted = np.where(is_seen, 0, misses + contains(against, keys))
            stays = counted < _GONE
            self._seen[submap_id] = (keys[stays], counted[stays].astype(np.uint8))
            new = difference(new, keys)
        keys, misses = self._seen[open_id]
        merged = union(keys, new)
        counts = np.zeros(len(merged), np.uint8)
        counts[np.searchsorted(merged, keys)] = misses
        self._seen[open_id] = (merged, counts)

    def keys(self) -> NDArray[np.int64]:
        """Return the sorted keys of all voxels, in the odometry's world."""
        return sorted_unique(np.concatenate([np.empty(0, np.int64), *(keys for keys, _ in self._seen.values())]))

    def hulls(
        self, snapshot: MapSnapshot, obstacles: Sequence[Obstacle], band: Band, floor_z_m: float
    ) -> NDArray[np.float64]:
        """Return corners (N, 8, 3), in the world, of boxes around surface in the band that belongs to no object."""
        asked = (snapshot, band.low_m, band.high_m, floor_z_m)
        with self._lock:
            if self._last is None or self._last[0] != asked:
                self._last = asked, self._hulls(snapshot, obstacles, band, floor_z_m)
            return self._last[1]

    def _hulls(
        self, snapshot: MapSnapshot, obstacles: Sequence[Obstacle], band: Band, floor_z_m: float
    ) -> NDArray[np.float64]:
        found = [NO_HULLS]
        for submap in snapshot.submaps:
            if submap.id not in self._seen:
                continue
            keys, _ = self._seen[submap.id]
            keys = difference(keys, submap.observed_space.structure)
            keys = _of_no_object(keys, self._voxel_m, submap.world_from_submap, snapshot.objects, obstacles)
            cells = above_floor(keys, self._voxel_m, submap.world_from_submap, band, floor_z_m)
            corners = _layered_boxes(cells) * self._voxel_m
            if len(corners):
                hulls = box_corners(corners).reshape(-1, 3)
                found.append(np.asarray(apply(submap.world_from_submap, hulls).reshape(-1, 8, 3)))
        return np.concatenate(found)


def _of_no_object(
    keys: NDArray[np.int64],
    voxel_m: float,
    world_from_submap: NDArray[np.float64],
    objects: Sequence[TrackedObject],
    obstacles: Sequence[Obstacle],
) -> NDArray[np.int64]:
    # Surface next to the points of an object with layer 4 is noise at its edges.
    submap_from_world = invert(world_from_submap)
    centers = apply(world_from_submap, centers_of_keys(keys, voxel_m).astype(np.float64))
    is_free = np.ones(len(keys), bool)
    for tracked, obstacle in zip(objects, obstacles, strict=True):
        own = keys_of_points(apply(submap_from_world, tracked.points_world), voxel_m)
        if obstacle.is_observed_only:
            own = sorted_unique(own[contains(keys, own)])
        else:
            own = dilate(sorted_unique(own[are_near(keys, own)]))
        is_free &= ~contains(own, keys)
        for i, (low, high) in enumerate(obstacle.bounds):
            near = np.flatnonzero(is_free & ((centers > low) & (centers < high)).all(axis=1))
            if len(near):
                is_free[near] &= implicit_value(obstacle.body, i, centers[near]) > 1.0
    return keys[is_free]


def _layered_boxes(cells: NDArray[np.int64]) -> NDArray[np.float64]:
    # (M, 6) low and high corners, in voxels, of boxes whose union is (N, 3) cells, layer by layer.
    boxes: list[tuple[float, ...]] = []
    for z in np.unique(cells[:, 2]).tolist():
        flat = cells[cells[:, 2] == z, :2]
        first = flat.min(axis=0)
        mask = np.zeros(np.ptp(flat, axis=0) + 1, bool)
        mask[tuple((flat - first).T)] = True
        x, y = first.tolist()
        boxes += [(x0 + x, y0 + y, z, x1 + x, y1 + y, z + 1) for x0, y0, x1, y1 in rectangles(mask)]
    return np.array(boxes, dtype=np.float64).reshape(-1, 6)
