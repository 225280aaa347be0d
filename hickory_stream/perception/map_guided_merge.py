"""Map-guided merging of masks: masks that lie on one mapped object and are separated by an occluder become one.

A chair is visible above and below a table top; a plant's leaves are visible, its stems are too thin for the sensor.
Masks that touch stay separate whatever the map says, so that the map can correct an object that is two.
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
class MapGuidedMergeConfig(Ranged):
    """When two masks show one mapped object.

    Attributes:
        enabled: off by default: masks improve, but the boxes of maps do not.
        min_sightings: only objects with so many sightings are used.
        voxel_m: a pixel lies on an object if its point falls into a voxel of the object's points, or next to one.
        min_share: minimum share of a mask's pixels on the object.
        samples: number of pixels sampled per mask.
        stride_px: stride of the pixel grid on which samples are taken and masks are tested for contact.
    """

    enabled: bool = False
    min_sightings: int = number(4, 1, 1_000_000, "sightings")
    voxel_m: float = number(0.04, 0.001, 1, "m")
    min_share: float = number(0.6, 0, 1, "share")
    samples: int = number(120, 1, 1_000_000, "px")
    stride_px: int = number(4, 1, 1000, "px")


def merged_by_map(
    frame: Frame, segmentation: Segmentation, mapped: Sequence[TrackedObject], config: MapGuidedMergeConfig
) -> Segmentation:
    """Return the segmentation with masks of one mapped object merged; labels stay dense, in their order."""
    instances = segmentation.instances
    count = int(instances.max(initial=0)) + 1
    settled = [o for o in mapped if o.phase is not Phase.TENTATIVE and o.sightings >= config.min_sightings]
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
    frame: Frame, labels: NDArray[np.int32], depth: NDArray[np.float32], count: int, config: MapGuidedMergeConfig
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
    config: MapGuidedMergeConfig,
) -> NDArray[np.int64]:
    """Return (count,) the index of the object on which most of each label lies; -1 if less than `min_share` does."""
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
    """Return the sorted keys of the voxels with points and of the six face neighbours of each."""
    cells = np.unique(np.floor(points / voxel_m).astype(np.int64), axis=0)
    steps = np.concatenate([np.zeros((1, 3), dtype=np.int64), np.eye(3, dtype=np.int64), -np.eye(3, dtype=np.int64)])
    return np.unique(keys_of_cells((cells[:, None] + steps[None]).reshape(-1, 3)))


def _in_view(frame: Frame, tracked: TrackedObject) -> bool:
    """Return whether an object's box may be in the view frustum: its corners are not all outside one of its planes."""
    x, y, z = apply(invert(frame.world_from_camera), tracked.box.corners_world()).T
    camera = frame.camera
    left, right = camera.cx / camera.fx, (camera.width - camera.cx) / camera.fx
    top, bottom = camera.cy / camera.fy, (camera.height - camera.cy) / camera.fy
    outside = (z <= 0, x < -left * z, x > right * z, y < -top * z, y > bottom * z)
    return not any(bool(side.all()) for side in outside)


def _touching(labels: NDArray[np.int32], depth: NDArray[np.float32], count: int) -> NDArray[np.bool_]:
    """Return (count, count) which labels are neighbours without a depth step at two or more pixels of the grid."""
    met = np.zeros((count, count), dtype=np.int64)
    for here, there in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        a, b = labels[here], labels[there]
        meets = (a != b) & (a > 0) & (b > 0) & (np.abs(depth[here] - depth[there]) < 0.02 + 0.015 * depth[here])
        met += np.bincount(a[meets].astype(np.int64) * count + b[meets], minlength=count * count).reshape(met.shape)
    met += met.T
    return met >= 2
