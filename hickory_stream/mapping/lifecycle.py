"""The phases of a track.

    | from      | to        | when                                                                      |
    |-----------|-----------|---------------------------------------------------------------------------|
    | (new)     | tentative | an observation is no known track                                           |
    | tentative | active    | seen in `confirm_sightings` keyframes                                      |
    | tentative | (dropped) | not seen for `tentative_s`                                                 |
    | active    | dormant   | not seen for `dormant_s`                                                   |
    | dormant   | archived  | not seen for `archive_s`                                                   |
    | dormant   | active    | seen again                                                                 |
    | archived  | active    | seen again                                                                 |
    | any       | (dropped) | `phantom_frames` keyframes looked through the place where it should be      |
    | any       | structure | its two longest sides are both over `structure_m`: a wall, a row of cupboards |
    | any       | (dropped) | more than `structure_share` of it lies in such structure                    |

Times are of the core's own clock, which runs on through a jump of the stamps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.records import Phase

if TYPE_CHECKING:
    from hickory_stream.mapping.track import Track


@dataclass(frozen=True, kw_only=True, slots=True)
class LifecycleConfig:
    """The numbers of the table.

    Attributes:
        phantom_share: share of a track's voxels that must be seen free for a keyframe to count as looking through.
    """

    confirm_sightings: int = 4
    tentative_s: float = 8.0
    dormant_s: float = 4.0
    archive_s: float = 60.0
    phantom_frames: int = 4
    phantom_share: float = 0.7
    structure_m: float = 2.0
    structure_share: float = 0.5


def next_phase(track: Track, clock_ns: int, config: LifecycleConfig) -> Phase | None:
    """Return the phase of a track at `clock_ns`, None if it is to be dropped."""
    unseen_s = (clock_ns - track.seen_clock_ns) / 1e9
    if track.seen_through >= config.phantom_frames:
        return None
    if track.phase is Phase.TENTATIVE:
        if track.sightings >= config.confirm_sightings:
            return Phase.ACTIVE
        return None if unseen_s > config.tentative_s else Phase.TENTATIVE
    if unseen_s > config.archive_s:
        return Phase.ARCHIVED
    return Phase.DORMANT if unseen_s > config.dormant_s else Phase.ACTIVE


def is_structure(track: Track, config: LifecycleConfig) -> bool:
    """Return whether a track has grown into something that is no object."""
    return bool(np.sort(2 * track.box.half_extents_m)[1] > config.structure_m)


def aged(track: Track, phase: Phase) -> Track:
    """Return the track in a phase."""
    return track if track.phase is phase else replace(track, phase=phase)
