"""The layer-1 cloud of a track: one mean point per voxel of the world's lattice, with the number of its sightings.

The lattice is anchored at the world's origin, so that two clouds of one surface fall into the same cells whichever
track saw it first, and a cloud is bounded by its surface, not by the number of frames.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numba
import numpy as np

from hickory_stream.geometry.voxels import keys_of_points

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Cloud:
    """Sorted voxel `keys` (N,), mean `points` and `colors` (N, 3) as float32, and `hits` (N,): frames per voxel."""

    keys: NDArray[np.int64]
    points: NDArray[np.float32]
    colors: NDArray[np.float32]
    hits: NDArray[np.int32]


def cloud_of(points: NDArray[np.float32], colors: NDArray[np.uint8], voxel_m: float) -> Cloud:
    """Return the cloud of one frame's points."""
    keys = keys_of_points(points, voxel_m)
    order = np.argsort(keys, kind="stable")
    return _averaged(
        keys[order], points[order], colors[order].astype(np.float32), np.ones(len(keys), dtype=np.int32), frames=1
    )


def fuse(a: Cloud, b: Cloud) -> Cloud:
    """Return the union of two clouds: means weighted by hits."""
    keys = np.concatenate([a.keys, b.keys])
    order = np.argsort(keys, kind="stable")
    return _averaged(
        keys[order],
        np.concatenate([a.points, b.points])[order],
        np.concatenate([a.colors, b.colors])[order],
        np.concatenate([a.hits, b.hits])[order],
        frames=None,
    )


def without(cloud: Cloud, drop: NDArray[np.bool_]) -> Cloud:
    """Return the cloud without the marked voxels."""
    keep = ~drop
    return Cloud(keys=cloud.keys[keep], points=cloud.points[keep], colors=cloud.colors[keep], hits=cloud.hits[keep])


def solid_part(cloud: Cloud, sightings: int) -> Cloud:
    """Return the voxels that were seen again: what a single frame put beside the surface is noise.

    Where that would take more than half, the cloud is young or far away and stays whole.
    """
    if sightings < 4:
        return cloud
    once = cloud.hits < (2 if sightings < 12 else 3)
    return cloud if once.mean() > 0.5 else without(cloud, once)


def is_near(keys: NDArray[np.int64], cloud: Cloud) -> NDArray[np.bool_]:
    """Return for each of (N,) voxel keys whether it or one of its 26 neighbours is in a cloud: to one or two voxels."""
    return np.asarray(_is_near(keys, cloud.keys))


def share_near(keys: NDArray[np.int64], cloud: Cloud, sample: int = 400) -> float:
    """Return the share of voxels that lie on a cloud, from at most about `sample` of them, evenly taken."""
    if len(keys) == 0:
        return 0.0
    return float(is_near(keys[:: max(1, len(keys) // sample)], cloud).mean())


def _averaged(
    keys: NDArray[np.int64],
    points: NDArray[np.float32],
    colors: NDArray[np.float32],
    hits: NDArray[np.int32],
    frames: int | None,
) -> Cloud:
    """Average rows of equal key (sorted); `frames` replaces the summed hits where all rows are of one frame."""
    unique, starts = np.unique(keys, return_index=True)
    if len(unique) == len(keys):
        return Cloud(keys=keys, points=points, colors=colors, hits=hits)
    weights = hits.astype(np.float64)
    total = np.add.reduceat(weights, starts)
    mean = np.add.reduceat(points * weights[:, None], starts) / total[:, None]
    color = np.add.reduceat(colors * weights[:, None], starts) / total[:, None]
    summed = np.full(len(unique), frames) if frames is not None else total
    return Cloud(
        keys=unique,
        points=mean.astype(np.float32),
        colors=color.astype(np.float32),
        hits=summed.astype(np.int32),
    )


@numba.njit(cache=True, nogil=True)
def _is_near(keys, cloud_keys):  # type: ignore[no-untyped-def] # pragma: no cover
    # A step of one cell along an axis adds a constant to the packed key, and along z neighbours are next to each other
    # in the sorted keys: nine searches serve 27 cells.
    near = np.zeros(len(keys), dtype=np.bool_)
    for i in range(len(keys)):
        for side in range(9):
            # The cell's own column first: it mostly decides.
            dx, dy = (side + 1) % 3 - 1, (side // 3 + 1) % 3 - 1
            low = keys[i] + (dx << 42) + (dy << 21) - 1
            at = np.searchsorted(cloud_keys, low)
            if at < len(cloud_keys) and cloud_keys[at] <= low + 2:
                near[i] = True
                break
    return near
