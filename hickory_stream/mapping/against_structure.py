"""Whether a track is structure, which of its points are, and whether a keyframe looked through it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.voxels import keys_of_points
from hickory_stream.mapping.lifecycle import is_structure, is_sure
from hickory_stream.mapping.observed_space import is_edge, is_flush, share_in, structure_hits
from hickory_stream.records import Phase

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.mapping.mapping_config import MappingConfig
    from hickory_stream.mapping.observed_space import SpaceState
    from hickory_stream.mapping.track import Track

# A track that was not seen for so long rests.
_RESTING_NS = 1_000_000_000
# What lies in a wall with nearly all of its points is no object with a piece of wall on it.
_MOST_IN_WALL = 0.9


def why_structure(track: Track, space: SpaceState, clock_ns: int, config: MappingConfig) -> str | None:
    """Return why a track is no object but structure, None where it may be one."""
    if is_structure(track, space.floor_z_m, config.lifecycle):
        return f"{np.round(2 * track.box.half_extents_m, 1)} m: structure"
    return "flat or an edge, and the wall goes on around it" if _is_more_wall(track, space, clock_ns, config) else None


def points_in_wall(track: Track, space: SpaceState, config: MappingConfig) -> NDArray[np.bool_] | None:
    """Return which (N,) of a track's points lie in structure, None if no more do than a seam at a wall."""
    hits = structure_hits(space, keys_of_points(track.cloud.points, space.voxel_m))
    # A shelf's back in the voxels of the wall behind it was seen as its own more often than as the wall.
    in_wall = (hits >= config.lifecycle.wall_hits) & (hits > config.lifecycle.wall_against * track.cloud.hits)
    return in_wall if config.lifecycle.wall_share < float(in_wall.mean()) < _MOST_IN_WALL else None


def is_seen_through(track: Track, free_keys: NDArray[np.int64], config: MappingConfig) -> bool:
    """Return whether a keyframe whose rays passed the sorted voxels `free_keys` looked through a track."""
    share = share_in(free_keys, track.cloud.points, config.lattice.space_m)
    return share >= config.lifecycle.phantom_share


def _is_more_wall(track: Track, space: SpaceState, clock_ns: int, config: MappingConfig) -> bool:
    """Return whether a track is flush with structure, or an edge of it; asked where it settles or rests."""
    is_settling = track.phase is Phase.TENTATIVE and is_sure(track, config.lifecycle)
    is_resting = track.phase is Phase.ACTIVE and clock_ns - track.seen_clock_ns > _RESTING_NS
    if not (is_settling or is_resting):
        return False
    return is_flush(space, track.box, config.flush) or is_edge(space, track.box, config.flush)
