"""Agreement of the observed spaces of submaps that a correction has moved over one another: the later one wins.

Free space of an earlier submap where a later one saw surface, or the other way round, is *outdated*: it stays in the
submap, but the map does not show it (`submaps.record_of`). Decisions about tracks do not use it. It is computed when
submaps are placed, and when one ends.
"""

from collections import OrderedDict
from dataclasses import replace
from itertools import combinations
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.lazy_arrays import read_briefly
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.geometry.voxels import (
    bounds_of_keys,
    cells_of_keys,
    centers_of_keys,
    contains,
    contains_near,
    keys_of_cells,
    sorted_unique,
    union,
    within_bounds,
)
from hickory_stream.mapping.entities.observed_space import SpaceState, structure_of
from hickory_stream.mapping.entities.submaps import Submaps, SubmapState

# So many compared spaces are held at once; each takes a few megabytes.
_MOST_SPACES = 16


def agreed_after_placement(submaps: Submaps, before: Submaps) -> Submaps:
    """Return the submaps, just placed, with their outdated voxels; equal ones stay the same array as `before`."""
    if submaps.states[-1].outdated is None:
        return submaps
    states, spaces = list(submaps.states), _OwnSpaces(submaps)
    for earlier_id, later_id in combinations(range(len(states)), 2):
        if _may_meet(submaps, earlier_id, later_id):
            states[earlier_id] = _after(submaps, states[earlier_id], later_id, spaces)
    for i, (state, old) in enumerate(zip(states, before.states, strict=True)):
        if state.outdated is not None and old.outdated is not None and np.array_equal(state.outdated, old.outdated):
            states[i] = replace(state, outdated=old.outdated)
    return replace(submaps, states=tuple(states))


def agreed_after(submaps: Submaps, ended_id: int) -> Submaps:
    """Return the submaps after one has ended, which contradicts those before it."""
    if submaps.states[ended_id].outdated is None:
        return submaps
    spaces = _OwnSpaces(submaps)
    states = list(submaps.states)
    for state in states[:ended_id]:
        if _may_meet(submaps, state.id, ended_id):
            states[state.id] = _after(submaps, state, ended_id, spaces)
    return replace(submaps, states=tuple(states))


def contradicted(space: SpaceState, later: SpaceState, later_from_here: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the sorted voxels of a space that a later one contradicts; `later_from_here` (4, 4) is rigid."""
    # Structure is contradicted where its voxel's centre is free and no structure is beside it: the lattices differ.
    bounds = _bounds_of(later)
    if bounds is None:
        return np.empty(0, dtype=np.int64)
    # Only what lies where the later one has seen anything.
    low, high = (np.floor(m / space.voxel_m).astype(np.int64) for m in _turned(bounds, invert(later_from_here)))
    free, structure = (within_bounds(keys, low - 1, high + 1) for keys in (space.free, structure_of(space)))
    solid = structure_of(later)
    is_filled = contains(solid, _keys_there(free, space.voxel_m, later_from_here, later.voxel_m))
    there = _keys_there(structure, space.voxel_m, later_from_here, later.voxel_m)
    is_open = contains(later.free, there)
    is_open[is_open] = ~contains_near(solid, cells_of_keys(there[is_open]))
    return sorted_unique(np.concatenate([free[is_filled], structure[is_open]]))


# The lowest and the highest corner (3,) of a space, metres in its own frame.
_Bounds = tuple["NDArray[np.float64]", "NDArray[np.float64]"]


class _OwnSpaces:
    # The spaces seen in submaps, last used last: all of a building do not fit into memory.
    def __init__(self, submaps: Submaps) -> None:
        self._states = submaps.states
        self._spaces: OrderedDict[int, SpaceState] = OrderedDict()

    def of(self, submap_id: int) -> SpaceState:
        if submap_id not in self._spaces:
            with read_briefly(self._states[submap_id].seen):
                self._spaces[submap_id] = replace(self._states[submap_id].seen)
            if len(self._spaces) > _MOST_SPACES:
                self._spaces.popitem(last=False)
        self._spaces.move_to_end(submap_id)
        return self._spaces[submap_id]


def _bounds_of(space: SpaceState) -> _Bounds | None:
    parts = [bounds_of_keys(keys) for keys in (space.free, space.surface) if len(keys)]
    if not parts:
        return None
    low, high = np.min([low for low, _ in parts], axis=0), np.max([high for _, high in parts], axis=0)
    return low * space.voxel_m, (high + 1) * space.voxel_m


def _reach_of(state: SubmapState) -> _Bounds | None:
    if state.seen not in _REACH:
        with read_briefly(state.seen):
            _REACH[state.seen] = _bounds_of(state.seen)
    return _REACH[state.seen]


_REACH: WeakKeyDictionary[SpaceState, _Bounds | None] = WeakKeyDictionary()


def _turned(bounds: _Bounds, there_from_here: NDArray[np.float64]) -> _Bounds:
    corners = np.array([[bounds[pick >> axis & 1][axis] for axis in range(3)] for pick in range(8)])
    there = apply(there_from_here, corners)
    return there.min(axis=0), there.max(axis=0)


def _may_meet(submaps: Submaps, earlier_id: int, later_id: int) -> bool:
    # By bounds alone: in a building most submaps lie in other rooms.
    earlier, later = _reach_of(submaps.states[earlier_id]), _reach_of(submaps.states[later_id])
    if earlier is None or later is None:
        return False
    low, high = _turned(earlier, submaps.between(later_id, earlier_id))
    return bool((low <= later[1]).all() and (high >= later[0]).all())


# By an earlier and a later space: their relative pose as bytes, and what the later one contradicts there.
_ByLater = WeakKeyDictionary[SpaceState, tuple[bytes, NDArray[np.int64]]]
_FOUND: WeakKeyDictionary[SpaceState, _ByLater] = WeakKeyDictionary()


def _after(submaps: Submaps, state: SubmapState, later_id: int, spaces: _OwnSpaces) -> SubmapState:
    assert state.outdated is not None, "of a map that was corrected"
    later_from_here, later = submaps.between(later_id, state.id), submaps.states[later_id].seen
    known = _FOUND.setdefault(state.seen, WeakKeyDictionary())
    place = later_from_here.tobytes()
    if later not in known or known[later][0] != place:
        known[later] = place, contradicted(spaces.of(state.id), spaces.of(later_id), later_from_here)
    found = known[later][1]
    return state if len(found) == 0 else replace(state, outdated=union(state.outdated, found))


def _keys_there(
    keys: NDArray[np.int64], voxel_m: float, there_from_here: NDArray[np.float64], there_voxel_m: float
) -> NDArray[np.int64]:
    centers = apply(there_from_here, centers_of_keys(keys, voxel_m).astype(np.float64))
    return keys_of_cells(np.floor(centers / there_voxel_m))
