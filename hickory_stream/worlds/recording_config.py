"""What a synthetic recording is made of: scene, walk, cameras and their defects.

A room is the only scene here; others, and other logs, come from outside by `SCENES` and a subclass.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from hickory_stream.errors import ConfigError
from hickory_stream.geometry.camera import Camera
from hickory_stream.worlds.depth_camera import DepthCameraConfig
from hickory_stream.worlds.room import furnished_room
from hickory_stream.worlds.scene import World
from hickory_stream.worlds.shots import Sensors, Stage
from hickory_stream.worlds.trajectory import NoWalk, Trajectory, WalkConfig, walk_round
from hickory_stream.worlds.zed_log import LogWriter, ZedLog

Walk: TypeAlias = Callable[[World, int], Trajectory | NoWalk]

_WORLDS = 20


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordingConfig:
    """The config of a recording; the same config gives the same bytes."""

    scene: str = "room"
    """One of `SCENES`."""
    seed: int = 7
    walk_index: int = 0
    """Which of the walks through the scene; a room has one for each seed."""
    seconds: float | None = 20.0
    """None: as long as the walk through the scene takes, a minute or more."""
    rate_hz: float = 6.0
    width: int = 640
    height: int = 360
    horizontal_fov_deg: float = 80.0
    color_noise: float = 1.0
    """Standard deviation of the colour noise, in grey levels."""
    jpeg_quality: int = 80
    walk: WalkConfig = field(default_factory=WalkConfig)
    depth: DepthCameraConfig = field(default_factory=DepthCameraConfig)

    def __post_init__(self) -> None:
        seconds = 60.0 if self.seconds is None else self.seconds
        if not (seconds > 0 and 0 < self.rate_hz <= 120 and seconds * self.rate_hz >= 1):
            raise ConfigError(
                f"{self.seconds} s at {self.rate_hz} Hz; expected a positive time and a rate of up to 120 Hz "
                "that give at least one frame"
            )
        if not (32 <= self.width <= 4096 and 32 <= self.height <= 4096):
            raise ConfigError(f"images of {self.width}x{self.height}; expected 32 to 4096 pixels a side")
        if self.seed < 0 or self.walk_index < 0:
            raise ConfigError(f"seed {self.seed}, walk {self.walk_index}; expected 0 or more")
        if self.scene not in SCENES:
            raise ConfigError(f"scene {self.scene!r}; expected one of {', '.join(SCENES)}")

    @property
    def camera(self) -> Camera:
        """The pinhole camera of both images."""
        focal_px = float(self.width / 2 / np.tan(np.radians(self.horizontal_fov_deg) / 2))
        center_px = {"cx": (self.width - 1) / 2, "cy": (self.height - 1) / 2}
        return Camera(width=self.width, height=self.height, fx=focal_px, fy=focal_px, **center_px)

    def sensors(self) -> Sensors:
        """Return the cameras."""
        return Sensors(
            camera=self.camera,
            color_noise=self.color_noise,
            depth=self.depth,
            seeds=(self.seed, 3, self.walk_index) if self.walk_index else (self.seed, 3),
        )

    def stage(self) -> Stage:
        """Return what is filmed; raises `ConfigError` where one can walk through none of the seed's worlds."""
        world, trajectory, _ = walkable(self)
        return Stage(world=world, trajectory=trajectory)

    def log_files(self, name: str) -> tuple[str, ...]:
        """Return the files or folders of the log, beginning with the one to play."""
        return (f"{name}.mcap",)

    def open_log(self, folder: Path, name: str, end_ns: int) -> LogWriter:
        """Return the writer of the log; `end_ns` is its last stamp."""
        del end_ns
        return ZedLog(folder / f"{name}.mcap", self.camera, self.jpeg_quality)


def walkable(config: RecordingConfig, others: Iterable[int] = ()) -> tuple[World, Trajectory, Walk]:
    """Return the first of the seed's worlds in which the config's walk and others are possible, and its walks.

    Raises:
        ConfigError: no world of the seed has all of these walks.
    """
    for attempt in range(_WORLDS):
        world, walk = SCENES[config.scene](config, attempt)
        trajectory = walk(world, config.walk_index)
        if not isinstance(trajectory, NoWalk) and not any(isinstance(walk(world, i), NoWalk) for i in others):
            return world, trajectory, walk
    raise ConfigError(
        f"seed {config.seed}: none of {_WORLDS} worlds leaves {config.walk.clearance_m} m to walk; "
        "choose another --seed"
    )


def _room(config: RecordingConfig, attempt: int) -> tuple[World, Walk]:
    def walk(world: World, index: int) -> Trajectory | NoWalk:
        rng = np.random.default_rng([config.seed, 2, index] if index else [config.seed, 2])
        return walk_round(world, 60.0 if config.seconds is None else config.seconds, config.walk, rng)

    return furnished_room(config.seed, attempt), walk


SCENES: dict[str, Callable[[Any, int], tuple[World, Walk]]] = {"room": _room}
"""Each returns world number `attempt` of a config's seed, and its walks; what it asks of a config is its own."""
