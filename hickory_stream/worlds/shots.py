"""The frames of a recording: what the cameras give, and what is truly there."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.arrays import freeze, freeze_all
from hickory_stream.geometry.camera import Camera
from hickory_stream.pictures.ray_caster import CasterName
from hickory_stream.worlds.depth_camera import DepthCameraConfig, sensed_depth
from hickory_stream.worlds.rendering import Rendered, Renderer
from hickory_stream.worlds.scene import World
from hickory_stream.worlds.trajectory import Trajectory
from hickory_stream.worlds.zed_log import DepthView

# The id of an occluder in instance images; it is no true object.
OCCLUDER_ID = 60000


class Occluder(Protocol):
    """What moves through the images without being an object."""

    def drawn_into(
        self,
        rendered: Rendered,
        camera: Camera,
        world_from_camera: NDArray[np.float64],
        time_s: float,
        caster: CasterName | None,
    ) -> Rendered:
        """Return an image with the occluder in front of the scene, its instance `OCCLUDER_ID`."""
        ...


@dataclass(frozen=True, kw_only=True, slots=True)
class Sensors:
    """The cameras and their defects; noise is drawn from `seeds`."""

    camera: Camera
    #: In grey levels.
    color_noise: float
    depth: DepthCameraConfig
    seeds: tuple[int, ...]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class WorldChange:
    """The world from second `at_s` of a log on; its structure is the one before."""

    at_s: float
    world: World


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Stage:
    """What is filmed: a world and the camera's true way through it."""

    world: World
    trajectory: Trajectory
    odometry: Trajectory | None = None
    """The way by odometry; None: the true one."""
    change: WorldChange | None = None
    occluder: Occluder | None = None
    robot_from_world: NDArray[np.float64] | None = None
    """The frame (4, 4) of the log and its truth; None: the world's."""
    clock_offset_ns: int = 0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Filming:
    """What frames are made of; `view` is a separate depth camera, None where depth is registered to colour."""

    sensors: Sensors
    stage: Stage
    caster: CasterName | None
    view: DepthView | None = None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Shot:
    """One frame: `rgb` (H, W, 3) and `depth_m` as the cameras give them; exact depth and instances (H, W)."""

    rgb: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    exact_depth_m: NDArray[np.float32]
    instances: NDArray[np.uint16]

    def __post_init__(self) -> None:
        size = self.instances.shape
        freeze(self, "rgb", np.uint8, (*size, 3))
        freeze_all(self, np.float32, depth_m=(None, None), exact_depth_m=size)
        freeze(self, "instances", np.uint16, size)


def shots_of(filming: Filming, times_s: Sequence[float]) -> Iterator[Shot]:
    """Yield the frames at times of the walk, in their order: each draws its noise after the one before."""
    sensors, view = filming.sensors, filming.view
    camera = sensors.camera
    stage, trajectory = filming.stage, filming.stage.trajectory
    renderer = Renderer(stage.world, filming.caster)
    later = renderer if stage.change is None else Renderer(stage.change.world, filming.caster)
    changes_at_s = np.inf if stage.change is None else stage.change.at_s
    rng = np.random.default_rng(sensors.seeds)

    def rendered_at(camera: Camera, pose: NDArray[np.float64], time_s: float) -> Rendered:
        rendered = (renderer if time_s < changes_at_s else later).render(camera, pose)
        if stage.occluder is None:
            return rendered
        return stage.occluder.drawn_into(rendered, camera, pose, time_s, filming.caster)

    for time_s in times_s:
        rendered = rendered_at(camera, trajectory.pose_at(time_s), time_s)
        rgb, depth_m = _sensed(rendered, sensors, rng)
        if view is not None:
            # A separate depth camera beside the colour camera, a short time later.
            later_s = min(time_s + view.lag_ns / 1e9, float(trajectory.times_s[-1]))
            pose = trajectory.pose_at(later_s) @ view.color_from_depth
            depth_m = _depth(rendered_at(view.camera, pose, later_s), view.camera, sensors, rng)
        yield Shot(rgb=rgb, depth_m=depth_m, exact_depth_m=rendered.depth_m, instances=rendered.instances)


def _sensed(
    rendered: Rendered, sensors: Sensors, rng: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    noise = sensors.color_noise * rng.standard_normal(rendered.rgb.shape)
    rgb = np.clip(rendered.rgb + noise, 0, 255).round().astype(np.uint8)
    return rgb, _depth(rendered, sensors.camera, sensors, rng)


def _depth(rendered: Rendered, camera: Camera, sensors: Sensors, rng: np.random.Generator) -> NDArray[np.float32]:
    return sensed_depth(rendered.depth_m, rendered.cosine, camera.fx, sensors.depth, rng, rendered.is_blind)
