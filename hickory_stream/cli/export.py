"""`hickory-stream export`: a map in a format that other programs read."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.cli.values import open_map_at
from hickory_stream.errors import InputError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from hickory_stream.cli.parser import Commands
    from hickory_stream.engine.session import SavedMap


def add(commands: Commands, common: argparse.ArgumentParser, _configured: argparse.ArgumentParser) -> None:
    """Add the command to the command line."""
    export = commands.add_parser("export", parents=[common], help="write a map in another format")
    export.set_defaults(run=run)
    export.add_argument("map", type=Path, metavar="MAP")
    export.add_argument(
        "--format",
        choices=sorted(_WRITERS),
        default="json",
        help="json (default): all records; ply: layer 1 of all objects; glb: layer 2, one named node an object",
    )
    export.add_argument("-o", "--out", type=Path, metavar="FILE", help="default: MAP with the ending of the format")
    export.add_argument(
        "--at", metavar="T", help="as it was known then: seconds from the first keyframe, or a stamp like 17...ns"
    )


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    saved = open_map_at(options.map, options.at)
    out = options.out or options.map.with_suffix(f".{options.format}")
    data = _WRITERS[options.format](saved)
    try:
        out.write_bytes(data)
    except OSError as error:
        raise InputError(f"cannot write {out}: {error.strerror}; choose another --out") from error
    if options.json:
        print(json.dumps({"file": str(out), "format": options.format, "objects": len(saved.snapshot.objects)}))
    return 0


def _json(saved: SavedMap) -> bytes:
    from hickory_stream.engine.map_codec import encode_snapshot

    return json.dumps(encode_snapshot(saved.snapshot)[0], indent=1, allow_nan=False).encode()


def _ply(saved: SavedMap) -> bytes:
    import numpy as np

    from hickory_stream.engine.map_codec import ply_bytes

    objects = saved.snapshot.objects
    points = [np.zeros((0, 3), dtype=np.float32), *(tracked.points_world for tracked in objects)]
    colors = [np.zeros((0, 3), dtype=np.uint8), *(tracked.colors for tracked in objects)]
    return ply_bytes(np.concatenate(points), np.concatenate(colors))


def _glb(saved: SavedMap) -> bytes:
    import numpy as np
    import trimesh

    scene = trimesh.Scene()
    for tracked in saved.snapshot.objects:
        if tracked.shape is not None:
            mesh = saved.mesh(tracked.shape)
            opaque = np.full(len(mesh.colors), 255, dtype=np.uint8)
            shown = trimesh.Trimesh(
                mesh.vertices, mesh.faces, vertex_colors=np.column_stack([mesh.colors, opaque]), process=False
            )
            name = f"object-{tracked.id}"
            scene.add_geometry(shown, node_name=name, geom_name=name, transform=tracked.shape.world_from_object)
    if not scene.geometry:
        raise InputError(f"{saved.folder} holds no meshes; export --format ply writes the points")
    exported: bytes = scene.export(file_type="glb")
    return exported


_WRITERS: dict[str, Callable[[SavedMap], bytes]] = {"json": _json, "ply": _ply, "glb": _glb}
