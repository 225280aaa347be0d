"""The phases of a track.

    | from      | to        | when                                                                      |
    |-----------|-----------|---------------------------------------------------------------------------|
    | (new)     | tentative | an observation matches no track                                            |
    | tentative | active    | its evidence is that of `confirm_sightings` sightings (`existence.py`)     |
    | tentative | (dropped) | not seen for `tentative_s`                                                 |
    | active    | dormant   | not seen for `dormant_s`                                                   |
    | dormant   | archived  | not seen for `archive_s`                                                   |
    | dormant   | active    | seen again                                                                 |
    | archived  | active    | seen again                                                                 |
    | any       | (dropped) | `phantom_frames` keyframes saw through its place                            |
    | any       | structure | its two longest sides are over `structure_m`, or its box over `structure_m3` |
    | confirmed | structure | an upright slab from the floor to `wall_top_m`: a wall between two doors       |
    | any       | (dropped) | more than `structure_share` of it lies in such structure                    |

Times are of the core's own clock, which runs on through a jump of the stamps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.ranges import Ranged, number
from hickory_stream.records import Phase

if TYPE_CHECKING:
    from hickory_stream.mapping.track import Track


_ROUNDING = 1e-6


@dataclass(frozen=True, kw_only=True, slots=True)
class LifecycleConfig(Ranged):
    """The numbers of the table.

    Attributes:
        confirm_sightings: evidence for a confirmation, in units of `existence`: two good sightings from different
            viewpoints, or so many from the same one.
        tentative_s: unconfirmed tracks are kept for so long, so that a second visit can confirm them.
        wall_foot_m, wall_top_m, wall_height_m, wall_thickness_m: an upright slab that begins at most this high above
            the floor, ends at least that high, is at least so tall and thinner, is a piece of a wall; so is one longer
            than `structure_m`, wherever it begins.
        lintel_foot_m, lintel_top_m: a slab that begins and ends at least that high above the floor is what a wall has
            over a door.
        wall_share, wall_hits: of a track that comes to rest with more of its points than this in voxels that so many
            keyframes saw as structure, and `wall_against` times as many as saw the point as the track's, these points
            are removed: some mask of the track included a piece of the wall behind it.
        phantom_share: minimum share of a track's voxels that a keyframe observes free to count as seeing through it.
    """

    confirm_sightings: int = number(4, 1, 1_000_000, "sightings")
    tentative_s: float = number(60.0, 0, 1e9, "s")
    dormant_s: float = number(4.0, 0, 1e9, "s")
    archive_s: float = number(60.0, 0, 1e9, "s")
    phantom_frames: int = number(4, 1, 1_000_000, "keyframes")
    phantom_share: float = number(0.7, 0, 1, "share")
    structure_m: float = number(2.6, 0, 1000, "m")
    structure_m3: float = number(12.0, 0, 1e6, "m3")
    wall_foot_m: float = number(0.7, 0, 100, "m")
    wall_top_m: float = number(1.25, 0, 100, "m")
    wall_height_m: float = number(0.75, 0, 100, "m")
    wall_thickness_m: float = number(0.22, 0, 100, "m")
    lintel_foot_m: float = number(1.4, 0, 100, "m")
    lintel_top_m: float = number(2.1, 0, 100, "m")
    structure_share: float = number(0.5, 0, 1, "share")
    wall_share: float = number(0.15, 0, 1, "share")
    wall_hits: int = number(4, 0, 1_000_000, "keyframes")
    wall_against: float = number(2.0, 0, 1000, "ratio")


def next_phase(track: Track, clock_ns: int, config: LifecycleConfig) -> Phase | None:
    """Return the phase of a track at `clock_ns`, None if it is to be dropped."""
    unseen_s = (clock_ns - track.seen_clock_ns) / 1e9
    if track.seen_through >= config.phantom_frames:
        return None
    if track.phase is Phase.TENTATIVE:
        if is_sure(track, config):
            return Phase.ACTIVE
        return None if unseen_s > config.tentative_s else Phase.TENTATIVE
    if unseen_s > config.archive_s:
        return Phase.ARCHIVED
    return Phase.DORMANT if unseen_s > config.dormant_s else Phase.ACTIVE


def is_sure(track: Track, config: LifecycleConfig) -> bool:
    """Return whether there is enough evidence to confirm a track."""
    return track.existence.evidence >= config.confirm_sightings - _ROUNDING


def is_structure(track: Track, floor_z_m: float | None, config: LifecycleConfig) -> bool:
    """Return whether a track is structure by its size or as a piece of a wall."""
    size = 2 * track.box.half_extents_m
    if np.sort(size)[1] > config.structure_m or track.box.volume_m3 > config.structure_m3:
        return True
    return is_sure(track, config) and _is_piece_of_wall(track, floor_z_m, config)


def _is_piece_of_wall(track: Track, floor_z_m: float | None, config: LifecycleConfig) -> bool:
    """Return whether a track is an upright slab from near the floor to above the waist: a wall between two doors."""
    size = 2 * track.box.half_extents_m
    low, high = float(track.bounds[0, 2]), float(track.bounds[1, 2])
    thickness, width = float(min(size[:2])), float(max(size[:2]))
    if thickness > config.wall_thickness_m or floor_z_m is None or high < floor_z_m + config.wall_top_m:
        return False
    if width > config.structure_m:
        return True
    if low > floor_z_m + config.lintel_foot_m and high > floor_z_m + config.lintel_top_m:
        return True
    is_tall = size[2] > config.wall_height_m
    return low < floor_z_m + config.wall_foot_m and is_tall and width > 2 * thickness


def aged(track: Track, phase: Phase) -> Track:
    """Return the track in a phase."""
    return track if track.phase is phase else replace(track, phase=phase)
