"""The record of an over-segmented frame, which the steps of joining pass on to one another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hickory_stream.perception.room_structure import RoomStructure
    from hickory_stream.perception.surface import Surface


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Fragments:
    """An over-segmented frame at working resolution (h, w): `labels` 1..n, and the support plane of each pixel or 0."""

    surface: Surface
    room: RoomStructure
    supports: NDArray[np.int32]
    labels: NDArray[np.int32]
