"""`hickory-stream inspect`: list the objects and layers of a map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.cli.option_values import add_at, open_map_at, parse_place
from hickory_stream.errors import InputError
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse

    from hickory_stream.cli.commands import Commands


def add(commands: Commands) -> None:
    inspect = commands.add("inspect", run)
    inspect.add_argument("map", type=Path, metavar="MAP")
    inspect.add_argument(
        "--sort",
        choices=("id", "distance", "volume", "height", "sightings"),
        default="id",
        help="order of the objects; distance is from --near, or the map's origin",
    )
    inspect.add_argument(
        "--near", metavar="X,Y[,R]", help="only objects within R metres of this position, if R is given"
    )
    inspect.add_argument(
        "--min-size", type=float, default=0.0, metavar="M", help="only objects with a side of this length or more"
    )
    add_at(inspect)


def run(options: argparse.Namespace) -> int:
    from hickory_stream.inspection.inspect import as_json, chosen, format_table, summarize

    near, within_m = _near(options.near)
    if not 0 <= options.min_size < float("inf"):
        raise InputError(f"found --min-size {options.min_size:g}, expected metres, 0 or more")
    found = summarize(open_map_at(options.map, options.at))
    summary = chosen(found, sort=options.sort, near=near, within_m=within_m, min_size_m=options.min_size)
    print(output("inspect", as_json(summary), indent=1) if options.json else format_table(summary))
    return 0


def _near(text: str | None) -> tuple[tuple[float, float], float | None]:
    if text is None:
        return (0.0, 0.0), None
    place, _, radius = text.rpartition(",") if text.count(",") == 2 else (text, "", "")
    try:
        within_m = float(radius) if radius else None
    except ValueError:
        within_m = -1.0
    if within_m is not None and not 0 <= within_m < float("inf"):
        raise InputError(f"found --near {text}, expected X,Y,R in metres, R 0 or more, e.g. --near=1.5,-2,0.5")
    return parse_place(place, "--near"), within_m
