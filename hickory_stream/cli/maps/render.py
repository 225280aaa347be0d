"""`hickory-stream render`: draw a map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.cli.option_values import (
    add_at,
    add_floor_argument,
    add_texture_argument,
    floor_of_option,
    open_map_at,
    parse_layers,
    parse_size,
)
from hickory_stream.cli.output_files import add_output, check_ending, write_drawing, write_picture
from hickory_stream.errors import InputError
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse

    from hickory_stream.cli.commands import Commands
    from hickory_stream.map_folder.saved_map import SavedMap


def add(commands: Commands) -> None:
    render = commands.add("render", run)
    render.add_argument("map", type=Path, metavar="MAP")
    add_output(render, "-o", "--out", type=Path, default=Path("map.png"), metavar="PNG")
    render.add_argument("--layers", default="1,2", help="layers to draw, e.g. 1,2 (default) or 3,4")
    add_at(render)
    add_floor_argument(render, "draw one storey")
    add_texture_argument(render, "texture of layer 2 from the kept views: side in pixels", 0)
    render.add_argument("--size", default="1600x800", metavar="WxH")
    render.add_argument(
        "--graph",
        action="store_true",
        help="draw the pose graph instead: trajectory before and after, loops, residuals (PNG or SVG)",
    )


def run(options: argparse.Namespace) -> int:
    check_ending(options.out, ".png", *([".svg"] if options.graph else []))
    layers = parse_layers(options.layers)
    width, height = parse_size(options.size)
    saved = open_map_at(options.map, options.at)
    if options.graph:
        _draw_graph(saved, options.out, (width, height))
    else:
        from hickory_stream.pictures.render import render_map

        floor_m = None if options.floor is None else floor_of_option(saved.snapshot, options.floor)
        write_picture(options.out, render_map(saved, layers, (width, height), options.texture, floor_m))
    if options.json:
        shown = [] if options.graph else sorted(layers)
        report = {
            "picture": str(options.out),
            "width": width,
            "height": height,
            "layers": shown,
            "graph": options.graph,
        }
        print(output("render", report))
    return 0


def _draw_graph(saved: SavedMap, out: Path, size: tuple[int, int]) -> None:
    from hickory_stream.pictures.render_graph import recorded_ways, render_graph

    ways = recorded_ways(saved)
    if saved.snapshot.graph is None or ways is None:
        raise InputError(f"{saved.folder} has no pose graph; map its log again with the search for loops")
    write_drawing(out, render_graph(saved.snapshot.graph, ways, size))
