"""Worlds that one can walk through, the walk of a recording, who else walks there, and what changes on the way."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.errors import ConfigError
from hickory_stream.geometry.rigid import apply
from hickory_stream.worlds.building.building import BuildingSize, building
from hickory_stream.worlds.building.walk import building_walk
from hickory_stream.worlds.clutter.room import clutter_room
from hickory_stream.worlds.clutter.walk import wander
from hickory_stream.worlds.days import placed_otherwise, world_of_day
from hickory_stream.worlds.orbit import orbit
from hickory_stream.worlds.outdoor.street import street
from hickory_stream.worlds.outdoor.walk import stroll
from hickory_stream.worlds.person import Person
from hickory_stream.worlds.scenes import BUILDING, CLUTTER, OUTDOOR, make_world
from hickory_stream.worlds.shots import WorldChange
from hickory_stream.worlds.tour import tour
from hickory_stream.worlds.trajectory import NoWalk, Trajectory, walk_round

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.worlds.recording_config import RecordingConfig
    from hickory_stream.worlds.scene import World, WorldObject

_WORLDS = 20
_LEAST_CLUTTER = 6
_ON_THE_WAY = 7_000_000


def walkable_world(config: RecordingConfig) -> tuple[World, Trajectory]:
    """Return the first of the seed's worlds that one can walk through, and the walk.

    Both of the first two walks, and those of all robots of a fleet, must be possible, so that they share one world.

    Raises:
        ConfigError: none of the seed's worlds can be walked.
    """
    if config.scene == CLUTTER:
        return _walkable_clutter(config)
    if config.scene == OUTDOOR:
        return _walkable_street(config)
    if config.scene == BUILDING:
        return _walkable_building(config)
    for attempt in range(_WORLDS):
        world = make_world(config.scene, config.seed, attempt)
        trajectory = _walk(world, config, config.walk_index)
        others = set(range(config.robots)) | ({0, 1} if config.scene == "apartment" else set())
        others -= {config.walk_index}
        if not isinstance(trajectory, NoWalk) and not any(isinstance(_walk(world, config, i), NoWalk) for i in others):
            return _on_its_day(world, trajectory, config)
    raise _not_walkable(config)


def _on_its_day(world: World, trajectory: Trajectory, config: RecordingConfig) -> tuple[World, Trajectory]:
    """Return the world and the walk through it on the day of a recording; on day 0 as they are."""
    if not config.day:
        return world, trajectory

    def walk(changed: World) -> Trajectory | NoWalk:
        return _walk(changed, config, config.walk_index)

    today = world_of_day(world, config.seed, config.day, lambda changed: not isinstance(walk(changed), NoWalk))
    found = walk(today)
    assert not isinstance(found, NoWalk)
    return today, found


def change_on_the_way(world: World, trajectory: Trajectory, config: RecordingConfig) -> WorldChange | None:
    """Return what the world becomes during a recording: the next day's, of which nothing stands in the camera's way."""
    if config.change_at_s is None:
        return None
    times_s = trajectory.times_s[trajectory.times_s >= config.change_at_s]
    if not len(times_s):
        raise ConfigError(
            f"a change at {config.change_at_s} s of a walk that ends after {trajectory.times_s[-1]:.0f} s; "
            "expected it before the end"
        )
    way_m = np.array([trajectory.pose_at(float(time_s))[:2, 3] for time_s in times_s[::5]])

    def is_free(changed: World) -> bool:
        arrived = placed_otherwise(changed, world)
        return all(_keeps_clear(way_m, item, config.walk.clearance_m) for item in arrived)

    # Another draw than that of the days, which two logs of days may have in common with this one.
    return WorldChange(at_s=config.change_at_s, world=world_of_day(world, config.seed + _ON_THE_WAY, 1, is_free))


def _keeps_clear(way_m: NDArray[np.float64], item: WorldObject, clearance_m: float) -> bool:
    """Return whether a way (N, 2) stays so far from an object's bounds."""
    lower, upper = item.model.bounds_m()
    corners = np.array(np.meshgrid(*zip(lower, upper, strict=True))).reshape(3, -1).T
    placed = apply(item.world_from_object, corners)[:, :2]
    nearest = np.clip(way_m, placed.min(axis=0), placed.max(axis=0))
    return bool((np.linalg.norm(way_m - nearest, axis=1) > clearance_m).all())


def _not_walkable(config: RecordingConfig) -> ConfigError:
    return ConfigError(
        f"seed {config.seed}: none of {_WORLDS} worlds leaves {config.walk.clearance_m} m to walk; "
        "choose another --seed"
    )


def _walkable_clutter(config: RecordingConfig) -> tuple[World, Trajectory]:
    """Return the first of the seed's random rooms that has objects and a walk, and the walk."""
    for attempt in range(_WORLDS):
        room = clutter_room(config.seed, config.family, attempt)
        if len(room.world.objects) >= _LEAST_CLUTTER:
            rng = np.random.default_rng([config.seed, 2, config.walk_index])
            trajectory = wander(room, 60.0 if config.seconds is None else config.seconds, config.walk, rng)
            if not isinstance(trajectory, NoWalk):
                return room.world, trajectory
    raise _not_walkable(config)


def _walkable_street(config: RecordingConfig) -> tuple[World, Trajectory]:
    """Return the first of the seed's streets with a closed route for all robots of a fleet, and the walk."""
    for attempt in range(_WORLDS):
        found = street(config.seed, attempt)
        walks = {i: stroll(found, config.seconds, config.walk, i) for i in {*range(config.robots), config.walk_index}}
        trajectory = walks[config.walk_index]
        if not isinstance(trajectory, NoWalk) and not any(isinstance(walk, NoWalk) for walk in walks.values()):
            return found.world, trajectory
    raise _not_walkable(config)


def _walkable_building(config: RecordingConfig) -> tuple[World, Trajectory]:
    """Return the first of the seed's buildings that one can walk through, and the walk; all walks visit all rooms."""
    for attempt in range(_WORLDS):
        house = building(config.seed, config.building or BuildingSize(), attempt)
        rng = np.random.default_rng([config.seed, 2, config.walk_index])
        trajectory = building_walk(house, config.seconds, config.walk, config.walk_index, rng)
        if not isinstance(trajectory, NoWalk):
            return house.world, trajectory
    raise _not_walkable(config)


def _walk(world: World, config: RecordingConfig, walk_index: int) -> Trajectory | NoWalk:
    rng = np.random.default_rng([config.seed, 2, walk_index] if walk_index else [config.seed, 2])
    if config.scene == "apartment":
        return tour(world, config.seconds, config.walk, walk_index)
    if config.scene == "tabletop":
        return orbit(world, config.seconds, walk_index, rng)
    return walk_round(world, 60.0 if config.seconds is None else config.seconds, config.walk, rng)


def person_of(world: World, config: RecordingConfig) -> Person | None:
    """Return the person of a config: on another walk through the same world, faster than the camera.

    Random rooms, streets and buildings have no person.
    """
    if not config.person or config.scene in (CLUTTER, OUTDOOR, BUILDING):
        return None
    faster = replace(config.walk, speed_mps=2 * config.walk.speed_mps)
    if config.scene == "tabletop":
        track: Trajectory | NoWalk = orbit(world, config.seconds, config.walk_index + 1, np.random.default_rng(0))
    elif config.scene == "apartment":
        track = tour(world, config.seconds, faster, config.walk_index + 1)
    else:
        seconds = 60.0 if config.seconds is None else config.seconds
        track = walk_round(world, seconds, faster, np.random.default_rng([config.seed, 5]))
    return None if isinstance(track, NoWalk) else Person(track=track, ahead_s=3.0)
