"""The scenes by name."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.errors import ConfigError
from hickory_stream.worlds.apartment import apartment
from hickory_stream.worlds.building.building import BuildingSize, building
from hickory_stream.worlds.clutter.families import FAMILIES
from hickory_stream.worlds.clutter.room import clutter_room
from hickory_stream.worlds.outdoor.street import street
from hickory_stream.worlds.room import furnished_room
from hickory_stream.worlds.tabletop import tabletop

if TYPE_CHECKING:
    from collections.abc import Callable

    from hickory_stream.worlds.scene import World

_SCENES: dict[str, Callable[[int, int], World]] = {"room": furnished_room, "apartment": apartment, "tabletop": tabletop}
CLUTTER = "clutter"
"""The name of the scene with families: random rooms (`worlds.clutter`)."""
OUTDOOR = "outdoor"
"""The name of the scene without rooms: a street and a lawn (`worlds.outdoor`)."""
BUILDING = "building"
"""The name of the scene with several floors (`worlds.building`)."""
SCENES = (*_SCENES, CLUTTER, OUTDOOR, BUILDING)


def make_world(scene: str, seed: int, attempt: int = 0) -> World:
    """Return world number `attempt` of a seed.

    Random rooms are those of the first family, buildings have the usual size.

    Raises:
        ConfigError: there is no such scene, or no valid layout was found.
    """
    if scene == CLUTTER:
        return clutter_room(seed, FAMILIES[0], attempt).world
    if scene == OUTDOOR:
        return street(seed, attempt).world
    if scene == BUILDING:
        return building(seed, BuildingSize(), attempt).world
    if scene not in _SCENES:
        raise ConfigError(f"scene {scene!r}; expected one of {', '.join(SCENES)}")
    return _SCENES[scene](seed, attempt)
