"""Agreement of the observed spaces of submaps that a correction has moved over one another: the later one wins.

Free space of an earlier submap where a later one saw surface, or the other way round, is *outdated*: it stays in the
submap, but the map does not show it (`submaps.record_of`). Decisions about tracks do not use it. It is computed when
submaps are placed, and when one ends.
"""

from dataclasses import replace
from itertools import combinations_with_replacement, product
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.arrays import read_only
from hickory_stream.geometry.lazy_arrays import read_briefly
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.geometry.voxels import (
    are_near,
    bounds_of_keys,
    cell_of_key,
    contains,
    key_of_point,
    sorted_unique,
    union,
)
from hickory_stream.mapping.entities.observed_space import SpaceState, structure_of
from hickory_stream.mapping.entities.submaps import Submaps, SubmapState

# Submaps are compared in blocks of so many: all spaces of a building do not fit into memory, each takes some megabytes.
_BLOCK = 8


def agreed_after_placement(submaps: Submaps, before: Submaps) -> Submaps:
    """Return the submaps, just placed, with their outdated voxels; equal ones stay the same array as `before`."""
    if submaps.states[-1].outdated is None:
        return submaps
    states = list(submaps.states)
    blocks = [range(i, min(i + _BLOCK, len(states))) for i in range(0, len(states), _BLOCK)]
    for earlier, later in combinations_with_replacement(blocks, 2):
        with read_briefly(*{states[i].seen for i in (*earlier, *later)}):
            for earlier_id, later_id in product(earlier, later):
                if earlier_id < later_id:
                    states[earlier_id] = _after(submaps, states[earlier_id], later_id)
    for i, (state, old) in enumerate(zip(states, before.states, strict=True)):
        if state.outdated is not None and old.outdated is not None and np.array_equal(state.outdated, old.outdated):
            states[i] = replace(state, outdated=old.outdated)
    return replace(submaps, states=tuple(states))


def agreed_after(submaps: Submaps, ended_id: int) -> Submaps:
    """Return the submaps after one has ended, which contradicts those before it."""
    ended = submaps.states[ended_id]
    if ended.outdated is None:
        return submaps
    states = list(submaps.states)
    for state in states[:ended_id]:
        with read_briefly(state.seen, ended.seen):
            states[state.id] = _after(submaps, state, ended_id)
    return replace(submaps, states=tuple(states))


def contradicted(space: SpaceState, later: SpaceState, later_from_here: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the sorted voxels of a space that a later one contradicts; `later_from_here` (4, 4) is rigid."""
    # Structure is contradicted where its voxel's centre is free and no structure is beside it: the lattices differ.
    bounds = _reach_of(later)
    if bounds is None:
        return np.empty(0, dtype=np.int64)
    # Only what lies where the later one has seen anything.
    low, high = (np.floor(m / space.voxel_m).astype(np.int64) for m in _turned(bounds, invert(later_from_here)))
    place, solid = (space.voxel_m, read_only(later_from_here), later.voxel_m), structure_of(later)
    free, there = _brought(read_only(space.free), low - 1, high + 1, *place)
    filled = free[contains(solid, there)]
    structure, there = _brought(read_only(structure_of(space)), low - 1, high + 1, *place)
    is_open = contains(later.free, there)
    is_open[is_open] = ~are_near(solid, there[is_open])
    return sorted_unique(np.concatenate([filled, structure[is_open]]))


@kernel
def _brought(keys, low, high, voxel_m, there_from_here, there_voxel_m):
    # The keys within bounds (3,), both included, and those of the voxels there that hold their centres.
    kept, there, count = np.empty_like(keys), np.empty_like(keys), 0
    for key in keys:
        i, j, k = cell_of_key(key)
        if low[0] <= i <= high[0] and low[1] <= j <= high[1] and low[2] <= k <= high[2]:
            # Centres are stored in single precision.
            x = np.float64(np.float32((i + 0.5) * voxel_m))
            y = np.float64(np.float32((j + 0.5) * voxel_m))
            z = np.float64(np.float32((k + 0.5) * voxel_m))
            m = there_from_here
            kept[count] = key
            there[count] = key_of_point(
                x * m[0, 0] + y * m[0, 1] + z * m[0, 2] + m[0, 3],
                x * m[1, 0] + y * m[1, 1] + z * m[1, 2] + m[1, 3],
                x * m[2, 0] + y * m[2, 1] + z * m[2, 2] + m[2, 3],
                there_voxel_m,
            )
            count += 1
    return kept[:count], there[:count]


# The lowest and the highest corner (3,) of a space, metres in its own frame.
_Bounds = tuple["NDArray[np.float64]", "NDArray[np.float64]"]


def _reach_of(space: SpaceState) -> _Bounds | None:
    if space not in _REACH:
        with read_briefly(space):
            parts = [bounds_of_keys(keys) for keys in (space.free, space.surface) if len(keys)]
        low, high = np.array(parts).reshape(-1, 2, 3).transpose(1, 0, 2)
        _REACH[space] = (low.min(axis=0) * space.voxel_m, (high.max(axis=0) + 1) * space.voxel_m) if parts else None
    return _REACH[space]


_REACH: WeakKeyDictionary[SpaceState, _Bounds | None] = WeakKeyDictionary()


def _turned(bounds: _Bounds, there_from_here: NDArray[np.float64]) -> _Bounds:
    corners = np.array([[bounds[pick >> axis & 1][axis] for axis in range(3)] for pick in range(8)])
    there = apply(there_from_here, corners)
    return there.min(axis=0), there.max(axis=0)


def _may_meet(submaps: Submaps, earlier_id: int, later_id: int) -> bool:
    # By bounds alone: in a building most submaps lie in other rooms.
    earlier, later = _reach_of(submaps.states[earlier_id].seen), _reach_of(submaps.states[later_id].seen)
    if earlier is None or later is None:
        return False
    low, high = _turned(earlier, submaps.between(later_id, earlier_id))
    return bool((low <= later[1]).all() and (high >= later[0]).all())


# By an earlier and a later space: their relative pose as bytes, and what the later one contradicts there.
_ByLater = WeakKeyDictionary[SpaceState, tuple[bytes, NDArray[np.int64]]]
_FOUND: WeakKeyDictionary[SpaceState, _ByLater] = WeakKeyDictionary()


def _after(submaps: Submaps, state: SubmapState, later_id: int) -> SubmapState:
    assert state.outdated is not None, "of a map that was corrected"
    if not _may_meet(submaps, state.id, later_id):
        return state
    later_from_here, later = submaps.between(later_id, state.id), submaps.states[later_id].seen
    known = _FOUND.setdefault(state.seen, WeakKeyDictionary())
    place = later_from_here.tobytes()
    if later not in known or known[later][0] != place:
        known[later] = place, contradicted(state.seen, later, later_from_here)
    found = known[later][1]
    return state if len(found) == 0 else replace(state, outdated=union(state.outdated, found))
