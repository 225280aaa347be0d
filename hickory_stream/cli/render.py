"""`hickory-stream render`: draw a map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.cli.values import open_map_at, parse_layers, parse_size
from hickory_stream.cli.written import add_output, write_picture
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse

    from hickory_stream.cli.commands import Commands


def add(commands: Commands, common: argparse.ArgumentParser, _configured: argparse.ArgumentParser) -> None:
    """Add the command to the command line."""
    render = commands.add_parser("render", parents=[common], help="draw a map; needs no screen")
    render.set_defaults(run=run)
    render.add_argument("map", type=Path, metavar="MAP")
    add_output(render, "-o", "--out", type=Path, default=Path("map.png"), metavar="PNG")
    render.add_argument("--layers", default="1,2", help="which layers to draw, e.g. 1,2 (default) or 3,4")
    render.add_argument(
        "--at", metavar="T", help="as it was known then: seconds from the first keyframe, or a stamp like 17...ns"
    )
    render.add_argument("--size", default="1600x800", metavar="WxH")


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    from hickory_stream.evaluation.render import render_map

    layers = parse_layers(options.layers)
    width, height = parse_size(options.size)
    saved = open_map_at(options.map, options.at)
    picture = render_map(saved, layers, (width, height))
    write_picture(options.out, picture)
    if options.json:
        print(
            output("render", {"picture": str(options.out), "width": width, "height": height, "layers": sorted(layers)})
        )
    return 0
