"""Configs of recordings of all scenes, with layouts, drift, people and changes; an import registers the scenes."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import ConfigError
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import apply, from_rotation_translation, yaw_rotation
from hickory_stream.worlds.recording_config import SCENES, walkable
from hickory_stream.worlds.recording_config import RecordingConfig as PlainConfig
from hickory_stream.worlds.scene import World, WorldObject, placed_otherwise
from hickory_stream.worlds.shots import Stage, WorldChange
from hickory_stream.worlds.trajectory import NoWalk, Trajectory, walk_round
from hickory_stream.worlds.zed_log import LogWriter
from tools.worlds.apartment import apartment
from tools.worlds.clutter.kit import recipes_of
from tools.worlds.clutter.room import clutter_room
from tools.worlds.clutter.walk import wander
from tools.worlds.days import world_of_day
from tools.worlds.drift import DriftConfig, drifted
from tools.worlds.layouts import LAYOUTS, drawn_mounting, layout_camera, layout_files, open_layout
from tools.worlds.outdoor.street import street
from tools.worlds.outdoor.walk import stroll
from tools.worlds.person import Person
from tools.worlds.routes import tour
from tools.worlds.tabletop import orbit, tabletop

APARTMENT, TABLETOP, CLUTTER, OUTDOOR = "apartment", "tabletop", "clutter", "outdoor"
MAX_ROBOTS = 16
Walk = Callable[[World, int], Trajectory | NoWalk]
_WITHOUT_DAYS = (CLUTTER, OUTDOOR)
_LEAST_CLUTTER = 6
_ON_THE_WAY = 7_000_000
# Where robots of a fleet start by their own reckoning, and by how much their clocks differ.
_FRAME_REACH_M, _CLOCK_REACH_NS = 8.0, 3_600_000_000_000


@dataclass(frozen=True, kw_only=True)
class RecordingConfig(PlainConfig):
    """The config of a recording of any scene; the same config gives the same bytes."""

    family: str = "training"
    """The family of recipes of a random room (scene `clutter`): one of `clutter.families.FAMILIES`."""
    layout: str = "zed"
    """One of `layouts.LAYOUTS`: the container, the topics, the frames and the quirks of a data set."""
    robots: int = 0
    """The number of robots in the fleet of this one, which goes on walk `walk_index`; 0: it is alone.

    A robot of a fleet has a frame and a clock of its own, and its truth is in its frame (`fleet`).
    """
    camera_offset: bool = False
    """Whether the seed draws the camera's pose on the body of a NUS-CLB robot, 0.4 m and 10 degrees off."""
    drift: DriftConfig | None = None
    """The drift of odometry; None: exact poses."""
    day: int = 0
    """How many days the things in the world have been moved, removed and added since it was made (`days`)."""
    change_at_s: float | None = None
    """From this second of the log on it is the next day: things are moved, removed and added behind the robot's back.

    None: the world stays as it is.
    """
    person: bool = False
    """Whether a person walks through the scene."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.day < 0 or (self.day and self.scene in _WITHOUT_DAYS):
            raise ConfigError(f"day {self.day} in the scene {self.scene}; expected 0 or more, above 0 in rooms only")
        if self.change_at_s is not None and (self.scene in _WITHOUT_DAYS or not self.change_at_s > 0):
            raise ConfigError(
                f"a change at {self.change_at_s} s in the scene {self.scene}; expected a time above 0, and a room, an "
                "apartment or a tabletop"
            )
        if self.robots and (not self.walk_index < self.robots <= MAX_ROBOTS or self.scene == CLUTTER):
            raise ConfigError(
                f"robot {self.walk_index} of {self.robots} in the scene {self.scene}; expected up to {MAX_ROBOTS} "
                f"robots, of which it is one, in any scene but {CLUTTER}"
            )
        recipes_of(self.family)
        if self.layout not in LAYOUTS:
            raise ConfigError(f"layout {self.layout!r}; expected one of {', '.join(LAYOUTS)}")

    @property
    def camera(self) -> Camera:
        return layout_camera(self.layout, super().camera)

    def stage(self) -> Stage:
        """Return what is filmed; raises `ConfigError` as `walkable_world`, or for a change after the walk's end."""
        world, trajectory = walkable_world(self)
        odometry, clock_offset_ns = None, 0
        if self.drift is not None:
            odometry = drifted(trajectory, self.drift, np.random.default_rng([self.seed, 6, self.walk_index]))
        if self.robots:
            rng = np.random.default_rng([self.seed, 9, self.walk_index])
            clock_offset_ns = int(rng.integers(-_CLOCK_REACH_NS, _CLOCK_REACH_NS))
        return Stage(
            world=world, trajectory=trajectory, odometry=odometry, change=_change_on_the_way(world, trajectory, self),
            occluder=person_of(world, self), robot_from_world=drawn_frame(self), clock_offset_ns=clock_offset_ns,
        )  # fmt: skip

    def log_files(self, name: str) -> tuple[str, ...]:
        return layout_files(self.layout, name)

    def open_log(self, folder: Path, name: str, end_ns: int) -> LogWriter:
        """Return the writer of the log; `end_ns` is its last stamp, which determines the time of a loop closure."""
        mounting = drawn_mounting(self.seed) if self.camera_offset else None
        return open_layout(self.layout, folder, name, self.camera, self.jpeg_quality, end_ns, mounting)


def walkable_world(config: RecordingConfig) -> tuple[World, Trajectory]:
    """Return the first of the seed's worlds that one can walk through, on the config's day, and the walk."""
    # The first two walks through an apartment, and those of a fleet, share one world: all must be possible.
    # Raises ConfigError: none of the seed's worlds can be walked.
    others = {*range(config.robots), *((0, 1) if config.scene == APARTMENT else ())} - {config.walk_index}
    world, trajectory, walk = walkable(config, () if config.scene == CLUTTER else others)
    if not config.day:
        return world, trajectory

    def is_walkable(changed: World) -> bool:
        return not isinstance(walk(changed, config.walk_index), NoWalk)

    today = world_of_day(world, config.seed, config.day, is_walkable)
    found = walk(today, config.walk_index)
    assert not isinstance(found, NoWalk)
    return today, found


def _change_on_the_way(world: World, trajectory: Trajectory, config: RecordingConfig) -> WorldChange | None:
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
    # Whether a way (N, 2) stays so far from an object's bounds.
    lower, upper = item.model.bounds_m()
    corners = np.array(np.meshgrid(*zip(lower, upper, strict=True))).reshape(3, -1).T
    placed = apply(item.world_from_object, corners)[:, :2]
    nearest = np.clip(way_m, placed.min(axis=0), placed.max(axis=0))
    return bool((np.linalg.norm(way_m - nearest, axis=1) > clearance_m).all())


def person_of(world: World, config: RecordingConfig) -> Person | None:
    """Return the person of a config, on another walk than the camera and faster; None in scenes without people."""
    if not config.person or config.scene in _WITHOUT_DAYS:
        return None
    faster = replace(config.walk, speed_mps=2 * config.walk.speed_mps)
    if config.scene == TABLETOP:
        track: Trajectory | NoWalk = orbit(world, config.seconds, config.walk_index + 1, np.random.default_rng(0))
    elif config.scene == APARTMENT:
        track = tour(world, config.seconds, faster, config.walk_index + 1)
    else:
        seconds = 60.0 if config.seconds is None else config.seconds
        track = walk_round(world, seconds, faster, np.random.default_rng([config.seed, 5]))
    return None if isinstance(track, NoWalk) else Person(track=track, ahead_s=3.0)


def drawn_frame(config: RecordingConfig) -> NDArray[np.float64] | None:
    """Return robot_from_world (4, 4), level: where a robot of a fleet starts by its own reckoning; None: alone."""
    if not config.robots:
        return None
    rng = np.random.default_rng([config.seed, 8, config.walk_index])
    shift_m = rng.uniform(-_FRAME_REACH_M, _FRAME_REACH_M, 3) * (1.0, 1.0, 0.1)
    return from_rotation_translation(yaw_rotation(float(rng.uniform(0.0, 2 * np.pi))), shift_m)


def _apartment(config: RecordingConfig, attempt: int) -> tuple[World, Walk]:
    return apartment(config.seed, attempt), lambda world, index: tour(world, config.seconds, config.walk, index)


def _tabletop(config: RecordingConfig, attempt: int) -> tuple[World, Walk]:
    def walk(world: World, index: int) -> Trajectory:
        rng = np.random.default_rng([config.seed, 2, index] if index else [config.seed, 2])
        return orbit(world, config.seconds, index, rng)

    return tabletop(config.seed, attempt), walk


def _clutter(config: RecordingConfig, attempt: int) -> tuple[World, Walk]:
    room = clutter_room(config.seed, config.family, attempt)

    def walk(world: World, index: int) -> Trajectory | NoWalk:
        if len(world.objects) < _LEAST_CLUTTER:
            return NoWalk(clearance_m=0.0)
        seconds = 60.0 if config.seconds is None else config.seconds
        return wander(room, seconds, config.walk, np.random.default_rng([config.seed, 2, index]))

    return room.world, walk


def _outdoor(config: RecordingConfig, attempt: int) -> tuple[World, Walk]:
    found = street(config.seed, attempt)
    return found.world, lambda _, index: stroll(found, config.seconds, config.walk, index)


SCENES.update({APARTMENT: _apartment, TABLETOP: _tabletop, CLUTTER: _clutter, OUTDOOR: _outdoor})
