"""Submaps: parts of the map that can be moved rigidly, each with its share of the observed space.

An object, like a voxel, belongs to the submap in which it was first seen. All data stay in the odometry frame: a
correction only sets the pose of each submap, which is applied when the map is published. So no shape is recomputed,
and without corrections the published data are the original ones, to the byte.

A submap ends after a length of the camera's path, when the floor becomes that of another storey, or when the odometry
jumps. An end by path length only changes which submap owns new objects and voxels: checks against the observed space
use everything seen since the last jump.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry import portable
from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.voxels import contains, places
from hickory_stream.mapping import observed_space
from hickory_stream.mapping.observed_space import (
    SpaceState,
    add,
    as_record,
    empty_space,
    false_floor,
    is_another_storey,
    without_level,
)
from hickory_stream.ranges import Ranged, number
from hickory_stream.records import SpaceObservation, Submap

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, slots=True)
class SubmapConfig(Ranged):
    """When a submap ends (besides jumps of the odometry): after `travel_m` of the camera's path."""

    travel_m: float = number(15.0, 0.01, 1e6, "m")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SubmapState:
    """A submap: `space` is the part of the observed space that it owns; `world_from_submap` is its corrected pose.

    The frame of a submap is the odometry frame: `world_from_submap` is the identity until it is corrected.
    """

    id: int
    world_from_submap: NDArray[np.float64]
    space: SpaceState

    def __post_init__(self) -> None:
        freeze(self, "world_from_submap", np.float64, (4, 4))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Submaps:
    """All submaps, the last of which is open, and the `space` seen since the last jump of the odometry.

    Tracks are checked against `space`. `first` is the id of the first submap since that jump. `owned` (N,) are the
    sorted keys of the voxels of closed submaps, `owners` (N,) the id of the submap that owns each. `way_m` is the
    length of the camera's path in the open submap, up to the position `last_world` (3,), which is None before the first
    keyframe and after a jump.
    """

    states: tuple[SubmapState, ...]
    space: SpaceState
    first: int = 0
    owned: NDArray[np.int64]
    owners: NDArray[np.int32]
    way_m: float = 0.0
    last_world: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        freeze(self, "owned", np.int64, (None,))
        freeze(self, "owners", np.int32, (len(self.owned),))
        if self.last_world is not None:
            freeze(self, "last_world", np.float64, (3,))

    @property
    def open_id(self) -> int:
        """The id of the open submap, which owns new objects."""
        return len(self.states) - 1

    def world_from(self, submap_id: int) -> NDArray[np.float64]:
        """Return the pose of a submap: world_from_submap (4, 4)."""
        return self.states[submap_id].world_from_submap


def first_submap(voxel_m: float) -> Submaps:
    """Return one open, empty submap."""
    space = empty_space(voxel_m)
    state = SubmapState(id=0, world_from_submap=np.eye(4), space=space)
    return Submaps(states=(state,), space=space, owned=np.empty(0, np.int64), owners=np.empty(0, np.int32))


def travelled(submaps: Submaps, place_world: NDArray[np.float64], config: SubmapConfig) -> Submaps:
    """Return the submaps after the camera has moved to (3,); a new one is opened after `travel_m` of its path."""
    step_m = 0.0 if submaps.last_world is None else portable.norm(place_world - submaps.last_world)
    way_m = submaps.way_m + step_m
    if way_m < config.travel_m:
        return replace(submaps, way_m=way_m, last_world=place_world)
    return replace(_opened(_closed(submaps)), way_m=0.0, last_world=place_world)


def interrupted(submaps: Submaps) -> Submaps:
    """Return the submaps after a jump of the stamps: the way to the next camera position does not count as path."""
    return replace(submaps, last_world=None)


def torn(submaps: Submaps) -> Submaps:
    """Return the submaps after a jump of the odometry: a new one is opened, and the observed space starts empty.

    If the open submap has no keyframe yet, it stays open instead.
    """
    if submaps.last_world is None and submaps.way_m == 0.0 and not _has_space(submaps.states[-1].space):
        return submaps
    empty = empty_space(submaps.space.voxel_m)
    alone = replace(
        submaps,
        space=empty,
        first=submaps.open_id + 1,
        owned=np.empty(0, np.int64),
        owners=np.empty(0, np.int32),
        way_m=0.0,
        last_world=None,
    )
    return _opened(alone)


def with_seen(submaps: Submaps, seen: SpaceObservation) -> Submaps:
    """Return the submaps after one more keyframe; a new one is opened on another storey, since each has one floor."""
    false_m = false_floor(submaps.space, seen.floor_z_m)
    if false_m is None and is_another_storey(submaps.space, seen.floor_z_m):
        submaps = replace(_opened(_closed(submaps)), way_m=0.0)
    if submaps.first == submaps.open_id:
        return _alone(submaps, add(submaps.space, seen))
    if false_m is not None:
        # Structure at the height of the false floor is withdrawn in all submaps since the last jump.
        kept, open_ones = submaps.states[: submaps.first], submaps.states[submaps.first :]
        without = tuple(replace(state, space=without_level(state.space, false_m)) for state in open_ones)
        submaps = replace(submaps, states=(*kept, *without))
    space = add(submaps.space, seen)
    free, structure = _by_owner(submaps, seen.free_keys), _by_owner(submaps, seen.structure_keys)
    surface = _by_owner(submaps, seen.surface_keys)
    none = np.empty(0, np.int64)
    changed = {
        i: add(
            submaps.states[i].space,
            SpaceObservation(
                free_keys=free.get(i, none),
                structure_keys=structure.get(i, none),
                surface_keys=surface.get(i, none),
                floor_z_m=None,
            ),
        )
        for i in sorted(free.keys() | structure.keys() | surface.keys())
    }
    return _with_spaces(submaps, space, changed)


def with_room(submaps: Submaps, keys: NDArray[np.int64]) -> Submaps:
    """Return the submaps where these sorted voxels belong to tracks that are part of the room (since the last jump)."""
    if np.array_equal(submaps.space.room, keys):
        return submaps
    space = observed_space.with_room(submaps.space, keys)
    if submaps.first == submaps.open_id:
        return _alone(submaps, space)
    owners = _owners(submaps, keys)
    spaces = {
        i: observed_space.with_room(submaps.states[i].space, keys[owners == i])
        for i in range(submaps.first, submaps.open_id + 1)
    }
    return _with_spaces(submaps, space, {i: own for i, own in spaces.items() if own is not submaps.states[i].space})


def placed_at(submaps: Submaps, world_from_submap: Mapping[int, NDArray[np.float64]]) -> Submaps:
    """Return the submaps with some of their poses corrected.

    Raises:
        ValueError: there is no such submap.
    """
    unknown = sorted(world_from_submap.keys() - {state.id for state in submaps.states})
    if unknown:
        raise ValueError(f"there is no submap {unknown[0]}; the map has 0 to {submaps.open_id}")
    states = tuple(
        replace(state, world_from_submap=world_from_submap[state.id]) if state.id in world_from_submap else state
        for state in submaps.states
    )
    return replace(submaps, states=states)


def record_of(state: SubmapState) -> Submap:
    """Return the public record of a submap."""
    return Submap(id=state.id, world_from_submap=state.world_from_submap, observed_space=as_record(state.space))


# ---- the steps ------------------------------------------------------------------------------------------------------


def _closed(submaps: Submaps) -> Submaps:
    """Return the submaps with the voxels of the open one assigned to it permanently."""
    space = submaps.states[-1].space
    keys = np.union1d(np.union1d(space.free, space.surface), space.room)
    owned = np.concatenate([submaps.owned, keys])
    owners = np.concatenate([submaps.owners, np.full(len(keys), submaps.open_id, dtype=np.int32)])
    order = np.argsort(owned, kind="stable")
    return replace(submaps, owned=owned[order], owners=owners[order])


def _opened(submaps: Submaps) -> Submaps:
    """Return the submaps with a new open one at the pose of the last one."""
    last = submaps.states[-1]
    space = replace(empty_space(submaps.space.voxel_m), floor_z_m=submaps.space.floor_z_m)
    state = SubmapState(id=last.id + 1, world_from_submap=last.world_from_submap, space=space)
    return replace(submaps, states=(*submaps.states, state))


def _alone(submaps: Submaps, space: SpaceState) -> Submaps:
    """Return the submaps if only the open one exists since the last jump: its space is the space since the jump."""
    return replace(submaps, space=space, states=(*submaps.states[:-1], replace(submaps.states[-1], space=space)))


def _with_spaces(submaps: Submaps, space: SpaceState, changed: Mapping[int, SpaceState]) -> Submaps:
    states = list(submaps.states)
    for i, own in changed.items():
        states[i] = replace(states[i], space=own)
    # Only the open submap follows the current floor: closed ones keep the floor that was seen in them.
    last = states[-1]
    states[-1] = replace(last, space=replace(last.space, floor_z_m=space.floor_z_m))
    return replace(submaps, space=space, states=tuple(states))


def _has_space(space: SpaceState) -> bool:
    return len(space.free) + len(space.surface) > 0


def _owners(submaps: Submaps, keys: NDArray[np.int64]) -> NDArray[np.int32]:
    """Return (N,) the id of the submap that owns each voxel; new voxels belong to the open one."""
    owners = np.full(len(keys), submaps.open_id, dtype=np.int32)
    is_owned = contains(submaps.owned, keys)
    owners[is_owned] = submaps.owners[places(submaps.owned, keys[is_owned])]
    return owners


def _by_owner(submaps: Submaps, keys: NDArray[np.int64]) -> dict[int, NDArray[np.int64]]:
    owners = _owners(submaps, keys)
    return {i: keys[owners == i] for i in _named(owners)}


def _named(owners: NDArray[np.int32]) -> list[int]:
    """Return the distinct ids of the owners, ascending."""
    return list(np.flatnonzero(np.bincount(owners)).tolist())
