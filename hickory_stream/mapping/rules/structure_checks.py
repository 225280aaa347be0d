"""Checks of tracks against the observed space: points in structure, and whether a track is seen through."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.entities.observed_space import share_in
from hickory_stream.mapping.entities.track import Track

# Minimum share of a track's voxels that a keyframe observes free to count as seeing through it.
_PHANTOM_SHARE = 0.7


def is_seen_through(track: Track, free_keys: NDArray[np.int64], config: MappingConfig) -> bool:
    """Return whether a keyframe whose rays traversed the sorted voxels `free_keys` saw through a track."""
    share = share_in(free_keys, track.cloud.points, config.voxels.space_m)
    return share >= _PHANTOM_SHARE
