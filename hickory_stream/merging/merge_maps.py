"""Merging of maps: all pairs aligned, one pose graph, corresponding objects fused. Inputs are never changed."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.answer import Alignment, NoAlignment
from hickory_stream.alignment.object_map import object_map
from hickory_stream.base.ranges import Ranged, number
from hickory_stream.merging.clusters import Member, Pairing, Place, clusters_of
from hickory_stream.merging.joining import JoiningConfig, aligned_to_join
from hickory_stream.merging.layout import Answers, PairOutcome, largest_layout
from hickory_stream.merging.objects import MergedObject, placed, united
from hickory_stream.records import MapSnapshot, Phase, Submap, TrackedObject


@dataclass(frozen=True, kw_only=True, slots=True)
class MergeMapsConfig(Ranged):
    """How maps are merged.

    Attributes:
        joining: how two of them are aligned, and how surely.
        same_share: objects of two maps that share this much of their surface are one, though no alignment paired them.
        changed_share: a shape is made anew where other maps add more than this share of new surface.
        max_views: views that a merged object keeps.
    """

    joining: JoiningConfig = field(default_factory=JoiningConfig)
    same_share: float = number(0.6, 0, 1, "share")
    changed_share: float = number(0.15, 0, 1, "share")
    max_views: int = number(8, 1, 64, "views")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Merged:
    """The merged map, in the frame of the first map that is in it."""

    snapshot: MapSnapshot
    objects: tuple[MergedObject, ...]
    #: None for a map that hangs on no other
    world_from_map: tuple[NDArray[np.float64] | None, ...]
    pairs: tuple[PairOutcome, ...]
    #: the maps and ids behind each new id
    provenance: Mapping[int, tuple[Member, ...]]
    #: where each map's frames are numbered from
    first_frames: tuple[int, ...]

    @property
    def left_out(self) -> tuple[int, ...]:
        """The maps that could not be merged."""
        return tuple(i for i, pose in enumerate(self.world_from_map) if pose is None)


def merge_maps(
    snapshots: Sequence[MapSnapshot],
    config: MergeMapsConfig | None = None,
    extractors: Sequence[str] = (),
    progress: Callable[[int, int], None] = lambda a, b: None,
) -> Merged:
    """Return one map of the largest set that hangs together; `progress` gets the two maps that are aligned next."""
    config = MergeMapsConfig() if config is None else config
    names = tuple(extractors) or ("",) * len(snapshots)
    maps = [object_map(snapshot, name) for snapshot, name in zip(snapshots, names, strict=True)]
    answers: dict[tuple[int, int], Alignment | NoAlignment] = {}
    for a, b in combinations(range(len(maps)), 2):
        progress(a, b)
        answers[a, b] = aligned_to_join(maps[a], maps[b], config.joining)
    return merge_aligned(snapshots, answers, config)


def merge_aligned(snapshots: Sequence[MapSnapshot], answers: Answers, config: MergeMapsConfig | None = None) -> Merged:
    """Return one map of several that were aligned, as `merge_maps` does; `answers` by the pair (a, b), a < b."""
    config = MergeMapsConfig() if config is None else config
    world_from_map, pairs = largest_layout(snapshots, answers)
    members, items, first_frames = _gathered(snapshots, world_from_map)
    pairings = [
        Pairing(a=(pair.a, matched.id_a), b=(pair.b, matched.id_b), residual_m=matched.residual_m)
        for pair in pairs
        if pair.is_believed and world_from_map[pair.a] is not None and isinstance(pair.answer, Alignment)
        for matched in pair.answer.pairs
    ]
    places = {member: Place(points=items[member].points_world, box=items[member].box) for member in members}
    groups = clusters_of(members, pairings, places, config.same_share)
    objects, provenance = _united(groups, items, config)
    snapshot = MapSnapshot(
        revision=max((s.revision for s in snapshots), default=0),
        stamp_ns=max((s.stamp_ns for s in snapshots), default=0),
        submaps=_submaps(snapshots, world_from_map),
        objects=tuple(merged.item for merged in objects),
    )
    return Merged(
        snapshot=snapshot,
        objects=objects,
        world_from_map=world_from_map,
        pairs=pairs,
        provenance=provenance,
        first_frames=first_frames,
    )


def _gathered(
    snapshots: Sequence[MapSnapshot], world_from_map: Sequence[NDArray[np.float64] | None]
) -> tuple[list[Member], dict[Member, TrackedObject], tuple[int, ...]]:
    # The first map that is laid out keeps its ids; those of the others follow.
    members: list[Member] = []
    items: dict[Member, TrackedObject] = {}
    first_frames = []
    next_id, next_frame, next_submap = 0, 0, 0
    for i, (snapshot, pose) in enumerate(zip(snapshots, world_from_map, strict=True)):
        first_frames.append(next_frame)
        if pose is None:
            continue
        offset = next_id
        order = {submap.id: k for k, submap in enumerate(snapshot.submaps)}
        for item in snapshot.objects:
            if item.phase != Phase.TENTATIVE:
                members.append((i, item.id))
                items[i, item.id] = placed(
                    item,
                    pose,
                    new_id=item.id + offset,
                    submap_id=next_submap + order.get(item.submap_id, 0),
                    first_frame=next_frame,
                )
                next_id = max(next_id, item.id + offset + 1)
        frames = [view.frame_index for item in snapshot.objects for view in item.views]
        next_frame += max(frames, default=-1) + 1
        next_submap += len(snapshot.submaps)
    return members, items, tuple(first_frames)


def _united(
    groups: Sequence[tuple[Member, ...]], items: Mapping[Member, TrackedObject], config: MergeMapsConfig
) -> tuple[tuple[MergedObject, ...], dict[int, tuple[Member, ...]]]:
    objects, provenance = [], {}
    for group in groups:
        merged = united(
            [items[member] for member in group], max_views=config.max_views, changed_share=config.changed_share
        )
        objects.append(merged)
        provenance[merged.item.id] = group
    return tuple(sorted(objects, key=lambda merged: merged.item.id)), provenance


def _submaps(
    snapshots: Sequence[MapSnapshot], world_from_map: Sequence[NDArray[np.float64] | None]
) -> tuple[Submap, ...]:
    return tuple(
        Submap(id=i, world_from_submap=pose, observed_space=submap.observed_space)
        for i, (submap, pose) in enumerate(
            (submap, pose @ submap.world_from_submap)
            for snapshot, pose in zip(snapshots, world_from_map, strict=True)
            if pose is not None
            for submap in snapshot.submaps
        )
    )
