"""Simulated maps of many robots, each of one part of a large place: which of them overlap is known."""

from dataclasses import dataclass

import numpy as np

from hickory_stream.alignment.object_map import ObjectMap
from tools.evaluation.simulated_maps.simulate import Difficulty, SimulatedWorld, random_pose

_AREA_PER_OBJECT_M2, _HEIGHT_M = 2.5, 1.5


@dataclass(frozen=True, kw_only=True, slots=True)
class FleetMapsConfig:
    """`num_maps` of about `num_objects` each, each of a square at a random place."""

    # The place is so large that a map overlaps about `overlaps` others; `seen` is the share of the objects there that a
    # robot has found.
    num_maps: int = 20
    num_objects: int = 40
    overlaps: float = 4.0
    seen: float = 0.7
    difficulty: Difficulty = "hard"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FleetMaps:
    """The maps, and how many objects each two (a, b), a < b, have in common, where they have any."""

    maps: tuple[ObjectMap, ...]
    common: dict[tuple[int, int], int]


def simulate_fleet(config: FleetMapsConfig, seed: int) -> FleetMaps:
    rng = np.random.default_rng([seed, 9])
    world = SimulatedWorld(config.difficulty, rng)
    side = float(np.sqrt(_AREA_PER_OBJECT_M2 * config.num_objects / config.seen))
    # Two squares of side s at random in one of side S touch with a chance of about (2 s / S)^2.
    whole = max(side, 2 * side * float(np.sqrt((config.num_maps - 1) / config.overlaps)))
    total = round((whole + side) ** 2 / _AREA_PER_OBJECT_M2)
    places = rng.uniform([0, 0, 0], [whole + side, whole + side, _HEIGHT_M], (total, 3))
    objects = [world.new_object(place) for place in places]
    maps, seen = [], []
    for low in rng.uniform(0, whole, (config.num_maps, 2)):
        inside = ((places[:, :2] >= low) & (places[:, :2] < low + side)).all(axis=1)
        found = rng.permutation(np.flatnonzero(inside & (rng.random(total) < config.seen)))
        maps.append(world.observe([objects[i] for i in found], random_pose(0.0, side, rng)))
        seen.append(set(found.tolist()))
    common = {
        (a, b): len(seen[a] & seen[b]) for a in range(len(seen)) for b in range(a + 1, len(seen)) if seen[a] & seen[b]
    }
    return FleetMaps(maps=tuple(maps), common=common)
