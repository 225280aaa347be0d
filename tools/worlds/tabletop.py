"""A table in a small room with many small things on it, and a camera that circles it."""

from collections.abc import Callable

import numpy as np

from hickory_stream.errors import ConfigError
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.worlds import furniture, small_things
from hickory_stream.worlds.object_models import Model, Surface
from hickory_stream.worlds.room import room_structure
from hickory_stream.worlds.scene import Placement, World, at_place, numbered
from hickory_stream.worlds.support_placement import REST_M, stood_on
from hickory_stream.worlds.trajectory import STEP_S, Trajectory, camera_rotation
from tools.worlds import table_things

_THINGS: tuple[Callable[[np.random.Generator], Model], ...] = (
    table_things.can, table_things.carton, table_things.cereal_box, table_things.packet, table_things.squeeze_bottle,
    table_things.jar, small_things.mug, small_things.bowl, small_things.bottle, table_things.toy_car,
    table_things.ball, small_things.book_stack, small_things.small_box, table_things.kettle, table_things.vase,
    table_things.clock,
)  # fmt: skip
_HALF_M, _HEIGHT_M = 1.8, 2.6
_MIN_THINGS, _MAX_THINGS = 10, 19
_ATTEMPTS = 40


def tabletop(seed: int, attempt: int = 0) -> World:
    """Return table number `attempt` of a seed: the table and 10 to 19 objects on it, some stacked."""
    # Raises ConfigError: no draw fits, which no seed has shown so far.
    rng = np.random.default_rng([seed, 12, attempt])
    for _ in range(_ATTEMPTS):
        placed = _draw(rng)
        if _MIN_THINGS < len(placed) <= _MAX_THINGS + 1:
            return World(
                objects=numbered(placed),
                structure=room_structure(rng, _HALF_M, _HALF_M, _HEIGHT_M),
                rooms_m=((-_HALF_M, -_HALF_M, _HALF_M, _HALF_M),),
                middle_m=(0.0, 0.0),
            )
    raise ConfigError(f"seed {seed}: no laid table in {_ATTEMPTS} draws; choose another --seed")


def _draw(rng: np.random.Generator) -> list[Placement]:
    table = Placement(
        model=furniture.table(rng), world_from_object=at_place(0.0, 0.0, REST_M, float(rng.uniform(0, 6)))
    )
    surface = table.model.surfaces[0]
    # Objects stand close together in the middle, as on a table in use.
    half = (min(surface.half_m[0], 0.34), min(surface.half_m[1], 0.46))
    middle = Surface(center_m=surface.center_m, half_m=half)
    count = int(rng.integers(_MIN_THINGS, _MAX_THINGS))
    draws = [_THINGS[i] for i in rng.permutation(len(_THINGS))] + [
        _THINGS[i] for i in rng.integers(len(_THINGS), size=4)
    ]
    things = stood_on(rng, table, middle, [draw(rng) for draw in draws[:count]], gap_m=0.02)
    stacked = [
        on
        for thing in things
        if thing.model.surfaces and rng.random() < 0.7
        for on in stood_on(rng, thing, thing.model.surfaces[0], [table_things.packet(rng)], turn_rad=0.3)
    ]
    return [table, *things, *stacked]


_SECONDS = 60.0
_TURNS_A_MINUTE = 1.35


def orbit(world: World, seconds: float | None, walk_index: int, rng: np.random.Generator) -> Trajectory:
    """Return an orbit 0.8 to 1.1 m from the middle, 0.4 to 0.75 m above the table; `seconds` None is a minute."""
    lasts = _SECONDS if seconds is None else seconds
    times_s = np.arange(0.0, lasts + 2 * STEP_S, STEP_S)
    top = max(s.center_m[2] for item in world.objects if item.model.kind == "table" for s in item.model.surfaces)
    sense = 1.0 if walk_index % 2 == 0 else -1.0
    phase = rng.uniform(0, 2 * np.pi, size=6)
    turn = 2 * np.pi * times_s / 60.0
    angle = phase[0] + sense * _TURNS_A_MINUTE * turn
    radius = 0.95 + 0.13 * np.sin(2.3 * turn + phase[1])
    height = top + 0.57 + 0.16 * np.sin(3.1 * turn + phase[2])
    eyes = np.stack(
        [world.middle_m[0] + radius * np.cos(angle), world.middle_m[1] + radius * np.sin(angle), height], axis=1
    )
    # The gaze moves over the objects instead of staying on the centre.
    target = np.stack([0.12 * np.sin(5.0 * turn + phase[3]), 0.12 * np.sin(4.1 * turn + phase[4])], axis=1)
    look = np.column_stack([target + world.middle_m, np.full(len(times_s), top + 0.06)]) - eyes
    yaw = np.arctan2(look[:, 1], look[:, 0])
    pitch = np.arctan2(look[:, 2], np.linalg.norm(look[:, :2], axis=1))
    roll = np.radians(1.0) * np.sin(7.0 * turn + phase[5])
    poses = [
        from_rotation_translation(camera_rotation(float(a), float(b), float(c)), eye)
        for a, b, c, eye in zip(yaw, pitch, roll, eyes, strict=True)
    ]
    return Trajectory(times_s=times_s, world_from_camera=np.stack(poses))
