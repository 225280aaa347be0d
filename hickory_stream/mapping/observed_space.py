"""Space as it was seen so far: free and structure voxels, kept as sorted keys."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.geometry.voxels import centers_of_keys, contains, difference, keys_of_cells, keys_of_points
from hickory_stream.records import ObservedSpace

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.geometry.boxes import OrientedBox
    from hickory_stream.records import SpaceObservation

_SURE_HITS = 2
# 255 where a track was that is structure; one less for each keyframe that saw through it, down to none.
_NO_OBJECT, _DISPROVED = 255, 251
_MOST_HITS = _DISPROVED
# As far as cells are numbered.
_FAR = 1 << 20


@dataclass(frozen=True, kw_only=True, slots=True)
class FlushConfig:
    """When a flat thing is more of the wall around it: sizes, and the share of its border along which the wall goes on.

    Structure counts from half of `reach_m` to `reach_m` beyond the border (a wall that meets the thing at an edge is
    not in its plane, and ends before), in the thing's own plane: its middle may lie off the thing's by `max_offset` of
    half the thickness. Nothing counts up to `foot_m` above the floor, on which everything stands.
    """

    thickness_m: float = 0.12
    min_size_m: float = 0.2
    reach_m: float = 0.2
    border_share: float = 0.25
    max_offset: float = 0.8
    foot_m: float = 0.1


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SpaceState:
    """`free` and `structure` sorted keys; `hits` counts the keyframes per structure voxel, over 251 for a track."""

    voxel_m: float
    free: NDArray[np.int64]
    structure: NDArray[np.int64]
    hits: NDArray[np.uint8]
    floor_z_m: float | None = None


def empty_space(voxel_m: float) -> SpaceState:
    """Return space of which nothing was seen."""
    none = np.zeros(0, dtype=np.int64)
    return SpaceState(voxel_m=voxel_m, free=none, structure=none, hits=np.zeros(0, dtype=np.uint8))


def add(state: SpaceState, seen: SpaceObservation) -> SpaceState:
    """Return the space after one more keyframe. The floor follows slowly, and goes down at once.

    Where a track was taken for structure, and four keyframes see through it, there is none: somebody stood there.
    """
    state = _without_disproved(state, seen.free_keys)
    fresh = ~contains(state.free, seen.free_keys)
    free = _merged(state.free, seen.free_keys[fresh])
    known = contains(state.structure, seen.structure_keys)
    hits = state.hits.copy()
    at = np.searchsorted(state.structure, seen.structure_keys[known])
    hits[at] = np.maximum(hits[at], np.minimum(hits[at].astype(np.int64) + 1, _MOST_HITS))
    keys = np.concatenate([state.structure, seen.structure_keys[~known]])
    hits = np.concatenate([hits, np.ones(int((~known).sum()), dtype=np.uint8)])
    order = np.argsort(keys, kind="stable")
    return SpaceState(
        voxel_m=state.voxel_m,
        free=free,
        structure=keys[order],
        hits=hits[order],
        floor_z_m=_floor(state.floor_z_m, seen.floor_z_m),
    )


def _without_disproved(state: SpaceState, free_keys: NDArray[np.int64]) -> SpaceState:
    disproved = (state.hits > _DISPROVED) & contains(free_keys, state.structure)
    if not disproved.any():
        return state
    hits = state.hits - disproved.astype(np.uint8)
    stays = ~disproved | (hits > _DISPROVED)
    return replace(state, structure=state.structure[stays], hits=hits[stays])


def add_structure(state: SpaceState, points: NDArray[np.float32]) -> SpaceState:
    """Return the space in which the voxels of (N, 3) points surely are structure: what was an object, and is none."""
    keys = np.unique(keys_of_points(points, state.voxel_m))
    old = ~contains(keys, state.structure)
    all_keys = np.concatenate([state.structure[old], keys])
    hits = np.concatenate([state.hits[old], np.full(len(keys), _NO_OBJECT, dtype=np.uint8)])
    order = np.argsort(all_keys, kind="stable")
    return replace(state, structure=all_keys[order], hits=hits[order])


def known_no_object(state: SpaceState) -> NDArray[np.int64]:
    """Return the sorted keys of the voxels that `add_structure` made structure."""
    return np.asarray(state.structure[state.hits > _DISPROVED])


def share_in(keys: NDArray[np.int64], points: NDArray[np.float32], voxel_m: float) -> float:
    """Return the share of (N, 3) points, from about 200 of them, in voxels of sorted keys."""
    return float(contains(keys, keys_of_points(points[:: max(1, len(points) // 200)], voxel_m)).mean())


def sure_structure(state: SpaceState, min_hits: int) -> NDArray[np.int64]:
    """Return the sorted keys of the voxels that at least `min_hits` keyframes saw as structure."""
    return np.asarray(state.structure[state.hits >= min_hits])


def is_flush(state: SpaceState, box: OrientedBox, config: FlushConfig) -> bool:
    """Return whether a flat thing lies in the plane of structure that goes on around it: more of the same wall."""
    half = box.half_extents_m
    thin = int(np.argmin(half))
    wide = np.delete(half, thin)
    if 2 * half[thin] > config.thickness_m or 2 * wide.min() < config.min_size_m:
        return False
    # What frames saw as structure: a track that was dropped for one reason is no reason to drop its neighbour.
    sure = state.structure[(state.hits >= _SURE_HITS) & (state.hits <= _DISPROVED)]
    centers = centers_of_keys(_near(sure, box, state.voxel_m, config.reach_m), state.voxel_m)
    if state.floor_z_m is not None:
        centers = centers[centers[:, 2] > state.floor_z_m + config.foot_m]
    local = apply(invert(box.world_from_box), centers)
    offset, in_plane = local[:, thin], np.delete(local, thin, axis=1)
    beyond = (np.abs(in_plane) - wide).max(axis=1)
    around = (
        (beyond > config.reach_m / 2) & (beyond < config.reach_m) & (np.abs(offset) < half[thin] + state.voxel_m / 2)
    )
    if not around.any() or abs(float(np.median(offset[around]))) > config.max_offset * half[thin] + state.voxel_m / 4:
        return False
    # Cells of the border itself, each once, however deep the structure is behind it.
    border = np.unique(np.floor(np.clip(in_plane[around], -wide, wide) / state.voxel_m), axis=0)
    return len(border) * state.voxel_m > config.border_share * 4 * float(wide.sum())


def _near(keys: NDArray[np.int64], box: OrientedBox, voxel_m: float, reach_m: float) -> NDArray[np.int64]:
    """Return the sorted keys whose voxels may lie within `reach_m` of a box; they are ordered by x first."""
    x = box.corners_world()[:, 0]
    low, high = int(np.floor((x.min() - reach_m) / voxel_m)), int(np.floor((x.max() + reach_m) / voxel_m)) + 1
    least = np.array([[low, -_FAR, -_FAR], [high, -_FAR, -_FAR]])
    first, last = np.searchsorted(keys, keys_of_cells(least))
    return keys[first:last]


def as_record(state: SpaceState) -> ObservedSpace:
    """Return the public record: structure that was seen twice, and free space that is not structure."""
    structure = state.structure[state.hits >= _SURE_HITS]
    return ObservedSpace(
        voxel_m=state.voxel_m,
        free=difference(state.free, structure),
        structure=structure,
        floor_z_m=state.floor_z_m,
    )


def _merged(a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.int64]:
    # A stable sort of two sorted runs is a merge.
    return np.sort(np.concatenate([a, b]), kind="stable") if len(b) else a


def _floor(known_m: float | None, seen_m: float | None) -> float | None:
    if known_m is None or seen_m is None:
        return known_m if seen_m is None else seen_m
    return seen_m if seen_m < known_m - 0.06 else 0.8 * known_m + 0.2 * seen_m
