"""`hickory-stream export`: a map in a format that other programs read."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.cli.values import add_unproven_argument, open_proven_map_at, robot_of_option
from hickory_stream.cli.written import add_output, refuse_taken, written_text
from hickory_stream.engine.atomic import write_output
from hickory_stream.errors import InputError
from hickory_stream.json_text import dumps_exactly
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from hickory_stream.cli.commands import Commands
    from hickory_stream.engine.saved_map import SavedMap


# Structure above is ceiling to a robot.
_WALL_HEIGHT_M = 2.0
_MOST_TOLD = 3


def add(commands: Commands, common: argparse.ArgumentParser, _configured: argparse.ArgumentParser) -> None:
    """Add the command to the command line."""
    export = commands.add_parser("export", parents=[common], help="write a map in another format")
    export.set_defaults(run=run)
    export.add_argument("map", type=Path, metavar="MAP")
    export.add_argument(
        "--format",
        choices=sorted((*_WRITERS, *_SEVERAL)),
        default="json",
        help="json (default): all records; ply: layer 1 of all objects; glb: layer 2, one named node an object, y up, "
        "_SEEN per vertex; nav2: a grid for map_server (YAML and PGM); mjcf, urdf: a folder for simulators, layer 2 to "
        "see, layer 4 to touch",
    )
    add_output(
        export,
        "-o",
        "--out",
        type=Path,
        metavar="FILE",
        help="default: MAP with the ending of the format, yaml for nav2",
    )
    export.add_argument(
        "--robot", metavar="NAME|FILE", help="nav2: whose heights count; its footprint does not. nav2 needs it"
    )
    export.add_argument(
        "--cell", type=float, default=0.05, metavar="M", help="nav2: the side of a cell, default 0.05 m"
    )
    export.add_argument(
        "--at", metavar="T", help="as it was known then: seconds from the first keyframe, or a stamp like 17...ns"
    )
    add_unproven_argument(export)


def run(options: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    saved, doubt = open_proven_map_at(options)
    ending = "yaml" if options.format == "nav2" else options.format
    out = options.out or options.map.with_suffix(f".{ending}")
    refuse_taken([out], overwrite=options.overwrite)
    if options.format in _SEVERAL:
        files = _SEVERAL[options.format](saved, out, options)
    else:
        files = {out: _WRITERS[options.format](saved)}
    refuse_taken(files, overwrite=options.overwrite)
    try:
        for path, data in files.items():
            if options.format in _SEVERAL:
                path.parent.mkdir(parents=True, exist_ok=True)
            write_output(path, data)
    except OSError as error:
        raise InputError(f"cannot write {out}: {error.strerror}; choose another --out") from error
    if options.json:
        told = {"file": str(out), "format": options.format, "objects": len(saved.snapshot.objects)}
        told |= {"unproven": doubt or None}
        print(output("export", told if len(files) == 1 else told | {"files": len(files)}))
    else:
        if doubt:
            sys.stderr.write(f"note: layer 4 is not proven: {doubt}\n")
        # A file that was named is told of with those of all commands.
        told_of = [path for path in files if path != options.out]
        if len(told_of) > _MOST_TOLD:
            size = sum(len(data) for data in files.values()) / 1024**2
            print(f"{out}: {len(files)} files, {size:.2f} MiB")
        else:
            print("".join(f"{written_text(path)}\n" for path in told_of), end="")
    return 0


def _json(saved: SavedMap) -> bytes:
    from hickory_stream.engine.map_codec import encode_snapshot

    return dumps_exactly(encode_snapshot(saved.snapshot)[0], indent=1).encode()


def _ply(saved: SavedMap) -> bytes:
    import numpy as np

    from hickory_stream.engine.array_files import ply_bytes

    objects = saved.snapshot.objects
    points = [np.zeros((0, 3), dtype=np.float32), *(tracked.points_world for tracked in objects)]
    colors = [np.zeros((0, 3), dtype=np.uint8), *(tracked.colors for tracked in objects)]
    return ply_bytes(np.concatenate(points), np.concatenate(colors))


def _glb(saved: SavedMap) -> bytes:
    """Return a scene of glTF, which is y up; `_SEEN` of a vertex is 1 where the surface was seen, 0 where completed."""
    import numpy as np
    import trimesh

    gltf_from_world = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    scene = trimesh.Scene()
    for tracked in saved.snapshot.objects:
        if tracked.shape is not None:
            mesh = saved.mesh(tracked.shape)
            opaque = np.full(len(mesh.colors), 255, dtype=np.uint8)
            shown = trimesh.Trimesh(
                mesh.vertices, mesh.faces, vertex_colors=np.column_stack([mesh.colors, opaque]), process=False
            )
            shown.vertex_attributes["_SEEN"] = mesh.is_seen.astype(np.float32)
            name = f"object-{tracked.id}"
            pose = gltf_from_world @ tracked.shape.world_from_object
            scene.add_geometry(shown, node_name=name, geom_name=name, transform=pose)
    if not scene.geometry:
        raise InputError(f"{saved.folder} holds no meshes; export --format ply writes the points")
    exported: bytes = scene.export(file_type="glb")
    return exported


def _nav2(saved: SavedMap, out: Path, options: argparse.Namespace) -> dict[Path, bytes]:
    from hickory_stream.navigation.free_space import obstacle_grid
    from hickory_stream.navigation.nav2 import pgm_of, yaml_of

    grid = obstacle_grid(saved.snapshot, robot_of_option(options.robot, "--robot"), cell_m=options.cell)
    picture = out.with_suffix(".pgm")
    if picture == out:
        raise InputError(f"found --out {out}, expected the name of the YAML file; the picture lies beside it")
    return {picture: pgm_of(grid.states()), out: yaml_of(grid.frame, picture.name).encode()}


def _simulated(saved: SavedMap, out: Path, options: argparse.Namespace) -> dict[Path, bytes]:
    import numpy as np

    from hickory_stream.navigation.free_space import floor_of, layer_four_of, obstacles_of
    from hickory_stream.navigation.observed import Band
    from hickory_stream.navigation.simulators import SimulatedObject, mjcf_files, urdf_files
    from hickory_stream.navigation.walls import wall_boxes

    snapshot = saved.snapshot
    objects = [
        SimulatedObject(
            name=f"object-{tracked.id}",
            mesh=None if tracked.shape is None else saved.mesh(tracked.shape),
            world_from_object=tracked.box.world_from_box if tracked.shape is None else tracked.shape.world_from_object,
            inflated=layer_four_of(tracked),
        )
        for tracked in obstacles_of(snapshot)
    ]
    floor = floor_of(snapshot)
    band = Band(low_m=floor, high_m=floor + _WALL_HEIGHT_M)
    bodies = [item.inflated for item in objects]
    walls = [np.empty((0, 8, 3)), *(wall_boxes(submap, band, floor, bodies) for submap in snapshot.submaps)]
    files = mjcf_files if options.format == "mjcf" else urdf_files
    made = files(objects, np.concatenate(walls), floor, out.stem)
    return {out / name: data for name, data in made.items()}


_WRITERS: dict[str, Callable[[SavedMap], bytes]] = {"json": _json, "ply": _ply, "glb": _glb}
_SEVERAL: dict[str, Callable[[SavedMap, Path, argparse.Namespace], dict[Path, bytes]]] = {
    "nav2": _nav2,
    "mjcf": _simulated,
    "urdf": _simulated,
}
