"""`hickory-stream inspect`: list the objects and layers of a map."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.cli.commands import INCOMPLETE
from hickory_stream.cli.option_values import add_at, open_map_at, parse_place
from hickory_stream.errors import InputError
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse

    from hickory_stream.cli.commands import Commands
    from hickory_stream.inspection.inspect import SortBy


_WORDS = """columns:
  kind       object, or fixture: built in, attached, or too large to carry
  phase      tentative: a candidate; active: seen in the last seconds;
             dormant, archived: seen earlier
  sightings  keyframes that saw it
  layers     1 points, 2 mesh, 3 superquadrics, 4 superquadrics that contain
             the object; - is missing
  x, y, z    middle of its upright box in the map
  yaw deg    direction of the box's first side
  litres     volume of the mesh, or of the box around the points
  held by    the floor, another object as #ID (it rests on it, hangs from it or
             is a part of it), or a wall that it leans on
  away m     with --near: horizontal distance of its middle
with --layers:
  submap     part of the map that moves as one when drift is corrected
  placed by  layer that gives position and size
  views      kept pictures
  outside    share of the checked pieces that are outside of its layer 4"""


def add(commands: Commands) -> None:
    inspect = commands.add("inspect", run)
    inspect.add_argument("map", type=Path, metavar="MAP")
    inspect.add_argument(
        "--sort",
        choices=("id", "distance", "volume", "height", "sightings"),
        help="order of the objects: id, or with --near its distance; distance alone is from the map's origin",
    )
    inspect.add_argument(
        "--near", metavar="X,Y[,R]", help="sort by distance from this position; only within R metres, if R is given"
    )
    inspect.add_argument("--layers", action="store_true", help="show the content, storage and time of the layers, too")
    inspect.add_argument(
        "--min-size", type=float, default=0.0, metavar="M", help="only objects with a side of this length or more"
    )
    add_at(inspect)
    inspect.epilog = f"{inspect.epilog}\n\n{_WORDS}"


def run(options: argparse.Namespace) -> int:
    from hickory_stream.inspection.inspect import as_json, chosen, format_table, summarize
    from hickory_stream.map_folder.history.candidates import candidates_of, why_no_objects
    from hickory_stream.map_folder.manifest import read_json

    near, within_m = _near(options.near)
    if not 0 <= options.min_size < float("inf"):
        raise InputError(f"found --min-size {options.min_size:g}, expected metres, 0 or more")
    sort: SortBy = options.sort or ("id" if near is None else "distance")
    origin = (0.0, 0.0) if near is None and sort == "distance" else near
    found = summarize(open_map_at(options.map, options.at))
    summary = chosen(found, sort=sort, near=origin or (0.0, 0.0), within_m=within_m, min_size_m=options.min_size)
    if options.json:
        print(output("inspect", as_json(summary), indent=1))
    else:
        print(format_table(summary, with_layers=options.layers, near=origin))
    # A run that goes on, or was killed, has no ledger yet, and may find objects.
    if found.objects or options.at is not None or not (options.map / "ledger.json").is_file():
        return 0
    sys.stdout.flush()
    sys.stderr.write(f"{why_no_objects(read_json(options.map, 'ledger.json'), candidates_of(options.map, ()))}\n")
    return INCOMPLETE


def _near(text: str | None) -> tuple[tuple[float, float] | None, float | None]:
    if text is None:
        return None, None
    place, _, radius = text.rpartition(",") if text.count(",") == 2 else (text, "", "")
    try:
        within_m = float(radius) if radius else None
    except ValueError:
        within_m = -1.0
    if within_m is not None and not 0 <= within_m < float("inf"):
        raise InputError(f"found --near {text}, expected X,Y,R in metres, R 0 or more, e.g. --near=1.5,-2,0.5")
    return parse_place(place, "--near"), within_m
