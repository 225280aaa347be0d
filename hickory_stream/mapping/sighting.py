"""A sighting: one observation of a keyframe, and the track that it was assigned to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hickory_stream.mapping.cloud import Cloud
    from hickory_stream.records import Observation


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Sighting:
    """An observation, its cloud and the track that it was assigned to.

    `is_part`: it shows only a part of the track, and another observation of the keyframe is the match of the track.
    `lies_on`: the share of its points on the track if it was matched by points, else 0. `covered`: other tracks that it
    covers, which means that the keyframe segments them together with the track.
    """

    observation: Observation
    cloud: Cloud
    track_id: int
    is_part: bool
    lies_on: float
    covered: tuple[int, ...]
