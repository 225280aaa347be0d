"""`--floor`: the storey of a map that a command uses."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.errors import InputError

if TYPE_CHECKING:
    import argparse

    from hickory_stream.records import MapSnapshot

# A height farther from all floors is a mistake.
_REACH_M = 1.0


def add_floor_argument(parser: argparse.ArgumentParser, what: str) -> None:
    """Add --floor: a height near one of the map's floors."""
    parser.add_argument("--floor", type=float, metavar="Z", help=f"{what}: height of its floor in metres")


def floor_of_option(snapshot: MapSnapshot, floor_m: float | None) -> float:
    """Return the floor that `--floor` selects; without it, the map's only floor.

    Raises `InputError` if the map has several floors and none was given, or none at this height.
    """
    from hickory_stream.storeys import floor_of, floors_of

    floors_m = floors_of(snapshot)
    text = " and ".join([", ".join(f"{z_m:.2f}" for z_m in floors_m[:-1]), *(f"{z_m:.2f}" for z_m in floors_m[-1:])])
    if floor_m is None:
        if len(floors_m) > 1:
            raise InputError(f"the map has {len(floors_m)} floors, at z = {text} m; choose one with --floor")
        return floor_of(snapshot)
    if not abs(floor_m) < float("inf"):
        raise InputError(f"found --floor {floor_m}, expected a height in metres")
    if not floors_m:
        return floor_m
    nearest = min(floors_m, key=lambda z_m: abs(z_m - floor_m))
    if abs(nearest - floor_m) > _REACH_M:
        there = f"its floors are at z = {text} m" if len(floors_m) > 1 else f"its floor is at z = {floors_m[0]:.2f} m"
        raise InputError(f"found --floor {floor_m:g}, but the map has no floor within {_REACH_M:g} m of it: {there}")
    return nearest
