"""What a synthetic recording is made of: scene, walk, cameras and their defects, container."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.errors import ConfigError
from hickory_stream.geometry.camera import Camera
from hickory_stream.worlds.clutter.families import recipes_of
from hickory_stream.worlds.depth_camera import DepthCameraConfig
from hickory_stream.worlds.layouts import LAYOUTS, layout_camera
from hickory_stream.worlds.scenes import BUILDING, CLUTTER, OUTDOOR, SCENES
from hickory_stream.worlds.walk_config import WalkConfig

if TYPE_CHECKING:
    from hickory_stream.worlds.building.building import BuildingSize
    from hickory_stream.worlds.color_camera import ColorCameraConfig
    from hickory_stream.worlds.drift import DriftConfig

MAX_ROBOTS = 16


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordingConfig:
    """The config of a recording; the same config gives the same bytes."""

    scene: str = "room"
    """One of `worlds.scenes.SCENES`."""
    family: str = "training"
    """The family of recipes of a random room (scene `clutter`): one of `worlds.clutter.families.FAMILIES`."""
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
    layout: str = "zed"
    """One of `worlds.layouts.LAYOUTS`: the container, the topics, the frames and the quirks of a data set."""
    robots: int = 0
    """Of how many robots of a fleet this is one, the one on walk `walk_index`; 0: it is alone.

    A robot of a fleet has a frame and a clock of its own, and its truth is in its frame (`worlds.fleet`).
    """
    camera_offset: bool = False
    """Whether the seed draws the camera's pose on the body of a NUS-CLB robot, 0.4 m and 10 degrees off."""
    drift: DriftConfig | None = None
    """The drift of odometry; None: exact poses."""
    building: BuildingSize | None = None
    """How large a building is; None: two floors and twelve rooms."""
    day: int = 0
    """How many days the things in the world have been moved, removed and added since it was made (`worlds.days`)."""
    change_at_s: float | None = None
    """From this second of the log on it is the next day: things are moved, removed and added behind the robot's back.

    None: the world stays as it is.
    """
    person: bool = False
    """Whether a person walks through the scene."""
    color: ColorCameraConfig | None = None
    """The defects of the colour camera in addition to `color_noise`; None: no others."""
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
        if self.day < 0 or (self.day and self.scene in (BUILDING, CLUTTER, OUTDOOR)):
            raise ConfigError(f"day {self.day} in the scene {self.scene}; expected 0 or more, above 0 in rooms only")
        if self.change_at_s is not None and (self.scene in (BUILDING, CLUTTER, OUTDOOR) or not self.change_at_s > 0):
            raise ConfigError(
                f"a change at {self.change_at_s} s in the scene {self.scene}; expected a time above 0, and a room, an "
                "apartment or a tabletop"
            )
        if self.scene not in SCENES:
            raise ConfigError(f"scene {self.scene!r}; expected one of {', '.join(SCENES)}")
        if self.robots and (not self.walk_index < self.robots <= MAX_ROBOTS or self.scene == CLUTTER):
            raise ConfigError(
                f"robot {self.walk_index} of {self.robots} in the scene {self.scene}; expected up to {MAX_ROBOTS} "
                f"robots, of which it is one, in any scene but {CLUTTER}"
            )
        recipes_of(self.family)
        if self.layout not in LAYOUTS:
            raise ConfigError(f"layout {self.layout!r}; expected one of {', '.join(LAYOUTS)}")

    @property
    def is_by_frame(self) -> bool:
        """Whether each frame draws its noise for itself, so that frames can be made in any order."""
        return self.scene == BUILDING

    @property
    def camera(self) -> Camera:
        """The pinhole camera of both images."""
        focal_px = self.width / 2 / np.tan(np.radians(self.horizontal_fov_deg) / 2)
        camera = Camera(
            width=self.width,
            height=self.height,
            fx=float(focal_px),
            fy=float(focal_px),
            cx=(self.width - 1) / 2,
            cy=(self.height - 1) / 2,
        )
        return layout_camera(self.layout, camera)
