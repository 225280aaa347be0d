"""The configuration space of a robot, for every posture and range of headings: the grids that a planner searches.

Places outside of the grid, and unobserved ones, are blocked, unless unknown space is declared free.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from hickory_stream.errors import InputError
from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.geometry.superquadric import Superquadrics
from hickory_stream.geometry.voxels import bounds_of_keys
from hickory_stream.navigation.clearance import ClearanceScene
from hickory_stream.navigation.observed import Band, seen_columns, unknown_hulls
from hickory_stream.navigation.occupancy import Cell, GridFrame, Occupancy, distance_field_m, frame_around
from hickory_stream.navigation.robot import Part, Robot, raised, turned
from hickory_stream.navigation.stand_ins import (
    MARGIN_M,
    SEEN_SURFACE,
    Obstacle,
    SeenSurface,
    box_as_superquadric,
    early_obstacles,
)
from hickory_stream.records import MapSnapshot, Phase, TrackedObject
from hickory_stream.storeys import floor_of, on_storey

CELL_M = 0.033
UnknownSpace = Literal["blocked", "free"]
_NARROW_CELLS = 3.0
_GROUP = 256
_FEW_HEADINGS = 0.4


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class HullGroup:
    """Consecutive hulls (N, M, 3), their bounds `lows`, `highs` (N, 2), and the bounds `low`, `high` (2,) of all."""

    hulls: NDArray[np.float64]
    lows: NDArray[np.float64]
    highs: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]

    @classmethod
    def of(cls, hulls: NDArray[np.float64]) -> "HullGroup":
        """Return the group of these hulls."""
        lows, highs = hulls[..., :2].min(axis=1), hulls[..., :2].max(axis=1)
        return cls(hulls=hulls, lows=lows, highs=highs, low=lows.min(axis=0), high=highs.max(axis=0))


class FreeSpace:
    """The cells of a robot, layer by layer, and their obstacles; only hulls are grown by `hull_margin_m`."""

    def __init__(self, robot: Robot, frame: GridFrame, floor_z_m: float, *, hull_margin_m: float = 0.0) -> None:
        self.robot = robot
        self.frame = frame
        self.floor_z_m = floor_z_m
        self.hull_margin_m = hull_margin_m
        self.scene = ClearanceScene()
        self.walls: NDArray[np.float64] = np.empty((0, 8, 3))
        self.unknown: NDArray[np.float64] = np.empty((0, 8, 3))
        self.hulls: dict[int, NDArray[np.float64]] = {}
        self.observed_only: frozenset[int] = frozenset()
        """Objects for which a provisional shape is avoided, until they have a layer 4."""
        range_rad = 2 * np.pi / robot.num_headings
        self.parts = [
            [
                tuple(turned(raised(part, floor_z_m), robot.heading_rad(k), range_rad) for part in posture.parts)
                for k in range(robot.num_headings)
            ]
            for posture in robot.postures
        ]
        self.layers = [
            [Occupancy(frame, parts, hull_margin_m=hull_margin_m) for parts in headings] for headings in self.parts
        ]
        self._blocked: NDArray[np.bool_] | None = None
        self._groups: list[HullGroup] | None = None
        self._labels: NDArray[np.int32] | None = None
        self._reachable: dict[tuple[int, ...], tuple[NDArray[np.int64], NDArray[np.int64]]] = {}

    def put(self, object_id: int, inflated: Superquadrics) -> None:
        """Add or replace an object; raises ValueError if a primitive is not finite."""
        self._forget()
        self.scene.put(object_id, inflated)
        for layer in self.all_layers():
            layer.put(object_id, inflated)

    def put_hulls(self, object_id: int, hulls: NDArray[np.float64]) -> None:
        """Add an object that is the union of the convex hulls of (N, M, 3) points, or replace what it was."""
        self._forget()
        self.hulls[object_id] = hulls
        for layer in self.all_layers():
            layer.put_hulls(object_id, hulls)

    def remove(self, object_id: int) -> None:
        """Remove an object; nothing happens where it is not there."""
        self._forget()
        self.scene.remove(object_id)
        self.hulls.pop(object_id, None)
        for layer in self.all_layers():
            layer.remove(object_id)

    def observe(self, walls: NDArray[np.float64], unknown: NDArray[np.float64]) -> None:
        """Replace structure and unobserved space by hulls of (N, M, 3) and (K, 8, 3) corners."""
        self._forget()
        self.walls, self.unknown = walls, unknown
        for layer in self.all_layers():
            layer.observe(walls, unknown)

    def blocked(self) -> NDArray[np.bool_]:
        """Return (postures, headings, rows, columns) which cells are blocked for the robot."""
        if self._blocked is None:
            self._blocked = np.stack(
                [np.stack([layer.states() != Cell.FREE for layer in headings]) for headings in self.layers]
            )
            self._blocked.flags.writeable = False
        return self._blocked

    def labels(self) -> NDArray[np.int32]:
        """Return (postures, headings, rows, columns): 0 where blocked, else a number per connected piece of free space.

        Headings do not limit directions here: two places in different pieces are surely not connected.
        """
        if self._labels is None:
            self._labels = _connected(~self.blocked())
        return self._labels

    def hull_groups(self) -> list[HullGroup]:
        """Return all hulls, walls and the unknown among them, in groups with their bounds."""
        if self._groups is None:
            sources = [self.walls, self.unknown, *(self.hulls[i] for i in sorted(self.hulls))]
            self._groups = [
                HullGroup.of(hulls[first : first + _GROUP])
                for hulls in sources
                for first in range(0, len(hulls), _GROUP)
            ]
        return self._groups

    def reachable_cells(self, place_cells: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return rows and columns (N, 2) of the cells connected with a place (in cells), and those of narrow ones.

        Narrow cells lie beside a blocked cell, or allow few headings: uniform samples are rare there, but needed.
        """
        labels = self.labels()
        column, row = np.floor(place_cells).astype(np.int64)
        key = tuple(sorted({int(piece) for piece in labels[:, :, row, column].ravel() if piece}))
        if key not in self._reachable:
            layers = np.isin(labels, key)
            inside = np.asarray(layers.any(axis=(0, 1)))
            is_beside = distance_field_m(~inside, 1.0) <= _NARROW_CELLS
            is_rare = layers[0].mean(axis=0) < _FEW_HEADINGS
            self._reachable[key] = (
                np.argwhere(inside),
                np.argwhere(inside & (is_rare if self.robot.num_headings > 1 else is_beside)),
            )
        return self._reachable[key]

    def _forget(self) -> None:
        self._blocked = self._labels = None
        self._reachable = {}
        self._groups = None

    @property
    def heights_m(self) -> tuple[float, float]:
        """The lowest and the highest height of the robot, over all postures."""
        parts = [part for headings in self.parts for parts in headings for part in parts]
        return min(part.low_m - part.ball_m for part in parts), max(part.high_m + part.ball_m for part in parts)

    def all_layers(self) -> list[Occupancy]:
        """Return the layers of all postures and headings."""
        return [layer for headings in self.layers for layer in headings]


def free_space_of(
    snapshot: MapSnapshot,
    robot: Robot,
    *,
    cell_m: float = CELL_M,
    unknown: UnknownSpace = "blocked",
    seen: SeenSurface | None = None,
    floor_m: float | None = None,
) -> FreeSpace:
    """Return the free space of one storey of a map, for a robot: at `floor_m`, else the most observed one.

    With `seen`, the surface observed in a live run, objects without a layer 4 have provisional shapes.

    Raises:
        InputError: the map is empty, the robot does not fit into it, or the grid would take too much memory.
    """
    floor_m = floor_of(snapshot) if floor_m is None else floor_m
    snapshot = on_storey(snapshot, floor_m)
    obstacles = bodies_of(snapshot, early=seen is not None)
    low, high = extent_of(snapshot, obstacles)
    layers = len(robot.postures) * robot.num_headings
    frame = frame_around(low, high, cell_m, num_layers=layers)
    room_m = float(np.min(high - low))
    if 2 * robot.reach_m > room_m and room_m < 1e9:
        raise InputError(
            f"the robot {robot.name} reaches {robot.reach_m:.2f} m from its middle; the map is only {room_m:.2f} m wide"
        )
    space = FreeSpace(robot, frame, floor_m)
    for obstacle in obstacles:
        space.put(obstacle.id, obstacle.body)
    space.observed_only = frozenset(obstacle.id for obstacle in obstacles if obstacle.is_observed_only)
    # One height band for all layers: which cells were observed must not depend on the posture.
    low_m, high_m = space.heights_m
    band = Band(low_m=low_m, high_m=high_m)
    columns = seen_columns(snapshot.submaps, frame, band, space.floor_z_m)
    dark = unknown_hulls(columns.is_known, frame, band) if unknown == "blocked" else np.empty((0, 8, 3))
    space.observe(columns.walls, dark)
    if seen is not None:
        space.put_hulls(SEEN_SURFACE, seen.hulls(snapshot, obstacles, band, space.floor_z_m))
    return space


def obstacle_grid(snapshot: MapSnapshot, robot: Robot, *, cell_m: float, floor_m: float | None = None) -> Occupancy:
    """Return the cells with an obstacle to any posture of a robot, without its footprint, for other planners.

    Raises:
        InputError: the map is empty, or the grid would take too much memory.
    """
    floor = floor_of(snapshot) if floor_m is None else floor_m
    snapshot = on_storey(snapshot, floor)
    obstacles = bodies_of(snapshot)
    low, high = extent_of(snapshot, obstacles)
    frame = frame_around(low, high, cell_m)
    low_m, high_m = robot.heights_m
    part = Part(low_m=floor + low_m, high_m=floor + high_m)
    grid = Occupancy(frame, [part])
    for obstacle in obstacles:
        grid.put(obstacle.id, obstacle.body)
    band = Band(low_m=part.low_m, high_m=part.high_m)
    seen = seen_columns(snapshot.submaps, frame, band, floor)
    grid.observe(seen.walls, unknown_hulls(seen.is_known, frame, band))
    return grid


def obstacles_of(snapshot: MapSnapshot) -> list[TrackedObject]:
    """Return the objects that count as obstacles: all but tentative ones."""
    return [tracked for tracked in snapshot.objects if tracked.phase is not Phase.TENTATIVE]


def bodies_of(snapshot: MapSnapshot, *, early: bool = False) -> list[Obstacle]:
    """Return the volumes of the obstacles, sorted by id; `early`: with provisional shapes for those without layer 4."""
    if early:
        return early_obstacles(snapshot.objects)
    return [
        Obstacle(id=tracked.id, body=layer_four_of(tracked), is_observed_only=False)
        for tracked in obstacles_of(snapshot)
    ]


def without_layer_four(snapshot: MapSnapshot) -> list[int]:
    """Return the ids of the obstacles that are represented by their box, since they have no layer 4."""
    return [
        tracked.id
        for tracked in obstacles_of(snapshot)
        if tracked.shape is None or len(tracked.shape.inflated) == 0 or tracked.shape.containment.is_fallback
    ]


def uncertified(snapshot: MapSnapshot) -> list[int]:
    """Return the ids of the obstacles whose layer 4, by its own record, is not proven to contain them."""
    return [
        tracked.id
        for tracked in obstacles_of(snapshot)
        if tracked.shape is not None and len(tracked.shape.inflated) and not tracked.shape.containment.is_certified
    ]


def layer_four_of(tracked: TrackedObject) -> Superquadrics:
    """Return the inflated superquadrics of an object, or one around its box and a margin of 2 cm."""
    if tracked.shape is not None and len(tracked.shape.inflated):
        return tracked.shape.inflated
    return box_as_superquadric(tracked.box, MARGIN_M)


def extent_of(snapshot: MapSnapshot, obstacles: Sequence[Obstacle]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the low and high corner (2,) of the observed space and all obstacles.

    Raises:
        InputError: there is neither observed space nor an obstacle, or the corners are not finite.
    """
    places = [np.empty((0, 2))]
    for submap in snapshot.submaps:
        space = submap.observed_space
        ends = [bounds_of_keys(keys) for keys in (space.free, space.structure) if len(keys)]
        if ends:
            low = np.min([low for low, _ in ends], axis=0) * space.voxel_m
            high = (np.max([high for _, high in ends], axis=0) + 1) * space.voxel_m
            corners = np.array([[x, y, 0.0] for x in (low[0], high[0]) for y in (low[1], high[1])])
            world = corners @ submap.world_from_submap[:3, :3].T + submap.world_from_submap[:3, 3]
            places.append(world[:, :2])
    bounds = [obstacle.bounds.reshape(-1, 3)[:, :2] for obstacle in obstacles]
    found = np.concatenate([*places, *bounds])
    if len(found) == 0:
        raise InputError("the map is empty: it has neither objects nor observed space to plan in")
    if not np.isfinite(found).all():
        raise InputError("the map holds places that are not finite; nothing can be planned in it")
    return found.min(axis=0), found.max(axis=0)


def _connected(is_free: NDArray[np.bool_]) -> NDArray[np.int32]:
    # (P, H, R, C) free cells; the last heading is beside the first one.
    sides = np.zeros((3, 3, 3, 3), bool)
    sides[1, 1, 1], sides[1, 1, :, 1], sides[1, :, 1, 1] = True, True, True
    pieces, count = label(is_free, structure=sides)
    postures, headings = is_free.shape[:2]
    seams = [(pieces[p], pieces[q]) for p in range(postures) for q in range(p)]
    seams += [(pieces[:, 0], pieces[:, -1])] if headings > 1 else []
    pairs = [_touching_pairs(first, second) for first, second in seams]
    a, b = np.concatenate([np.empty((2, 0), np.int64), *pairs], axis=1)
    graph = coo_array((np.ones(len(a), bool), (a, b)), shape=(count + 1, count + 1))
    _, merged = connected_components(graph, directed=False)
    # Blocked cells are the component that touches no other one: it gets the number 0.
    numbers = np.where(merged == merged[0], 0, merged + 1).astype(np.int32)
    return np.asarray(numbers[pieces])


def _touching_pairs(first: NDArray[np.int32], second: NDArray[np.int32]) -> NDArray[np.int64]:
    both = (first > 0) & (second > 0)
    count = int(second.max(initial=0)) + 1
    # As one number each: pairs take ten times as long to sort.
    pairs = np.unique(first[both].astype(np.int64) * count + second[both])
    return np.stack(np.divmod(pairs, count))


# Farther from the object's box than this, beyond its own reach, a robot does not stand beside it.
_BESIDE_M = 0.6


def place_beside(space: FreeSpace, start: NDArray[np.float64], box: OrientedBox) -> NDArray[np.float64] | None:
    """Return the place (2,) nearest to an object that is connected with `start` (2,), None if none is near.

    A path to it is likely, but not proven: a robot that is no disc has to turn.
    """
    frame = space.frame
    cells, _ = space.reachable_cells((start - frame.origin_m) / frame.cell_m)
    if not len(cells):
        return None
    places = frame.origin_m + (cells[:, ::-1] + 0.5) * frame.cell_m
    local = apply(invert(box.world_from_box), np.column_stack([places, np.full(len(places), box.center[2])]))
    away = np.linalg.norm(np.maximum(np.abs(local[:, :2]) - box.half_extents_m[:2], 0.0), axis=1)
    rounds = np.floor(away / frame.cell_m)
    best = int(np.lexsort((np.linalg.norm(places - start, axis=1), rounds))[0])
    return places[best] if away[best] <= space.robot.reach_m + _BESIDE_M else None
