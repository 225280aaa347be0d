"""A random room of a family from a seed: a floor plan, lamps, and arrangements where they fit."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.worlds.clearance import is_inside
from hickory_stream.worlds.lighting import Lamp, Lighting
from hickory_stream.worlds.scene import Placement, World, at_place, numbered
from hickory_stream.worlds.support_placement import Wall
from hickory_stream.worlds.textures import Color
from tools.worlds.clutter.draws import count, log_uniform, one_of, uniform
from tools.worlds.clutter.floorplan import FloorPlan, floor_plan
from tools.worlds.clutter.footprints import do_overlap
from tools.worlds.clutter.groups import GROUPS, Group
from tools.worlds.clutter.kit import FAMILIES, kit_of


def random_lighting(rng: np.random.Generator, outline_m: NDArray[np.float64], height_m: float) -> Lighting:
    """Return one to four lamps within a room, some of them low, and matching ambient light."""
    number = count(rng, 1, 4)
    low, high = outline_m.min(axis=0), outline_m.max(axis=0)
    places = np.empty((1, number, 3))
    places[0, :, :2] = low + rng.uniform(0.05, 0.95, size=(number, 2)) * (high - low)
    places[0, :, 2] = rng.uniform(0.6, 0.97, size=number) * height_m
    level = log_uniform(rng, 0.5, 1.6)
    lamps = tuple(
        Lamp(
            color=_tone(rng, level * uniform(rng, 0.4, 1.2) / np.sqrt(number)),
            near=uniform(rng, 0.4, 1.0),
            far=uniform(rng, 0.02, 0.25),
            shadow=uniform(rng, 0.05, 0.6),
        )
        for _ in range(number)
    )
    ambient = uniform(rng, 0.15, 0.6)
    return Lighting(
        places_m=places, lamps=lamps, num_shadows=min(number, count(rng, 1, 2)), ambient=_tone(rng, ambient)
    )


def _tone(rng: np.random.Generator, level: float) -> Color:
    warm = float(rng.normal(0, 0.1))
    return level * (1 + warm), level, level * (1 - warm)


_DRAWS = 14
_MOST_THINGS = 220


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ClutterRoom:
    """A world and the plan of its one room."""

    world: World
    plan: FloorPlan


def clutter_room(seed: int, family: str, index: int = 0) -> ClutterRoom:
    """Return room number `index` of a seed and a family; raises `ConfigError` for an unknown family."""
    kit_seed = FAMILIES.index(family) if family in FAMILIES else 0
    rng = np.random.default_rng([seed, 21, kit_seed, index])
    kit = kit_of(rng, family)
    plan = floor_plan(rng, kit)
    x0, y0, x1, y1 = plan.bounds_m
    taken = list(plan.taken)
    placed: list[Placement] = []
    crowd = uniform(rng, 0.4, 1.5)
    for _ in range(int(6 + crowd * 0.7 * (x1 - x0) * (y1 - y0))):
        group = GROUPS[one_of(rng, kit.recipes.groups)](rng, kit)
        world_from_group = _place_for(rng, plan, group, taken)
        if world_from_group is not None and len(placed) + len(group.placed) <= _MOST_THINGS:
            placed += [
                Placement(model=one.model, world_from_object=world_from_group @ one.world_from_object)
                for one in group.placed
            ]
    middle = plan.outline_m.mean(axis=0)
    world = World(
        objects=numbered(placed), structure=plan.structure, rooms_m=(plan.bounds_m,),
        middle_m=(float(middle[0]), float(middle[1])), lighting=random_lighting(rng, plan.outline_m, plan.height_m),
    )  # fmt: skip
    return ClutterRoom(world=world, plan=plan)


def _place_for(
    rng: np.random.Generator, plan: FloorPlan, group: Group, taken: list[NDArray[np.float64]]
) -> NDArray[np.float64] | None:
    corners = group.corners()
    for _ in range(_DRAWS):
        pose = _at_wall(rng, one_of(rng, plan.walls), corners) if group.is_at_wall else _anywhere(rng, plan)
        outline = corners @ pose[:2, :2].T + pose[:2, 3]
        # The back of a thing at a wall keeps a small distance, so that the surfaces do not coincide.
        inner = (outline - outline.mean(axis=0)) * 0.999 + outline.mean(axis=0)
        if not is_inside(inner, plan.outline_m).all() or is_inside(plan.outline_m, inner).any():
            continue
        if any(do_overlap(outline, other) for other in taken):
            continue
        taken.append(outline)
        return pose
    return None


def _at_wall(rng: np.random.Generator, wall: Wall, corners: NDArray[np.float64]) -> NDArray[np.float64]:
    low, high = corners[:, 1].min(), corners[:, 1].max()
    least, most = -wall.half_m - low + 0.021, wall.half_m - high - 0.021
    along = uniform(rng, least, most) if least < most else (least + most) / 2
    if rng.random() < 0.25:
        along = one_of(rng, (least, most))
    return np.asarray(wall.world_from_wall @ at_place(0.021, along, 0.0, 0.0))


def _anywhere(rng: np.random.Generator, plan: FloorPlan) -> NDArray[np.float64]:
    x0, y0, x1, y1 = plan.bounds_m
    yaw = one_of(rng, (0.0, np.pi / 2, np.pi, -np.pi / 2)) + float(rng.normal(0, 0.1))
    if rng.random() < 0.3:
        yaw = uniform(rng, -np.pi, np.pi)
    return at_place(uniform(rng, x0, x1), uniform(rng, y0, y1), 0.0, yaw)
