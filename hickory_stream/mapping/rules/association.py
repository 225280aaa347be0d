"""Data association: one-to-one by the exact IoU of oriented boxes, then partial views by their points.

The box of an object that the image border cuts is small inside the track's large one, so its IoU is inconclusive.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.geometry.bounds import bounds_of
from hickory_stream.geometry.boxes import box_iou, intersection_volume_m3
from hickory_stream.geometry.voxels import keys_of_points
from hickory_stream.mapping.entities.cloud import SETTLED_SIGHTINGS, share_near
from hickory_stream.mapping.entities.track import Track
from hickory_stream.mapping.entities.track_table import TrackTable
from hickory_stream.records import Observation

A = TypeVar("A")
B = TypeVar("B")


def one_to_one(ranked: Iterable[tuple[A, B]], *, of_one_kind: bool) -> list[tuple[A, B]]:
    """Return the pairs, best first, without members of earlier pairs; `of_one_kind`: both members are of one set."""
    firsts: set[A | B] = set()
    seconds: set[A | B] = firsts if of_one_kind else set()
    pairs = []
    for a, b in ranked:
        if a not in firsts and b not in seconds:
            firsts.add(a)
            seconds.add(b)
            pairs.append((a, b))
    return pairs


# Minimum IoU of the boxes of a view and its track.
ALIKE_IOU = 0.2
# Shares that differ by less than this count as equal: they are quotients of the same counts.
_TIE = 1e-12
# An observation can lie on a track only if at least this share of its box is inside the track's box.
_MIN_LIES_IN = 0.2
# Minimum share of the track's box inside the box of an oversized observation.
_OVERSIZE_COVER = 0.5


@dataclass(frozen=True, kw_only=True, slots=True)
class AssociateConfig(Ranged):
    """When an observation matches a track."""

    #: Minimum IoU of the oriented boxes.
    min_iou: float = number(ALIKE_IOU, 0, 1, "IoU")
    #: Minimum share of a partial view's points that lie on the track.
    min_lies_on: float = number(0.55, 0, 1, "share")
    #: An observation whose box has more than this many times the volume of a settled track's box is under-segmented.
    oversize_ratio: float = number(2.2, 1, 1000, "ratio")


@dataclass(frozen=True, kw_only=True, slots=True)
class Match:
    """An observation and the track that it matches."""

    observation_index: int
    track_id: int | None
    iou: float
    lies_on: float
    #: it shows a part of a track that another observation of the frame matches
    is_part: bool
    #: the tracks with overlapping boxes and their IoU, best first, for the log
    candidates: tuple[tuple[int, float], ...]


def associate(
    observations: Sequence[Observation], tracks: TrackTable, voxel_m: float, config: AssociateConfig
) -> list[Match]:
    """Return one match per observation, in order; `track_id` None: it is a new object.

    First by boxes, greedily: pairs in order of decreasing IoU, ties by track id, then by observation. Then by points:
    each unmatched observation goes to the track with most of its points; of several on one track, the one with most is
    the match, and the others are parts.
    """
    ious: dict[int, dict[int, float]] = {}
    oversized: dict[int, set[int]] = {}
    for observation in observations:
        near = tracks.touching(bounds_of(observation.points_world))
        row = {track.id: box_iou(observation.box, track.box) for track in near}
        ious[observation.index] = {track_id: iou for track_id, iou in row.items() if iou > 0}
        oversized[observation.index] = {track.id for track in near if is_oversized(observation, track, config)}
    ranked = sorted(
        (-iou, track_id, index)
        for index, row in ious.items()
        for track_id, iou in row.items()
        if iou >= config.min_iou and track_id not in oversized[index]
    )
    by_observation = dict(one_to_one(((index, track_id) for _, track_id, index in ranked), of_one_kind=False))
    taken = set(by_observation.values())
    lying: dict[int, tuple[int | None, float]] = {}
    for observation in observations:
        near_ids = [i for i in sorted(ious[observation.index]) if i not in oversized[observation.index]]
        if observation.index not in by_observation and near_ids:
            track_id, share = _lies_on_most(observation, [tracks[i] for i in near_ids], voxel_m)
            lying[observation.index] = (track_id if share >= config.min_lies_on else None, share)
    num_points = {observation.index: len(observation.points_world) for observation in observations}
    parts: set[int] = set()
    for index in sorted(lying, key=lambda index: (-lying[index][1] * num_points[index], index)):
        track_id, _ = lying[index]
        if track_id is not None:
            by_observation[index] = track_id
            parts |= {index} if track_id in taken else set()
            taken.add(track_id)
    return [
        Match(
            observation_index=index,
            track_id=(found := by_observation.get(index)),
            iou=0.0 if found is None else ious[index].get(found, 0.0),
            lies_on=lying.get(index, (None, 0.0))[1],
            is_part=index in parts,
            candidates=tuple(sorted(ious[index].items(), key=lambda pair: (-pair[1], pair[0]))),
        )
        for index in (observation.index for observation in observations)
    ]


def is_oversized(observation: Observation, track: Track, config: AssociateConfig) -> bool:
    """Return whether an observation is under-segmented: it contains an established track and something beside it."""
    return (
        track.sightings >= SETTLED_SIGHTINGS
        and observation.box.volume_m3 > config.oversize_ratio * track.box.volume_m3
        and intersection_volume_m3(observation.box, track.box) > _OVERSIZE_COVER * track.box.volume_m3
    )


def _lies_on_most(observation: Observation, tracks: Sequence[Track], voxel_m: float) -> tuple[int | None, float]:
    keys = keys_of_points(observation.points_world, voxel_m)
    best_id, best_share = None, 0.0
    for track in tracks:
        if intersection_volume_m3(observation.box, track.box) < _MIN_LIES_IN * observation.box.volume_m3:
            continue
        share = share_near(keys, track.cloud)
        if share > best_share + _TIE:
            best_id, best_share = track.id, share
    return best_id, float(np.round(best_share, 6))
