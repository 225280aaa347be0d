"""The scenes by name."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.errors import ConfigError
from hickory_stream.worlds.room import furnished_room
from tools.worlds.apartment import apartment
from tools.worlds.building.building import BuildingSize, building
from tools.worlds.clutter.families import FAMILIES
from tools.worlds.clutter.room import clutter_room
from tools.worlds.outdoor.street import street
from tools.worlds.tabletop import tabletop

if TYPE_CHECKING:
    from collections.abc import Callable

    from hickory_stream.worlds.scene import World

APARTMENT, TABLETOP, CLUTTER, OUTDOOR, BUILDING = "apartment", "tabletop", "clutter", "outdoor", "building"
_BY_ATTEMPT: dict[str, Callable[[int, int], World]] = {
    "room": furnished_room,
    APARTMENT: apartment,
    TABLETOP: tabletop,
}


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
    if scene not in _BY_ATTEMPT:
        known = ", ".join((*_BY_ATTEMPT, CLUTTER, OUTDOOR, BUILDING))
        raise ConfigError(f"scene {scene!r}; expected one of {known}")
    return _BY_ATTEMPT[scene](seed, attempt)
