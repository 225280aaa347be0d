"""Checks of tracks against the observed space: points in structure, and whether a track is seen through."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.voxels import keys_of_points
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.entities.observed_space import SpaceState, share_in, structure_hits
from hickory_stream.mapping.entities.track import Track

# A track with more than this share of its points in a wall is structure as a whole, not an object with wall points.
_MOST_IN_WALL = 0.9
# Minimum share of a track's voxels that a keyframe observes free to count as seeing through it.
_PHANTOM_SHARE = 0.7
# When a track becomes dormant with more than this share of its points in voxels that at least so many keyframes saw as
# structure, and so many times as many as saw the point as the track's, these points are removed: a mask included a
# piece of the wall behind the object.
_WALL_SHARE = 0.15
_WALL_HITS = 4
_WALL_AGAINST = 2.0


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
