"""Seeded pairs of maps of places that look alike: symmetric rooms, rows of like chairs, and buildings of like rooms."""
# Copies share shape and descriptor but for noise. `breaking` objects tell the true alignment; a place with none cannot
# be decided, two or more decide it.

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.rigid import from_rotation_translation, yaw_rotation
from tools.evaluation.simulated_maps.simulate import (
    Difficulty,
    SimulatedObject,
    SimulatedPair,
    SimulatedWorld,
    random_pose,
)

AmbiguousKind = Literal["symmetric", "repeated", "identical-rooms", "different-rooms"]

_AREA_PER_OBJECT_M2, _HEIGHT_M = 2.5, 1.5
_WALL_M = 0.5


@dataclass(frozen=True, kw_only=True, slots=True)
class AmbiguousConfig:
    """One pair of maps of a place that looks alike."""

    # `symmetric`: equal after 360 / `order` degrees. `repeated`: a grid of like chairs, a shifted part in each map.
    # `identical-rooms`: `num_rooms` rooms in each map, none in both, or one where rooms have `breaking` objects.
    # `different-rooms`: all differ, one is in both. `jitter_m` on each level axis; `seen`: share in a map.
    kind: AmbiguousKind
    num_objects: int = 24
    order: int = 2
    num_rooms: int = 2
    breaking: int = 0
    jitter_m: float = 0.0
    difficulty: Difficulty = "easy"
    tilt_deg: float = 0.0
    seen: float = 1.0

    @property
    def is_decidable(self) -> bool:
        """Whether enough is there to tell the true alignment from the others."""
        return self.breaking >= 2 or self.kind == "different-rooms"


Corner = tuple[float, float]


def uniform(
    world: SimulatedWorld, rng: np.random.Generator, count: int, low_m: Corner, high_m: Corner
) -> list[SimulatedObject]:
    places = rng.uniform([*low_m, 0.0], [*high_m, _HEIGHT_M], (count, 3))
    return [world.new_object(place) for place in places]


Draw = Callable[[SimulatedWorld, np.random.Generator, int, Corner, Corner], list[SimulatedObject]]
"""Returns so many objects in a rectangle, between its lower and higher corner; at the corner where it is a point."""


def simulate_ambiguous(config: AmbiguousConfig, seed: int, draw: Draw = uniform) -> SimulatedPair:
    """Return two maps of one place, the same for the same seed; `common` is empty where they share nothing."""
    # `draw` says how the place is furnished before things of it are repeated.
    rng = np.random.default_rng([seed, 9])
    place = _Place(world=SimulatedWorld(config.difficulty, rng), rng=rng, jitter_m=config.jitter_m, draw=draw)
    objects, in_a, in_b = _PLACES[config.kind](place, config)
    seen_a = rng.permutation(np.flatnonzero(in_a & (rng.random(len(objects)) < config.seen)))
    seen_b = rng.permutation(np.flatnonzero(in_b & (rng.random(len(objects)) < config.seen)))
    reach_m = float(np.ptp([item.place[:2] for item in objects], axis=0).max())
    a_from_world, b_from_world = random_pose(config.tilt_deg, reach_m, rng), random_pose(0.0, reach_m, rng)
    return place.world.pair(objects, seen_a, seen_b, a_from_world, b_from_world)


@dataclass(frozen=True, kw_only=True, slots=True)
class _Place:
    world: SimulatedWorld
    rng: np.random.Generator
    jitter_m: float
    draw: Draw

    def drawn(self, count: int, low_m: Corner, high_m: Corner) -> list[SimulatedObject]:
        return self.draw(self.world, self.rng, count, low_m, high_m) if count else []

    def copies(self, objects: list[SimulatedObject], there_from_here: NDArray[np.float64]) -> list[SimulatedObject]:
        copied = []
        for item in objects:
            off = np.array([*self.rng.normal(0.0, self.jitter_m, 2), 0.0])
            copied.append(item.moved(from_rotation_translation(np.eye(3), off) @ there_from_here))
        return copied


_Seen = tuple[list["SimulatedObject"], "NDArray[np.bool_]", "NDArray[np.bool_]"]


def _symmetric(place: _Place, config: AmbiguousConfig) -> _Seen:
    half_m = float(np.sqrt(_AREA_PER_OBJECT_M2 * config.num_objects)) / 2
    low = (0.2, -half_m) if config.order == 2 else (0.2, 0.2)
    wedge = place.drawn(config.num_objects // config.order, low, (half_m, half_m))
    objects = []
    for i in range(config.order):
        turned = yaw_rotation(2 * np.pi * i / config.order)
        objects += place.copies(wedge, from_rotation_translation(turned, np.zeros(3)))
    objects += place.drawn(config.breaking, (-half_m, -half_m), (half_m, half_m))
    everywhere = np.ones(len(objects), dtype=bool)
    return objects, everywhere, everywhere


def _repeated(place: _Place, config: AmbiguousConfig) -> _Seen:
    side = int(np.ceil(np.sqrt(config.num_objects)))
    pitch_m = place.rng.uniform(0.8, 1.6, 2)
    shift = place.rng.integers(-2, 3, 2)
    shift[0] = shift[0] or 1
    chair = place.drawn(1, (0.0, 0.0), (0.0, 0.0))
    objects, in_a, in_b = [], [], []
    for cell in np.ndindex(side + abs(int(shift[0])), side + abs(int(shift[1]))):
        at = np.array(cell) * pitch_m
        objects += place.copies(chair, from_rotation_translation(np.eye(3), np.array([*at, 0.0])))
        # Window a begins at the low end, unless the shift is to that side.
        start_a, start_b = np.maximum(-shift, 0), np.maximum(shift, 0)
        in_a.append(bool(((np.array(cell) >= start_a) & (np.array(cell) < start_a + side)).all()))
        in_b.append(bool(((np.array(cell) >= start_b) & (np.array(cell) < start_b + side)).all()))
    low, high = np.abs(shift) * pitch_m, (side - 1) * pitch_m
    objects += place.drawn(config.breaking, (low[0], low[1]), (high[0], high[1]))
    return objects, np.array(in_a + [True] * config.breaking), np.array(in_b + [True] * config.breaking)


def _rooms(place: _Place, config: AmbiguousConfig) -> _Seen:
    side_m = float(np.sqrt(_AREA_PER_OBJECT_M2 * config.num_objects))
    are_alike = config.kind == "identical-rooms"
    shared = 0 if are_alike and not config.breaking else 1
    total = 2 * config.num_rooms - shared
    furniture = place.drawn(config.num_objects, (0.0, 0.0), (side_m, side_m))
    objects, rooms = [], []
    for room in range(total):
        x = room * (side_m + _WALL_M)
        there_from_here = from_rotation_translation(np.eye(3), np.array([x, 0.0, 0.0]))
        if are_alike:
            inside = place.copies(furniture, there_from_here)
            inside += place.drawn(config.breaking, (x, 0.0), (x + side_m, side_m))
        else:
            inside = place.drawn(config.num_objects, (x, 0.0), (x + side_m, side_m))
        objects += inside
        rooms += [room] * len(inside)
    of = np.array(rooms)
    return objects, of < config.num_rooms, of >= config.num_rooms - shared


_PLACES = {"symmetric": _symmetric, "repeated": _repeated, "identical-rooms": _rooms, "different-rooms": _rooms}
