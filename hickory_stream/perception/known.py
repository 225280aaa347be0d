"""Pieces of a thing that the map knows: what something nearer divides in the image is one mask again.

A chair shows its back above a table and its seat below it, a plant shows leaves whose stems are too thin to be seen.
Pieces that touch each other and were told apart stay apart, whatever the map says: the map must be able to learn that
it took two things for one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.geometry.voxels import contains, keys_of_cells
from hickory_stream.ranges import Ranged, number
from hickory_stream.records import Phase

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hickory_stream.records import Frame, Segmentation, TrackedObject


@dataclass(frozen=True, kw_only=True, slots=True)
class KnownConfig(Ranged):
    """When two masks are pieces of one known object.

    Attributes:
        enabled: off by default: masks get better by it, but the boxes of maps do not.
        min_sightings: an object is known after so many.
        voxel_m: a pixel lies on an object if its point falls into a cell of its points, or a cell beside one.
        min_share: least share of a mask's pixels that must lie on the object.
        samples: pixels of a mask that are looked up.
        stride_px: masks touch where pixels so far apart are of one surface.
    """

    enabled: bool = False
    min_sightings: int = number(4, 1, 1_000_000, "sightings")
    voxel_m: float = number(0.04, 0.001, 1, "m")
    min_share: float = number(0.6, 0, 1, "share")
    samples: int = number(120, 1, 1_000_000, "px")
    stride_px: int = number(4, 1, 1000, "px")


def with_known(
    frame: Frame, segmentation: Segmentation, known: Sequence[TrackedObject], config: KnownConfig
) -> Segmentation:
    """Return the segmentation with pieces of known objects joined; labels stay dense, in the order of first pieces."""
    instances = segmentation.instances
    count = int(instances.max(initial=0)) + 1
    settled = [o for o in known if o.phase is not Phase.TENTATIVE and o.sightings >= config.min_sightings]
    if not config.enabled or count <= 2 or not settled:
        return segmentation
    stride = config.stride_px
    labels, depth = instances[::stride, ::stride], frame.depth_m[::stride, ::stride]
    names, points = _samples(frame, labels, depth, count, config)
    owner = _owners(names, points, count, [o for o in settled if _in_view(frame, o)], config)
    target = np.arange(count, dtype=np.int32)
    touching = _touching(labels, depth, count)
    size = np.bincount(labels.ravel(), minlength=count)
    for track in np.unique(owner[owner >= 0]):
        pieces = np.flatnonzero(owner == track)
        largest = pieces[np.argmax(size[pieces])]
        free = pieces[~touching[np.ix_(pieces, pieces)].any(axis=1)]
        joined = np.union1d(free, [largest])
        target[joined] = joined.min()
    if (target == np.arange(count)).all():
        return segmentation
    _, dense = np.unique(target, return_inverse=True)
    return replace(segmentation, instances=dense.astype(np.int32)[instances])


def _samples(
    frame: Frame, labels: NDArray[np.int32], depth: NDArray[np.float32], count: int, config: KnownConfig
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Return labels (N,) and points in the world (N, 3) of about `samples` pixels with depth of every label."""
    used = np.flatnonzero((labels > 0) & np.isfinite(depth))
    used = used[np.argsort(labels.ravel()[used], kind="stable")]
    names = labels.ravel()[used].astype(np.int64)
    pixels = np.bincount(names, minlength=count)
    place = np.arange(len(used)) - (np.cumsum(pixels) - pixels)[names]
    chosen = place % np.maximum(pixels // config.samples, 1)[names] == 0
    names, used = names[chosen], used[chosen]
    v, u = np.divmod(used, labels.shape[1])
    z = depth.ravel()[used].astype(np.float64)
    camera, stride = frame.camera, config.stride_px
    at = np.stack([(u * stride - camera.cx) / camera.fx * z, (v * stride - camera.cy) / camera.fy * z, z], axis=1)
    return names, apply(frame.world_from_camera, at).astype(np.float32)


def _owners(
    names: NDArray[np.int64],
    points: NDArray[np.float32],
    count: int,
    objects: Sequence[TrackedObject],
    config: KnownConfig,
) -> NDArray[np.int64]:
    """Return (count,) which object each label lies on most, by its place in the list; -1 where on none enough."""
    best, owner = np.full(count, config.min_share), np.full(count, -1)
    total = np.maximum(np.bincount(names, minlength=count), 1)
    keys = keys_of_cells(np.floor(points / config.voxel_m).astype(np.int64))
    for i, tracked in enumerate(objects):
        on_it = contains(_cells_of(tracked.points_world, config.voxel_m), keys)
        share = np.bincount(names[on_it], minlength=count) / total
        better = share > best
        best[better], owner[better] = share[better], i
    return owner


def _cells_of(points: NDArray[np.float32], voxel_m: float) -> NDArray[np.int64]:
    """Return the sorted keys of the cells with points, and of the six beside each."""
    cells = np.unique(np.floor(points / voxel_m).astype(np.int64), axis=0)
    steps = np.concatenate([np.zeros((1, 3), dtype=np.int64), np.eye(3, dtype=np.int64), -np.eye(3, dtype=np.int64)])
    return np.unique(keys_of_cells((cells[:, None] + steps[None]).reshape(-1, 3)))


def _in_view(frame: Frame, tracked: TrackedObject) -> bool:
    """Return whether the corners of an object's box are neither all behind the camera nor all off one side."""
    x, y, z = apply(invert(frame.world_from_camera), tracked.box.corners_world()).T
    camera = frame.camera
    left, right = camera.cx / camera.fx, (camera.width - camera.cx) / camera.fx
    top, bottom = camera.cy / camera.fy, (camera.height - camera.cy) / camera.fy
    outside = (z <= 0, x < -left * z, x > right * z, y < -top * z, y > bottom * z)
    return not any(bool(side.all()) for side in outside)


def _touching(labels: NDArray[np.int32], depth: NDArray[np.float32], count: int) -> NDArray[np.bool_]:
    """Return (count, count) which labels meet in the image without a step of depth, in two places or more."""
    met = np.zeros((count, count), dtype=np.int64)
    for here, there in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        a, b = labels[here], labels[there]
        meets = (a != b) & (a > 0) & (b > 0) & (np.abs(depth[here] - depth[there]) < 0.02 + 0.015 * depth[here])
        met += np.bincount(a[meets].astype(np.int64) * count + b[meets], minlength=count * count).reshape(met.shape)
    met += met.T
    return met >= 2
