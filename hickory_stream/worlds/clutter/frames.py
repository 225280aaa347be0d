"""Single frames of random rooms with ground truth, without writing a log: training data for networks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.errors import ConfigError
from hickory_stream.geometry.arrays import freeze
from hickory_stream.worlds.clutter.families import FAMILIES, recipes_of
from hickory_stream.worlds.clutter.room import clutter_room
from hickory_stream.worlds.clutter.sensors import random_camera, random_color_camera, random_depth_camera
from hickory_stream.worlds.clutter.views import random_view
from hickory_stream.worlds.color_camera import photographed
from hickory_stream.worlds.depth_camera import sensed_depth
from hickory_stream.worlds.rendering import Renderer

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from hickory_stream.geometry.camera import Camera
    from hickory_stream.worlds.clutter.room import ClutterRoom

_FRAMES_A_ROOM = 12
_MIDDLE_GREY = 110.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Frame:
    """A frame as a camera with defects reports it, and its truth.

    `rgb` (H, W, 3) uint8; `depth_m` (H, W) float32 with NaN where the camera reports nothing; `exact_depth_m` (H, W)
    float32 with NaN only where a ray hits nothing. `instances` (H, W) uint16: 0 is no object, ids >= 1 are those of
    `room` (the index of the room of seed and family). `is_structure` (H, W) bool: floor, walls, ceiling and what
    belongs to them. A pixel that is neither hits nothing. Truth and depth are registered exactly; colour is displaced
    by the camera's defects. `world_from_camera` (4, 4) has z up.
    """

    rgb: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    exact_depth_m: NDArray[np.float32]
    instances: NDArray[np.uint16]
    is_structure: NDArray[np.bool_]
    camera: Camera
    world_from_camera: NDArray[np.float64]
    room: int

    def __post_init__(self) -> None:
        size = self.depth_m.shape
        freeze(self, "rgb", np.uint8, (*size, 3))
        freeze(self, "depth_m", np.float32, size)
        freeze(self, "exact_depth_m", np.float32, size)
        freeze(self, "instances", np.uint16, size)
        freeze(self, "is_structure", np.bool_, size)
        freeze(self, "world_from_camera", np.float64, (4, 4))


def frames_of(seed: int, family: str, count: int, width: int = 320, height: int = 240) -> Iterator[Frame]:
    """Yield `count` frames of random rooms of a family, several from each room; equal arguments give equal frames.

    A longer sequence begins with the shorter one. Different seeds give different rooms, for use in parallel processes.

    Raises:
        ConfigError: there is no such family, or the image size is out of range.
    """
    recipes_of(family)
    if not (32 <= width <= 4096 and 32 <= height <= 4096):
        raise ConfigError(f"frames of {width}x{height}; expected 32 to 4096 pixels a side")
    if seed < 0:
        raise ConfigError(f"seed {seed}; expected 0 or more")
    made, index = 0, 0
    while made < count:
        for frame in _frames_of_room(seed, family, index, (width, height)):
            yield frame
            made += 1
            if made == count:
                return
        index += 1


def _frames_of_room(seed: int, family: str, index: int, size: tuple[int, int]) -> Iterator[Frame]:
    room = clutter_room(seed, family, index)
    if not room.world.objects:
        return
    renderer = Renderer(room.world)
    for i in range(_FRAMES_A_ROOM):
        rng = np.random.default_rng([seed, 22, FAMILIES.index(family), index, i])
        frame = _frame(rng, room, renderer, index, size)
        if frame is not None:
            yield frame


def _frame(
    rng: np.random.Generator, room: ClutterRoom, renderer: Renderer, index: int, size: tuple[int, int]
) -> Frame | None:
    camera = random_camera(rng, *size)
    world_from_camera = random_view(rng, room, renderer, camera)
    if world_from_camera is None:
        return None
    rendered = renderer.render(camera, world_from_camera)
    depth = random_depth_camera(rng, camera.fx)
    color = random_color_camera(rng, camera.width)
    # Automatic exposure, with an error.
    gain = float(np.clip(_MIDDLE_GREY / max(float(rendered.rgb.mean()), 1.0), 0.6, 4.0))
    color = replace(color, exposure=color.exposure * gain)
    return Frame(
        rgb=photographed(rendered.rgb, color, rng),
        depth_m=sensed_depth(rendered.depth_m, rendered.cosine, camera.fx, depth, rng, rendered.is_blind),
        exact_depth_m=rendered.depth_m,
        instances=rendered.instances,
        is_structure=rendered.is_structure,
        camera=camera,
        world_from_camera=world_from_camera,
        room=index,
    )
