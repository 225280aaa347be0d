"""Corrected poses of submaps: checked when somebody gives them, applied before the next frame."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.errors import InputError
from hickory_stream.events import PosesCorrected
from hickory_stream.geometry.rigid import is_rigid

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray


class Corrections:
    """Those that the core has not been told of yet, in the order in which they were given."""

    def __init__(self) -> None:
        self._waiting: deque[dict[int, NDArray[np.float64]]] = deque()
        self._is_closed = False

    def give(self, world_from_submap: Mapping[int, NDArray[np.float64]], known: Sequence[int]) -> None:
        """Have submaps placed anew; `known` are the ids of the submaps that the map has.

        Raises:
            InputError: there is no such submap, a transform is not rigid, or the map is finished; nothing is moved.
        """
        if self._is_closed:
            raise InputError("the map is finished: poses can be corrected while it is being made")
        self._waiting.append(checked_places(world_from_submap, known))

    def take(self, stamp_ns: int) -> PosesCorrected | None:
        """Return the next as an event of a stamp, None where none waits."""
        if not self._waiting:
            return None
        places = self._waiting.popleft()
        return PosesCorrected(
            stamp_ns=stamp_ns,
            submap_ids=tuple(places),
            world_from_submap=np.array(list(places.values())).reshape(-1, 4, 4),
        )

    def __len__(self) -> int:
        return len(self._waiting)

    def clear(self) -> None:
        """Forget those that wait."""
        self._waiting.clear()

    def close(self) -> None:
        """Take no more."""
        self._is_closed = True


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
