"""The observed spaces of submaps that a correction has moved over one another agree: the later one wins.

Once a correction has moved any submap, each shows what was seen in it, where it lies now. Where an earlier one has free
space and a later one has seen surface, or the other way round, something has changed, or one lies slightly off: what
the earlier one says there is *outdated*. It stays in the submap, and is left out of what the map shows
(`submaps.record_of`): what navigation, alignment and everybody else reads. Decisions about tracks are made against the
submaps alone that are rigid with the open one.

It is brought up to date when submaps are placed and when one ends. With a placement it is taken back.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary, ref

import numpy as np

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
from hickory_stream.mapping.entities.observed_space import structure_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.mapping.entities.observed_space import SpaceState
    from hickory_stream.mapping.entities.submaps import Submaps, SubmapState

_MOST_SPACES = 16
"""So many spaces that are compared are held at once; each takes a few megabytes."""


def agreed_anew(submaps: Submaps, before: Submaps) -> Submaps:
    """Return the submaps, just placed, with what is outdated of each, if a correction has moved any.

    Of a submap of which the same is outdated as `before` the placement it stays the same array.
    """
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
    """Return the submaps after one has ended: what it has seen counts against those before it."""
    if submaps.states[ended_id].outdated is None:
        return submaps
    spaces = _OwnSpaces(submaps)
    before = [
        _after(submaps, state, ended_id, spaces) if _may_meet(submaps, state.id, ended_id) else state
        for state in submaps.states[:ended_id]
    ]
    return replace(submaps, states=(*before, *submaps.states[ended_id:]))


def contradicted(space: SpaceState, later: SpaceState, later_from_here: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the sorted voxels of a space of which a later one says otherwise; `later_from_here` (4, 4) is rigid.

    Structure is contradicted where its voxel's centre is free and no structure is beside it: the lattices differ.
    """
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


_Bounds = tuple["NDArray[np.float64]", "NDArray[np.float64]"]
"""The lowest and the highest corner (3,) of a space, metres in its own frame."""


class _OwnSpaces:
    """The spaces that were seen in submaps, those that were asked for last: of a building not all fit into memory."""

    def __init__(self, submaps: Submaps) -> None:
        self._states = submaps.states
        self._spaces: OrderedDict[int, SpaceState] = OrderedDict()

    def of(self, submap_id: int) -> SpaceState:
        """Return the space of a submap, all of it in memory."""
        if submap_id not in self._spaces:
            state = self._states[submap_id]
            with read_briefly(state.seen, state.space):
                self._spaces[submap_id] = replace(state.seen, room=state.space.room)
            if len(self._spaces) > _MOST_SPACES:
                self._spaces.popitem(last=False)
        self._spaces.move_to_end(submap_id)
        return self._spaces[submap_id]


def _bounds_of(space: SpaceState, *more: NDArray[np.int64]) -> _Bounds | None:
    """Return the bounds of what was seen, and of more keys, None where there is nothing."""
    parts = [bounds_of_keys(keys) for keys in (space.free, space.surface, space.room, *more) if len(keys)]
    if not parts:
        return None
    low, high = np.min([low for low, _ in parts], axis=0), np.max([high for _, high in parts], axis=0)
    return low * space.voxel_m, (high + 1) * space.voxel_m


def _reach_of(state: SubmapState) -> _Bounds | None:
    """Return bounds that hold all that was seen in a submap; remembered, since those that have ended stay the same."""
    known = _REACH.get(state.seen)
    if known is None or known[0]() is not state.space:
        with read_briefly(state.seen, state.space):
            _REACH[state.seen] = known = ref(state.space), _bounds_of(state.seen, state.space.room)
    return known[1]


_REACH: WeakKeyDictionary[SpaceState, tuple[ref[SpaceState], _Bounds | None]] = WeakKeyDictionary()


def _turned(bounds: _Bounds, there_from_here: NDArray[np.float64]) -> _Bounds:
    """Return the bounds, in another frame, of a box."""
    corners = np.array([[bounds[pick >> axis & 1][axis] for axis in range(3)] for pick in range(8)])
    there = apply(there_from_here, corners)
    return there.min(axis=0), there.max(axis=0)


def _may_meet(submaps: Submaps, earlier_id: int, later_id: int) -> bool:
    """Return whether two submaps have seen the same place, as far as their bounds in the later one's frame tell.

    In a building most submaps lie in other rooms.
    """
    earlier, later = _reach_of(submaps.states[earlier_id]), _reach_of(submaps.states[later_id])
    if earlier is None or later is None:
        return False
    low, high = _turned(earlier, submaps.between(later_id, earlier_id))
    return bool((low <= later[1]).all() and (high >= later[0]).all())


def _after(submaps: Submaps, state: SubmapState, later_id: int, spaces: _OwnSpaces) -> SubmapState:
    """Return a submap with what a later one says otherwise."""
    assert state.outdated is not None, "of a map that was corrected"
    found = contradicted(spaces.of(state.id), spaces.of(later_id), submaps.between(later_id, state.id))
    return state if len(found) == 0 else replace(state, outdated=union(state.outdated, found))


def _keys_there(
    keys: NDArray[np.int64], voxel_m: float, there_from_here: NDArray[np.float64], there_voxel_m: float
) -> NDArray[np.int64]:
    """Return (N,) the voxels of another lattice in which the centres of voxels lie."""
    centers = apply(there_from_here, centers_of_keys(keys, voxel_m).astype(np.float64))
    return keys_of_cells(np.floor(centers / there_voxel_m))
