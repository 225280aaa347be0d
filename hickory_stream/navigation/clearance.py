"""Collision checks against the layer 4 of a map: points, distances, swept balls and boxes.

All answers are conservative: free is proven, a hit may be a near miss by a stated margin. An update of an object
changes only the blocks of the two-level grid that it overlaps.
"""

from collections.abc import Iterable
from enum import IntEnum
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.rigid import invert
from hickory_stream.geometry.superquadric import Superquadrics, world_bounds
from hickory_stream.geometry.voxels import contains, keys_of_points
from hickory_stream.navigation import kernels
from hickory_stream.navigation.sweep_kernels import sweep_states
from hickory_stream.records import ObjectShape, ObservedSpace, TrackedObject

_BLOCK_M = 0.8
# Padding around the objects, in blocks, so that an object that is added nearby needs no new grid.
_ROOM = 4
_MOST_BLOCKS = 20_000_000


class Answer(IntEnum):
    """The state of a place, in order of severity; `HIT_GENERATED`: in mostly completed, not observed, surface."""

    FREE = kernels.FREE
    UNKNOWN = kernels.UNKNOWN
    HIT_GENERATED = kernels.HIT_GENERATED
    HIT_SEEN = kernels.HIT_SEEN


def _seen_shares(shape: ObjectShape) -> NDArray[np.float64]:
    # A box around everything has the share of the whole object; boxes around residuals count as seen, the severe
    # answer.
    shares, count = np.asarray(shape.seen_share, dtype=np.float64), len(shape.inflated)
    if shape.containment.is_fallback or count < len(shares):
        return np.full(count, shares.mean())
    return np.concatenate([shares, np.ones(count - len(shares))])


class ClearanceScene:
    """The superquadrics of a scene, by object."""

    def __init__(self) -> None:
        self._rows: NDArray[np.float64] = np.empty((0, kernels.ROW))
        self._kinds = np.empty(0, np.uint8)
        self._rows_of: dict[int, list[int]] = {}
        self._free_rows: list[int] = []
        self._layout = np.array([0.0, 0.0, 0.0, _BLOCK_M])
        self._top = np.empty((0, 0, 0, 2), np.int32)
        self._bricks = np.empty((0, kernels.CELLS**3), np.int32)
        self._num_bricks = 0
        self._values = np.empty(0, np.int32)
        self._links = np.empty(0, np.int32)
        self._free_item, self._num_free = -1, 0
        self._space: ObservedSpace | None = None
        self._space_from_world = np.eye(4)

    @classmethod
    def of(cls, objects: Iterable[TrackedObject]) -> "ClearanceScene":
        """Return the scene of the objects that have a layer 4."""
        scene = cls()
        for tracked in objects:
            if tracked.shape is not None:
                scene.put(tracked.id, tracked.shape.inflated, _seen_shares(tracked.shape))
        return scene

    def rows(self, object_id: int | None = None) -> NDArray[np.float64]:
        """Return (N, ROW) the kernel rows of all primitives, or of one object's, ordered by object."""
        keys = sorted(self._rows_of) if object_id is None else [object_id]
        return np.asarray(self._rows[[row for key in keys for row in self._rows_of[key]]])

    def observe(self, space: ObservedSpace | None, world_from_space: NDArray[np.float64] | None = None) -> None:
        """Set the observed space: points outside its free space become UNKNOWN, points in its structure HIT_SEEN."""
        self._space = space
        self._space_from_world = np.eye(4) if world_from_space is None else invert(world_from_space)

    def put(self, object_id: int, inflated: Superquadrics, seen_share: NDArray[np.float64] | None = None) -> None:
        """Add or replace an object, of which primitives with `seen_share` (N,) of a half or no share count as seen.

        Raises:
            ValueError: a primitive is not finite.
        """
        rows = rows_of(inflated)
        if not np.isfinite(rows).all():
            raise ValueError(
                f"object {object_id} has a superquadric that is not finite: nothing can be checked with it"
            )
        self.remove(object_id)
        if len(rows) == 0:
            return
        seen = np.ones(len(rows), bool) if seen_share is None else np.asarray(seen_share) >= 0.5
        kinds = np.where(seen, np.uint8(kernels.HIT_SEEN), np.uint8(kernels.HIT_GENERATED))
        places = self._room_for_rows(len(rows))
        self._rows[places], self._kinds[places] = rows, kinds
        self._rows_of[object_id] = places
        if self._holds(rows):
            for place in places:
                self._insert(place)
        else:
            self._rebuild()

    def remove(self, object_id: int) -> None:
        """Remove an object; nothing happens where it is not there."""
        for place in self._rows_of.pop(object_id, []):
            self._free_item, released = kernels.removed(self._rows[place], place, *self._grid, self._free_item)
            self._num_free += released
            self._kinds[place] = kernels.FREE
            self._free_rows.append(place)

    def classify(self, points_world: NDArray[Any], *, is_parallel: bool = False) -> NDArray[np.uint8]:
        """Return (N,) the `Answer` at each of (N, 3) points."""
        points = np.ascontiguousarray(points_world, dtype=np.float64)
        kernel = kernels.point_states_parallel if is_parallel else kernels.point_states
        answers = np.asarray(kernel(points, self._rows, self._kinds, *self._grid))
        return answers if self._space is None else self._with_space(points, answers)

    def is_free(self, points_world: NDArray[Any], *, may_touch_generated: bool = False) -> NDArray[np.bool_]:
        """Return (N,) whether each of (N, 3) points is known to be free, optionally ignoring generated surface."""
        answers = self.classify(points_world)
        return (answers == Answer.FREE) | (may_touch_generated & (answers == Answer.HIT_GENERATED))

    def clearance_m(
        self, points_world: NDArray[Any], *, is_exact: bool = False, reach_m: float = 5.0
    ) -> NDArray[np.float64]:
        """Return (N,) distances to the nearest superquadric, at most `reach_m`, 0 inside: exact, or lower bounds."""
        points = np.ascontiguousarray(points_world, dtype=np.float64)
        layout, top, _, values, links = self._grid
        return np.asarray(kernels.clearances(points, self._rows, is_exact, reach_m, layout, top, values, links))

    def sweep(
        self,
        starts_world: NDArray[Any],
        ends_world: NDArray[Any],
        *,
        radius_m: float,
        half_extents_m: NDArray[np.float64] | None = None,
    ) -> NDArray[np.uint8]:
        """Return (N,) the `Answer` for a ball, or a rounded box, swept along (N, 3) straight segments.

        FREE is proven by a separating plane; a hit comes nearer than a tenth of a millimetre.
        """
        half = np.zeros(3) if half_extents_m is None else np.asarray(half_extents_m, dtype=np.float64)
        starts, ends = (np.ascontiguousarray(places, dtype=np.float64) for places in (starts_world, ends_world))
        layout, top, _, values, links = self._grid
        swept = (starts, ends, half, float(radius_m))
        return np.asarray(sweep_states(*swept, self._rows, self._kinds, layout, top, values, links))

    @property
    def _grid(self) -> tuple[NDArray[Any], ...]:
        return self._layout, self._top, self._bricks, self._values, self._links

    def _with_space(self, points: NDArray[np.float64], answers: NDArray[np.uint8]) -> NDArray[np.uint8]:
        assert self._space is not None
        local = points @ self._space_from_world[:3, :3].T + self._space_from_world[:3, 3]
        keys = keys_of_points(local, self._space.voxel_m)
        is_free, is_structure = contains(self._space.free, keys), contains(self._space.structure, keys)
        known = np.where(is_structure, np.uint8(Answer.HIT_SEEN), np.where(is_free, np.uint8(0), np.uint8(1)))
        return np.asarray(np.maximum(answers, known))

    def _holds(self, rows: NDArray[np.float64]) -> bool:
        low, high = rows[:, kernels.LOW : kernels.LOW + 3], rows[:, kernels.HIGH : kernels.HIGH + 3]
        end = self._layout[:3] + self._layout[3] * np.array(self._top.shape[:3])
        return self._top.size > 0 and bool((low >= self._layout[:3]).all() and (high < end).all())

    def _rebuild(self) -> None:
        used = [place for places in self._rows_of.values() for place in places]
        low = self._rows[used, kernels.LOW : kernels.LOW + 3].min(axis=0)
        high = self._rows[used, kernels.HIGH : kernels.HIGH + 3].max(axis=0)
        # A scene of kilometres gets coarser blocks rather than endless memory.
        side = max(_BLOCK_M, float(np.prod((high - low) / _MOST_BLOCKS ** (1 / 3) + 1e-9)) ** (1 / 3))
        shape = np.floor((high - low) / side).astype(np.int64) + 1 + 2 * _ROOM
        self._layout = np.array([*(low - _ROOM * side), side])
        self._top = np.full((*shape, 2), -1, np.int32)
        self._bricks = np.full((64, kernels.CELLS**3), -1, np.int32)
        self._num_bricks = 0
        self._values, self._links = np.empty(0, np.int32), np.empty(0, np.int32)
        self._free_item, self._num_free = -1, 0
        for place in used:
            self._insert(place)

    def _insert(self, place: int) -> None:
        blocks = kernels.blocks_of(self._rows[place], self._layout, self._top.shape[:3])
        self._room_for_bricks(blocks)
        self._room_for_items(len(blocks) * (kernels.CELLS**3 + 1))
        self._free_item, used = kernels.inserted(self._rows[place], place, *self._grid, self._free_item)
        self._num_free -= used

    def _room_for_rows(self, count: int) -> list[int]:
        missing = count - len(self._free_rows)
        if missing > 0:
            first = len(self._rows)
            more = max(missing, first)
            self._rows = np.concatenate([self._rows, np.zeros((more, kernels.ROW))])
            self._kinds = np.concatenate([self._kinds, np.zeros(more, np.uint8)])
            self._free_rows += range(first + more - 1, first - 1, -1)
        return [self._free_rows.pop() for _ in range(count)]

    def _room_for_bricks(self, blocks: NDArray[np.int64]) -> None:
        for i, j, k in blocks[self._top[(*blocks.T, 0)] < 0]:
            if self._num_bricks == len(self._bricks):
                self._bricks = np.concatenate([self._bricks, np.full_like(self._bricks, -1)])
            self._top[i, j, k, 0] = self._num_bricks
            self._num_bricks += 1

    def _room_for_items(self, count: int) -> None:
        if count <= self._num_free:
            return
        first = len(self._links)
        more = max(count, first, 4096)
        chain = np.arange(first + 1, first + more + 1, dtype=np.int32)
        chain[-1] = self._free_item
        self._links = np.concatenate([self._links, chain])
        self._values = np.concatenate([self._values, np.zeros(more, np.int32)])
        self._free_item, self._num_free = first, self._num_free + more


@lru_cache(maxsize=256)
def rows_of(primitives: Superquadrics) -> NDArray[np.float64]:
    """Return (N, ROW) the numbers that the kernels need of each primitive."""
    rows = np.zeros((len(primitives), kernels.ROW))
    if len(rows) == 0:
        return rows
    bounds = world_bounds(primitives)
    e1, e2 = primitives.exponents.T
    rows[:, kernels.CENTER : kernels.CENTER + 3] = primitives.world_from_local[:, :3, 3]
    rows[:, kernels.ROTATION : kernels.ROTATION + 9] = primitives.world_from_local[:, :3, :3].reshape(-1, 9)
    rows[:, kernels.AXES : kernels.AXES + 3] = primitives.semi_axes_m
    # Rounded, so that the kernels recognise the exponents 2 and 20 and can use fast paths.
    rows[:, kernels.POWER_1], rows[:, kernels.POWER_2] = np.round(2 / e1, 12), np.round(2 / e2, 12)
    rows[:, kernels.RATIO], rows[:, kernels.GAUGE] = e2 / e1, e1 / 2
    # Slightly enlarged: rounding must not exclude a surface point.
    room = 1e-9 * (1 + np.abs(bounds).max(axis=(1, 2)))[:, None]
    rows[:, kernels.LOW : kernels.LOW + 3] = bounds[:, 0] - room
    rows[:, kernels.HIGH : kernels.HIGH + 3] = bounds[:, 1] + room
    return rows
