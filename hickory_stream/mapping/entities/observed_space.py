"""The observed space: free voxels and voxels of structure, as sorted keys, and the rule that finds columns of walls."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import scipy
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.arrays import check_array, read_only
from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.geometry.lazy_arrays import GivesUpArrays, read_briefly
from hickory_stream.geometry.voxels import (
    cells_of_keys,
    centers_of_keys,
    contains,
    difference,
    exchanged,
    first_not_below,
    keys_of_cells,
    keys_of_points,
    row_of_key,
    rows_of_keys,
    sorted_unique,
    union,
)
from hickory_stream.records import ObservedSpace, SpaceObservation
from hickory_stream.storeys import STOREY_M

# The height above a level up to which a column is examined, and the minimum share of it along which a column of a wall
# has structure: the rest may be unobserved.
WALL_M = 0.6
_WALL_SHARE = 0.5


def column_starts(cells: NDArray[Any]) -> NDArray[np.int64]:
    """Return the index at which each column begins in (N, 3) voxels that are sorted by x, y, z, like keys."""
    if len(cells) == 0:
        return np.empty(0, dtype=np.int64)
    return np.flatnonzero(np.append(True, (cells[1:, :2] != cells[:-1, :2]).any(axis=1)))


def column_sizes(starts: NDArray[np.int64], num_voxels: int) -> NDArray[np.int64]:
    """Return the number of voxels in each column."""
    return np.diff(np.append(starts, num_voxels))


def is_wall_column(num_structure: NDArray[np.int64], voxel_m: float) -> NDArray[np.bool_]:
    """Return which columns belong to a wall, from their numbers of structure voxels within `WALL_M` above a level."""
    return num_structure * voxel_m >= _WALL_SHARE * WALL_M


# So many hits are sure structure or surface.
SURE_HITS = 2
# When a count reaches this, both counts of the voxel are halved, so that later keyframes can still outvote it.
_MOST_VOTES = 240
# A surface that lies this much lower is not a step of the floor: the presumed floor was a table, unless it is as large
# as this area.
_NO_STEP_M, _NO_TABLE_M2 = 0.3, 6.0
# The range of voxel indices.
_FAR = 1 << 20


@dataclass(frozen=True, slots=True)
class Window:
    """A part of the world of all heights: the cells of voxels from `low` to below `high`, along x and y."""

    low: tuple[int, int]
    high: tuple[int, int]

    def holds(self, other: "Window") -> bool:
        """Return whether another window lies within this one."""
        return all(a <= b and d <= c for a, b, c, d in zip(self.low, other.low, self.high, other.high, strict=True))

    def meets(self, other: "Window") -> bool:
        """Return whether the two have cells in common."""
        return all(a < d and b < c for a, b, c, d in zip(self.low, other.low, self.high, other.high, strict=True))

    def wider(self, cells: int) -> "Window":
        """Return the window that reaches so many cells further on each side."""
        (x0, y0), (x1, y1) = self.low, self.high
        return Window((x0 - cells, y0 - cells), (x1 + cells, y1 + cells))

    def part_of(self, keys: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the indices of the sorted keys within the window."""
        columns = _columns_between(keys, self.low[0], self.high[0])
        return np.asarray(_rows_between(read_only(keys), columns.start, columns.stop, self.low[1], self.high[1]))


@kernel
def _rows_between(keys, start, stop, low, high):
    out, count = np.empty(stop - start, dtype=np.int64), 0
    for i in range(start, stop):
        if low <= row_of_key(keys[i]) < high:
            out[count] = i
            count += 1
    return out[:count]


def window_of(*sorted_keys: NDArray[np.int64]) -> Window | None:
    """Return the least window that holds all voxels of these sorted keys; None if there are none."""
    some = [keys for keys in sorted_keys if len(keys)]
    if not some:
        return None
    ends = np.concatenate([cells_of_keys(keys[[0, -1]])[:, 0] for keys in some])
    rows = np.concatenate([[rows.min(), rows.max()] for rows in map(rows_of_keys, some)])
    return Window((int(ends.min()), int(rows.min())), (int(ends.max()) + 1, int(rows.max()) + 1))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, weakref_slot=True)
class SpaceState(GivesUpArrays):
    """The voxels with an observed surface, and the free voxels, as sorted keys; compressed when far away.

    A voxel of `surface` is structure if it has at least two hits, and more hits than misses.
    """

    voxel_m: float
    free: NDArray[np.int64]
    #: free voxels that have become structure; structure is never in `free`
    hidden_free: NDArray[np.int64]
    surface: NDArray[np.int64]
    #: keyframes that showed the voxel as structure, without the map prior
    hits: NDArray[np.uint8]
    #: keyframes that showed the voxel as something else
    misses: NDArray[np.uint8]
    floor_z_m: float | None = None

    def __post_init__(self) -> None:
        # Looked at, not copied: a keyframe makes many of them. Kernels walk the votes beside the surface.
        for name in ("free", "hidden_free", "surface"):
            check_array(self, name, np.int64, (None,))
        for name in ("hits", "misses"):
            check_array(self, name, np.uint8, (len(self.surface),))

    @property
    def is_structure(self) -> NDArray[np.bool_]:
        """Which voxels of `surface` are structure."""
        return _is_structure(self.hits, self.misses)


def _is_structure(hits: NDArray[np.uint8], misses: NDArray[np.uint8]) -> NDArray[np.bool_]:
    return (hits >= SURE_HITS) & (hits > misses)


def empty_space(voxel_m: float) -> SpaceState:
    """Return an empty observed space."""
    none, votes = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.uint8)
    return SpaceState(voxel_m=voxel_m, free=none, hidden_free=none, surface=none, hits=votes, misses=votes)


def add(state: SpaceState, seen: SpaceObservation) -> SpaceState:
    """Return the whole space after one more keyframe; its floor is filtered, but a drop takes effect at once."""
    return added(state, seen, false_floor(state, seen.floor_z_m))


def added(state: SpaceState, seen: SpaceObservation, false_m: float | None) -> SpaceState:
    """Return a part of the space after one more keyframe; `false_m`: the height of a refuted floor."""
    if false_m is not None:
        state = _without_level(state, false_m)
    voters = union(seen.structure_keys, seen.surface_keys)
    surface, hits, misses, change = _voted(state.surface, state.hits, state.misses, voters, seen.structure_keys)
    gained, lost = voters[change > 0], voters[change < 0]
    state = replace(state, surface=surface, hits=hits, misses=misses, floor_z_m=_floor(state.floor_z_m, seen.floor_z_m))
    is_hidden = structure_hits(state, seen.free_keys) >= SURE_HITS
    # Voxels that have just become structure are no longer free, and rays that graze structure do not make it free.
    bared = lost[contains(state.hidden_free, lost)]
    hidden = union(gained[contains(state.free, gained)], seen.free_keys[is_hidden])
    free = exchanged(state.free, gained, union(seen.free_keys[~is_hidden], bared))
    # Read-only, so that the records of the map share it: it is the largest thing in a map.
    free.flags.writeable = False
    return replace(state, free=free, hidden_free=exchanged(state.hidden_free, lost, hidden))


def joined(spaces: Sequence[SpaceState]) -> SpaceState:
    """Return the union of spaces (at least one) on one lattice: votes add up, and the last one gives the floor."""
    if len(spaces) == 1:
        return spaces[0]
    keys, at = np.unique(np.concatenate([space.surface for space in spaces]), return_inverse=True)
    all_hits, all_misses = np.zeros(len(keys), np.int64), np.zeros(len(keys), np.int64)
    np.add.at(all_hits, at, np.concatenate([space.hits for space in spaces]))
    np.add.at(all_misses, at, np.concatenate([space.misses for space in spaces]))
    share = np.maximum((np.maximum(all_hits, all_misses) + _MOST_VOTES) // (_MOST_VOTES + 1), 1)
    hits, misses = (all_hits // share).astype(np.uint8), (all_misses // share).astype(np.uint8)
    structure = keys[_is_structure(hits, misses)]
    passed = sorted_unique(np.concatenate([part for space in spaces for part in (space.free, space.hidden_free)]))
    is_hidden = contains(structure, passed)
    free = passed[~is_hidden]
    free.flags.writeable = False
    return SpaceState(
        voxel_m=spaces[-1].voxel_m,
        free=free,
        hidden_free=passed[is_hidden],
        surface=keys,
        hits=hits,
        misses=misses,
        floor_z_m=spaces[-1].floor_z_m,
    )


def extent(state: SpaceState) -> Window | None:
    """Return the least window that holds a space, None if it is empty; cached, since old spaces do not change."""
    if state not in _EXTENTS:
        with read_briefly(state):
            _EXTENTS[state] = window_of(state.free, state.surface)
    return _EXTENTS[state]


_EXTENTS: WeakKeyDictionary[SpaceState, Window | None] = WeakKeyDictionary()


def cut(state: SpaceState, window: Window) -> SpaceState:
    """Return the part of a space within a window."""
    voters = window.part_of(state.surface)
    return replace(
        state,
        free=state.free[window.part_of(state.free)],
        hidden_free=state.hidden_free[window.part_of(state.hidden_free)],
        surface=state.surface[voters],
        hits=state.hits[voters],
        misses=state.misses[voters],
    )


def false_floor(state: SpaceState, seen_m: float | None) -> float | None:
    """Return the height of the presumed floor if a floor seen at `seen_m` refutes it, else None."""
    # It is refuted if the new floor is too far below it for a step, but not a storey, and it is no larger than a table.
    known_m = state.floor_z_m
    if known_m is None or seen_m is None or not _NO_STEP_M < known_m - seen_m < STOREY_M:
        return None
    level = state.surface[_is_level_at(state, known_m) & state.is_structure]
    columns = np.unique(cells_of_keys(level)[:, :2], axis=0)
    return known_m if len(columns) * state.voxel_m * state.voxel_m < _NO_TABLE_M2 else None


def floor_change(state: SpaceState, seen_m: float | None, false_m: float | None) -> str | None:
    """Return a message if a floor seen at `seen_m` replaces the known one, else None; `false_m`: see `false_floor`."""
    known_m = state.floor_z_m
    if known_m is None or seen_m is None:
        return None
    if false_m is not None:
        return (
            f"a floor is seen at {seen_m:.2f} m: what was taken for it, at {false_m:.2f} m, is a table or the like, "
            "and what was concluded from it is withdrawn"
        )
    if is_another_storey(state, seen_m):
        return f"the floor is now at {seen_m:.2f} m, before at {known_m:.2f} m: another storey"
    return None


def is_another_storey(state: SpaceState, seen_m: float | None) -> bool:
    """Return whether the floor seen at `seen_m` belongs to another storey."""
    known_m = state.floor_z_m
    return known_m is not None and seen_m is not None and abs(seen_m - known_m) > STOREY_M / 2


def without_floor(state: SpaceState, false_m: float, seen_m: float | None) -> SpaceState:
    """Return the space without a false floor, a table; the floor seen below replaces it."""
    was_taken = state.floor_z_m is not None and abs(state.floor_z_m - false_m) < _NO_STEP_M
    return replace(_without_level(state, false_m), floor_z_m=seen_m if was_taken else state.floor_z_m)


def _without_level(state: SpaceState, z_m: float) -> SpaceState:
    at = _is_level_at(state, z_m)
    lost = state.surface[at & state.is_structure]
    bared = lost[contains(state.hidden_free, lost)]
    return replace(
        state,
        free=union(state.free, bared),
        hidden_free=difference(state.hidden_free, bared),
        hits=np.where(at, 0, state.hits).astype(np.uint8),
        misses=np.where(at, 0, state.misses).astype(np.uint8),
    )


def _is_level_at(state: SpaceState, z_m: float) -> NDArray[np.bool_]:
    # Voxels of `surface` within one voxel of a height, except in columns of walls.
    cells = cells_of_keys(state.surface)
    above_m = (cells[:, 2] + 0.5) * state.voxel_m - z_m
    near = np.flatnonzero((above_m > -1.5 * state.voxel_m) & (above_m < WALL_M))
    if len(near) == 0:
        return np.zeros(len(cells), dtype=bool)
    starts = column_starts(cells[near])
    heights = np.add.reduceat(state.is_structure[near].astype(np.int64), starts)
    is_wall = np.repeat(is_wall_column(heights, state.voxel_m), column_sizes(starts, len(near)))
    out = np.zeros(len(cells), dtype=bool)
    out[near] = ~is_wall & (above_m[near] < 1.5 * state.voxel_m)
    return out


@kernel
def _voted(surface, hits, misses, voters, structure):
    # Surface, hits and misses with one vote more for each voter, all sorted, in one walk; voters in `structure` are
    # hits. `change`: 1 for each voter that has become structure, -1 for one that no longer is.
    most = len(surface) + len(voters)
    keys, change = np.empty(most, dtype=np.int64), np.zeros(len(voters), dtype=np.int8)
    all_hits, all_misses = np.empty(most, dtype=np.uint8), np.empty(most, dtype=np.uint8)
    i, n, at = 0, 0, 0
    for j in range(len(voters)):
        place = first_not_below(surface, voters[j], i)
        for k in range(place - i):
            keys[n + k], all_hits[n + k], all_misses[n + k] = surface[i + k], hits[i + k], misses[i + k]
        n += place - i
        i = place
        is_known = i < len(surface) and surface[i] == voters[j]
        num_hits, num_misses = (np.int64(hits[i]), np.int64(misses[i])) if is_known else (np.int64(0), np.int64(0))
        i += is_known
        before = num_hits >= SURE_HITS and num_hits > num_misses
        at = first_not_below(structure, voters[j], at)
        if at < len(structure) and structure[at] == voters[j]:
            num_hits += 1
        else:
            num_misses += 1
        if max(num_hits, num_misses) >= _MOST_VOTES:
            num_hits, num_misses = num_hits // 2, num_misses // 2
        now = num_hits >= SURE_HITS and num_hits > num_misses
        change[j] = np.int8(now) - np.int8(before)
        keys[n], all_hits[n], all_misses[n] = voters[j], num_hits, num_misses
        n += 1
    for k in range(len(surface) - i):
        keys[n + k], all_hits[n + k], all_misses[n + k] = surface[i + k], hits[i + k], misses[i + k]
    n += len(surface) - i
    return keys[:n].copy(), all_hits[:n].copy(), all_misses[:n].copy(), change


def structure_hits(state: SpaceState, keys: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Return (N,) the keyframes that saw each voxel as structure; 0 if misses outnumber hits."""
    sure = np.flatnonzero(state.hits > state.misses)
    surface, out = state.surface[sure], np.zeros(len(keys), dtype=np.uint8)
    found = np.flatnonzero(contains(surface, keys))
    out[found] = state.hits[sure[np.searchsorted(surface, keys[found])]]
    return out


def share_in(keys: NDArray[np.int64], points: NDArray[np.float32], voxel_m: float) -> float:
    """Return the share of (N, 3) points in voxels of sorted keys, from a sample of about 200."""
    sample = points[:: max(1, len(points) // 200)]
    return np.count_nonzero(contains(keys, keys_of_points(sample, voxel_m))) / len(sample)


def sees_structure(state: SpaceState, box: OrientedBox, points: NDArray[np.float32], reach_m: float) -> bool:
    """Return whether structure lies within `reach_m` of at least a tenth of an object's (N, 3) points."""
    centers = _structure_around(state, box, reach_m)
    if len(centers) == 0:
        return False
    tree, sample = scipy.spatial.cKDTree(centers), points[:: max(1, len(points) // 400)]
    distances_m, _ = tree.query(sample, distance_upper_bound=reach_m)
    return float(np.isfinite(distances_m).mean()) > 0.1


def _structure_around(state: SpaceState, box: OrientedBox, reach_m: float) -> NDArray[np.float32]:
    x = box.corners_world()[:, 0]
    low = int(np.floor((x.min() - reach_m) / state.voxel_m))
    high = int(np.floor((x.max() + reach_m) / state.voxel_m)) + 1
    near = _columns_between(state.surface, low, high)
    is_structure = _is_structure(state.hits[near], state.misses[near])
    return centers_of_keys(state.surface[near][is_structure], state.voxel_m)


def _columns_between(keys: NDArray[np.int64], low: int, high: int) -> slice:
    ends = np.array([[low, -_FAR, -_FAR], [high, -_FAR, -_FAR]])
    first, last = np.searchsorted(keys, keys_of_cells(np.clip(ends, -_FAR, _FAR - 1)))
    return slice(int(first), int(last))


def as_record(state: SpaceState) -> ObservedSpace:
    """Return the public record."""
    return ObservedSpace(
        voxel_m=state.voxel_m, free=state.free, structure=structure_of(state), floor_z_m=state.floor_z_m
    )


def structure_of(state: SpaceState) -> NDArray[np.int64]:
    """Return the sorted voxels of structure."""
    return state.surface[state.is_structure]


def known_space(record: ObservedSpace) -> SpaceState:
    """Return the space of a public record; its structure counts as certain, since records have no votes."""
    structure = record.structure
    return replace(
        empty_space(record.voxel_m),
        free=record.free,
        surface=structure,
        hits=np.full(len(structure), SURE_HITS, dtype=np.uint8),
        misses=np.zeros(len(structure), dtype=np.uint8),
        floor_z_m=record.floor_z_m,
    )


def _floor(known_m: float | None, seen_m: float | None) -> float | None:
    if known_m is None or seen_m is None:
        return known_m if seen_m is None else seen_m
    is_another = seen_m < known_m - 0.06 or seen_m > known_m + STOREY_M / 2
    return seen_m if is_another else 0.8 * known_m + 0.2 * seen_m
