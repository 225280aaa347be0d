"""Checks of tracks against room structure and free space: whether a track is structure or is seen through."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.voxels import keys_of_points
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.entities.observed_space import SpaceState, is_edge, is_flush, share_in, structure_hits
from hickory_stream.mapping.entities.track import Track
from hickory_stream.mapping.rules.lifecycle import LifecycleConfig, is_sure
from hickory_stream.records import Phase

# A track that was not seen for this long is at rest: its extent no longer changes.
RESTING_S = 1.0
# A track with more than this share of its points in a wall is structure as a whole, not an object with wall points.
_MOST_IN_WALL = 0.9
# Minimum share of a track's voxels that a keyframe observes free to count as seeing through it.
_PHANTOM_SHARE = 0.7
# A track whose box exceeds this volume is structure.
_STRUCTURE_M3 = 12.0
# An upright slab with its lower end at most, and its upper end at least, this high above the floor is a piece of a
# wall if it is at least so tall and at most so thick; so is any slab longer than `structure_m`.
_WALL_FOOT_M = 0.7
_WALL_TOP_M = 1.25
_WALL_HEIGHT_M = 0.75
_WALL_THICKNESS_M = 0.22
# A slab whose lower and upper ends are at least this high above the floor is the wall above a door (lintel).
_LINTEL_FOOT_M = 1.4
_LINTEL_TOP_M = 2.1
# When a track becomes dormant with more than this share of its points in voxels that at least so many keyframes saw as
# structure, and so many times as many as saw the point as the track's, these points are removed: a mask included a
# piece of the wall behind the object.
_WALL_SHARE = 0.15
_WALL_HITS = 4
_WALL_AGAINST = 2.0


def why_structure(track: Track, space: SpaceState, clock_ns: int, config: MappingConfig) -> str | None:
    """Return why a track is structure; None if it may be an object."""
    if not config.lifecycle.finds_structure:
        return None
    size = " x ".join(f"{side:.1f}" for side in 2 * track.box.half_extents_m)
    if _is_too_large(track, config.lifecycle):
        return f"{size} m is too large for an object"
    if is_structure(track, space.floor_z_m, config.lifecycle):
        return f"{size} m, an upright slab: a piece of a wall"
    return "flat or an edge, and the wall goes on around it" if _is_more_wall(track, space, clock_ns, config) else None


def points_in_wall(track: Track, space: SpaceState) -> NDArray[np.bool_] | None:
    """Return (N,) which of a track's points lie in structure; None if these are only a narrow strip along a wall."""
    hits = structure_hits(space, keys_of_points(track.cloud.points, space.voxel_m))
    # The back panel of a shelf shares voxels with the wall, but was segmented as the shelf more often than as wall.
    in_wall = (hits >= _WALL_HITS) & (hits > _WALL_AGAINST * track.cloud.hits)
    return in_wall if _WALL_SHARE < float(in_wall.mean()) < _MOST_IN_WALL else None


def is_seen_through(track: Track, free_keys: NDArray[np.int64], config: MappingConfig) -> bool:
    """Return whether a keyframe whose rays traversed the sorted voxels `free_keys` saw through a track."""
    share = share_in(free_keys, track.cloud.points, config.voxels.space_m)
    return share >= _PHANTOM_SHARE


def _is_more_wall(track: Track, space: SpaceState, clock_ns: int, config: MappingConfig) -> bool:
    # Only for tracks that are confirmed, at rest, or already set aside as structure.
    is_settling = track.phase is Phase.TENTATIVE and is_sure(track, config.lifecycle)
    is_resting = track.phase is Phase.ACTIVE and clock_ns - track.seen_clock_ns > RESTING_S * 1e9
    if not (is_settling or is_resting or track.phase is Phase.ROOM):
        return False
    return is_flush(space, track.box) or is_edge(space, track.box)


def is_structure(track: Track, floor_z_m: float | None, config: LifecycleConfig) -> bool:
    """Return whether a track is structure by its size or as a piece of a wall."""
    return _is_too_large(track, config) or (is_sure(track, config) and _is_piece_of_wall(track, floor_z_m, config))


def _is_too_large(track: Track, config: LifecycleConfig) -> bool:
    two_longest_m = np.sort(2 * track.box.half_extents_m)[1]
    return bool(two_longest_m > config.structure_m or track.box.volume_m3 > _STRUCTURE_M3)


def _is_piece_of_wall(track: Track, floor_z_m: float | None, config: LifecycleConfig) -> bool:
    # An upright slab from near the floor to above the waist, e.g. the wall between two doors.
    size = 2 * track.box.half_extents_m
    low, high = float(track.bounds[0, 2]), float(track.bounds[1, 2])
    thickness, width = float(min(size[:2])), float(max(size[:2]))
    if thickness > _WALL_THICKNESS_M or floor_z_m is None or high < floor_z_m + _WALL_TOP_M:
        return False
    if width > config.structure_m:
        return True
    if low > floor_z_m + _LINTEL_FOOT_M and high > floor_z_m + _LINTEL_TOP_M:
        return True
    is_tall = size[2] > _WALL_HEIGHT_M
    return low < floor_z_m + _WALL_FOOT_M and is_tall and width > 2 * thickness
