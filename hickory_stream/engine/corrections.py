"""Validation of corrected submap poses before they are applied."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.errors import InputError
from hickory_stream.geometry.rigid import is_rigid

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray


def checked_places(
    world_from_submap: Mapping[int, NDArray[np.float64]], known: Sequence[int]
) -> dict[int, NDArray[np.float64]]:
    """Return copies of the (4, 4) places by submap; `known` are the ids of the submaps that the map has.

    Raises:
        InputError: there is no such submap, or a transform is not rigid.
    """
    for submap_id, pose in world_from_submap.items():
        if submap_id not in known:
            there = f"the map has {known[0]} to {known[-1]}" if known else "the map has none before its first keyframe"
            raise InputError(f"there is no submap {submap_id}: {there}")
        if np.shape(pose) != (4, 4) or not is_rigid(np.asarray(pose)):
            raise InputError(f"world_from_submap of submap {submap_id} must be a rigid (4, 4) transform, found {pose}")
    return {i: np.array(pose, dtype=np.float64) for i, pose in world_from_submap.items()}
