"""Agreement of the observed spaces of submaps that a correction has moved over one another: the later one wins.

Free space of an earlier submap where a later one saw surface, or the other way round, is *outdated*: it stays in the
submap, but the map does not show it (`record_of_space`). Decisions about tracks do not use it. It is computed when
submaps are placed, and when one ends. Later submaps of one pose, which are most, are compared as one.
"""

from dataclasses import replace
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.arrays import read_only
from hickory_stream.geometry.lazy_arrays import Compressed, compressed, read_briefly, restored
from hickory_stream.geometry.rigid import apply, compose, invert
from hickory_stream.geometry.voxels import (
    are_near,
    bounds_of_keys,
    cell_of_key,
    first_not_below,
    key_of_point,
    sorted_unique,
    union,
)
from hickory_stream.mapping.entities.observed_space import SpaceState, Window, structure_of
from hickory_stream.mapping.entities.submaps import Submaps

# Voxels by which a centre may lie beside where it is sought.
_SLACK = 0.01


class Outline(NamedTuple):
    """What one or more submaps of one pose saw, as sorted voxels of `structure` and runs of free voxels.

    Runs are the key of the first voxel, then the key after the last one, in turn: a room has a twentieth as many.
    """

    structure: NDArray[np.int64]
    #: not kept of several submaps, which only contradict others
    free: NDArray[np.int64]
    #: free voxels with no structure of their submap beside them
    open: NDArray[np.int64]


def outline_of(space: SpaceState) -> Outline:
    """Return the outline of a space; kept compressed, since old spaces do not change."""
    if space not in _OUTLINES:
        with read_briefly(space):
            structure, free = structure_of(space), space.free
            is_open = ~are_near(structure, free)
            _OUTLINES[space] = [compressed(part) for part in (structure, _runs(free), _runs(free[is_open]))]
    return Outline(*(read_only(restored(part)) for part in _OUTLINES[space]))


_OUTLINES: WeakKeyDictionary[SpaceState, list[Compressed]] = WeakKeyDictionary()


def _runs(starts: NDArray[np.int64], stops: NDArray[np.int64] | None = None) -> NDArray[np.int64]:
    # The runs of what lies between starts and stops, or of voxels.
    starts, stops = (np.sort(ends, kind="stable") for ends in (starts, starts + 1 if stops is None else stops))
    # One begins, or ends, where as many have stopped as have begun.
    is_apart = starts[1:] > stops[:-1]
    begins, ends = (np.append(*parts)[: len(starts)] for parts in ((True, is_apart), (is_apart, True)))
    return np.stack([starts[begins], stops[ends]], axis=1).reshape(-1)


def _both(a: Outline, b: Outline) -> Outline:
    is_open = _runs(*(np.concatenate([a.open[side::2], b.open[side::2]]) for side in (0, 1)))
    return Outline(union(a.structure, b.structure), a.free[:0], is_open)


def agreed_after_placement(submaps: Submaps, before: Submaps) -> Submaps:
    """Return the submaps, just placed, with their outdated voxels; equal ones stay the same array as `before`."""
    if submaps.states[-1].outdated is None:
        return submaps
    states = list(submaps.states)
    later: dict[bytes, tuple[int, Outline]] = {}
    for state in reversed(submaps.states):
        own, place = outline_of(state.seen), state.world_from_submap.tobytes()
        poses = ((submaps.between(i, state.id), outline) for i, outline in later.values())
        found = [contradicted(own, outline, pose, state.seen.voxel_m) for pose, outline in poses]
        outdated, old = sorted_unique(np.concatenate([own.free[:0], *found])), before.states[state.id].outdated
        is_same = old is not None and np.array_equal(outdated, old)
        states[state.id] = replace(state, outdated=old if is_same else outdated)
        later[place] = (state.id, _both(own, later[place][1]) if place in later else own)
    return replace(submaps, states=tuple(states))


def agreed_after(submaps: Submaps, ended_id: int) -> Submaps:
    """Return the submaps after one has ended, which contradicts those before it."""
    ended = submaps.states[ended_id]
    if ended.outdated is None:
        return submaps
    states, later = list(submaps.states), outline_of(ended.seen)
    for state in states[:ended_id]:
        found = contradicted(outline_of(state.seen), later, submaps.between(ended_id, state.id), state.seen.voxel_m)
        if len(found):
            assert state.outdated is not None, "of a map that was corrected"
            states[state.id] = replace(state, outdated=union(state.outdated, found))
    return replace(submaps, states=tuple(states))


def contradicted(
    space: Outline, later: Outline, later_from_here: NDArray[np.float64], voxel_m: float
) -> NDArray[np.int64]:
    """Return the sorted voxels of a space that a later one contradicts; `later_from_here` (4, 4) is rigid.

    Its free voxels whose centre lies in structure, and its structure whose centre lies in open space: lattices differ.
    """
    ends = [bounds_of_keys(keys) for keys in (space.structure, space.free) if len(keys)]
    if not ends:
        return space.free
    # Only what the later one has seen where this one lies.
    low, high = np.array(ends).transpose(1, 0, 2)
    corners = np.where(list(np.ndindex(2, 2, 2)), high.max(axis=0) + 1, low.min(axis=0))
    columns = np.floor(apply(later_from_here, corners * voxel_m)[:, :2] / voxel_m).astype(int)
    around = Window(tuple((columns.min(axis=0) - 1).tolist()), tuple((columns.max(axis=0) + 2).tolist()))
    structure, gaps = (read_only(keys[around.part_of(keys)]) for keys in (later.structure, later.open))
    place, back = (read_only(later_from_here), voxel_m), invert(later_from_here)
    # A rotation that is given may be one to a thousandth only.
    back = compose(back, 2.0 * np.eye(4) - compose(later_from_here, back))
    filled = _filled(space.free, structure, read_only(back), *place)
    opened = _opened(space.structure, gaps, *place)
    return sorted_unique(np.concatenate([filled, opened]))


@kernel
def _there(key, there_from_here, voxel_m):
    # The key of the voxel there that holds the centre of a voxel.
    i, j, k = cell_of_key(key)
    # Centres are stored in single precision.
    x = np.float64(np.float32((i + 0.5) * voxel_m))
    y = np.float64(np.float32((j + 0.5) * voxel_m))
    z = np.float64(np.float32((k + 0.5) * voxel_m))
    m = there_from_here
    return key_of_point(
        x * m[0, 0] + y * m[0, 1] + z * m[0, 2] + m[0, 3],
        x * m[1, 0] + y * m[1, 1] + z * m[1, 2] + m[1, 3],
        x * m[2, 0] + y * m[2, 1] + z * m[2, 2] + m[2, 3],
        voxel_m,
    )


@kernel
def _opened(structure, gaps, there_from_here, voxel_m):
    # The voxels of structure whose centres lie in runs there.
    out, count, at = np.empty_like(structure), 0, np.int64(0)
    for key in structure:
        at = first_not_below(gaps, _there(key, there_from_here, voxel_m) + 1, at)
        if at & 1:
            out[count] = key
            count += 1
    return out[:count]


@kernel
def _filled(free, structure, here_from_there, there_from_here, voxel_m):
    # The voxels of runs whose centres lie in voxels of structure there: at most the eight corners of each. There are
    # fewer voxels of structure than free ones, so that the centres are sought near these.
    out, count, at = np.empty(8 * len(structure), dtype=np.int64), 0, np.int64(0)
    low, high = np.empty(3, dtype=np.int64), np.empty(3, dtype=np.int64)
    m = here_from_there
    for key in structure:
        i, j, k = cell_of_key(key)
        for axis in range(3):
            middle = (i + 0.5) * m[axis, 0] + (j + 0.5) * m[axis, 1] + (k + 0.5) * m[axis, 2] + m[axis, 3] / voxel_m
            reach = 0.5 * (abs(m[axis, 0]) + abs(m[axis, 1]) + abs(m[axis, 2])) + _SLACK
            low[axis] = np.int64(np.ceil(middle - 0.5 - reach))
            high[axis] = np.int64(np.floor(middle - 0.5 + reach))
        for x in range(low[0], high[0] + 1):
            for y in range(low[1], high[1] + 1):
                for z in range(low[2], high[2] + 1):
                    here = key_of_point((x + 0.5) * voxel_m, (y + 0.5) * voxel_m, (z + 0.5) * voxel_m, voxel_m)
                    at = first_not_below(free, here + 1, at)
                    if at & 1 and _there(here, there_from_here, voxel_m) == key:
                        out[count] = here
                        count += 1
    return out[:count]
