"""`hickory-stream export`: write a map in a format of other programs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.base.atomic_files import write_output
from hickory_stream.base.json_text import dumps_exactly
from hickory_stream.cli.option_values import (
    add_allow_unverified,
    add_at,
    add_floor_argument,
    add_texture_argument,
    floor_of_option,
    open_verified_map_at,
    robot_of_option,
)
from hickory_stream.cli.output_files import add_output, refuse_taken, written_text
from hickory_stream.errors import InputError, MapFolderError
from hickory_stream.outputs import output
from hickory_stream.textures import DEFAULT_TEXTURE_PX

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    import trimesh

    from hickory_stream.cli.commands import Commands
    from hickory_stream.geometry.mesh import Mesh
    from hickory_stream.map_folder.saved_map import SavedMap
    from hickory_stream.records import TrackedObject
    from hickory_stream.textures.textured_mesh import TexturedMesh


# Higher structure does not matter to a robot.
_WALL_HEIGHT_M = 2.0
_MAX_LISTED = 3
#: The endings of a format's file, by default the first one; mjcf and urdf write a folder.
_ENDINGS = {
    **{name: (f".{name}",) for name in ("json", "ply", "glb", "stl", "obj", "tum")},
    "html": (".html", ".htm"),
    "nav2": (".yaml", ".yml"),
    "mjcf": (),
    "urdf": (),
}


def add(commands: Commands) -> None:
    export = commands.add("export", run)
    export.add_argument("map", type=Path, metavar="MAP")
    export.add_argument(
        "--format",
        choices=sorted((*_WRITERS, *_SEVERAL)),
        help="default: as FILE ends, else json; json: all records; html: a page that shows the map; ply: layer 1; "
        "glb: layer 2, a named node an object, y up, _SEEN per vertex, kinds in `extras`; stl, obj: layer 2, z up; "
        "tum: camera poses; "
        "nav2: a grid for map_server (YAML and PGM); mjcf, urdf: a simulator folder, layer 2 visual, layer 4 collision",
    )
    add_output(
        export,
        "-o",
        "--out",
        type=Path,
        metavar="FILE",
        help="default: MAP with the ending of the format, yaml for nav2",
    )
    export.add_argument("--robot", metavar="NAME|FILE", help="nav2: robot whose height range counts (required)")
    export.add_argument("--cell", type=float, default=0.05, metavar="M", help="nav2: side of a cell, default 0.05 m")
    add_at(export)
    add_floor_argument(export, "nav2, mjcf, urdf: storey of a map with several")
    add_texture_argument(export, "glb, html, mjcf, urdf: the side of an object's texture", DEFAULT_TEXTURE_PX)
    add_allow_unverified(export)


def run(options: argparse.Namespace) -> int:
    options.format = _format_of(options.format, options.out)
    saved, doubt = open_verified_map_at(options)
    out = options.out or options.map.with_suffix((*_ENDINGS[options.format], f".{options.format}")[0])
    refuse_taken([out], overwrite=options.overwrite)
    if options.format in _SEVERAL:
        files = _SEVERAL[options.format](saved, out, options)
        num_open = 0
    else:
        data, num_open = _WRITERS[options.format](saved, options)
        files = {out: data}
    refuse_taken(files, overwrite=options.overwrite)
    try:
        for path, data in files.items():
            if options.format in _SEVERAL:
                path.parent.mkdir(parents=True, exist_ok=True)
            write_output(path, data)
    except OSError as error:
        raise InputError(f"cannot write {out}: {error.strerror}; choose another --out") from error
    if options.json:
        report = {"file": str(out), "format": options.format, "objects": len(saved.snapshot.objects)}
        report |= {"unproven": doubt or None, "open_meshes": num_open}
        print(output("export", report if len(files) == 1 else report | {"files": len(files)}))
    else:
        if doubt:
            sys.stderr.write(f"note: layer 4 is not proven: {doubt}\n")
        if num_open:
            has_seams = options.format == "glb" and options.texture
            reason = "; textures double the vertices at their seams, --texture 0 does not" if has_seams else ""
            sys.stderr.write(f"note: {num_open} of the meshes are not watertight{reason}\n")
        # `main` reports the named file.
        unnamed = [path for path in files if path != options.out]
        if len(unnamed) > _MAX_LISTED:
            size = sum(len(data) for data in files.values()) / 1024**2
            print(f"{out}: {len(files)} files, {size:.2f} MiB")
        else:
            print("".join(f"{written_text(path)}\n" for path in unnamed), end="")
    return 0


def _format_of(name: str | None, out: Path | None) -> str:
    of_ending = {ending: name for name, endings in _ENDINGS.items() for ending in endings}
    ending = "" if out is None else out.suffix.lower()
    if name is None:
        if out is not None and ending not in of_ending:
            known = ", ".join(of_ending)
            raise InputError(f"found -o {out}, expected a name that ends in {known}; or choose a --format")
        return of_ending.get(ending, "json")
    if ending and ending not in _ENDINGS[name] and (_ENDINGS[name] or ending in of_ending):
        expected = " or ".join(_ENDINGS[name])
        expected = f"a name that ends in {expected}" if expected else "the name of a folder"
        raise InputError(f"found --format {name} and -o {out}, expected {expected}; leave out one of them")
    return name


def _json(saved: SavedMap, options: argparse.Namespace) -> bytes:
    from hickory_stream.map_folder.codec import encode_snapshot
    from hickory_stream.map_folder.layout import OBJECTS
    from hickory_stream.map_folder.manifest import json_of, read_file

    if saved.is_sealed and options.at is None:
        # The saved document names points and voxels by their hashes, so that these need not be read.
        document = json_of(saved.folder, OBJECTS, read_file(saved.folder, OBJECTS))
    else:
        document, _ = encode_snapshot(saved.snapshot)
    return dumps_exactly(document, indent=1).encode()


def _ply(saved: SavedMap, _options: argparse.Namespace) -> bytes:
    import numpy as np

    from hickory_stream.map_folder.array_files import ply_bytes

    objects = saved.snapshot.objects
    points = [np.zeros((0, 3), dtype=np.float32), *(tracked.points_world for tracked in objects)]
    colors = [np.zeros((0, 3), dtype=np.uint8), *(tracked.colors for tracked in objects)]
    return ply_bytes(np.concatenate(points), np.concatenate(colors))


def _texture_of(
    saved: SavedMap, tracked: TrackedObject, options: argparse.Namespace, mesh: Mesh
) -> TexturedMesh | None:
    if not options.texture:
        return None
    from hickory_stream.map_folder.textured_objects import textured_object

    try:
        return textured_object(saved.views, tracked, mesh, options.texture, is_past=options.at is not None)
    except MapFolderError as error:
        raise MapFolderError(f"{error}, or write object {tracked.id} without texture: --texture 0") from error


def _scene(saved: SavedMap, options: argparse.Namespace, *, has_texture: bool) -> trimesh.Scene:
    """Return layer 2, z up; `_SEEN` of a vertex is 1 where the surface was seen, 0 where it was completed."""
    import numpy as np
    import trimesh

    from hickory_stream.textures.textured_mesh import trimesh_visual

    scene = trimesh.Scene()
    for tracked in saved.snapshot.objects:
        if tracked.shape is not None:
            mesh = saved.mesh(tracked.shape)
            textured = _texture_of(saved, tracked, options, mesh) if has_texture else None
            if textured is None:
                visual = trimesh.visual.ColorVisuals(vertex_colors=mesh.colors)
            else:
                mesh, visual = textured.mesh, trimesh_visual(textured)
            shown = trimesh.Trimesh(mesh.vertices, mesh.faces, visual=visual, process=False)
            shown.vertex_attributes["_SEEN"] = mesh.is_seen.astype(np.float32)
            shown.metadata = {"kind": tracked.kind.value, "fixture_probability": tracked.fixture_probability}
            # The page switches its meshes by name.
            name = f"{'object' if options.format == 'html' else tracked.kind}-{tracked.id}"
            scene.add_geometry(shown, node_name=name, geom_name=name, transform=tracked.shape.world_from_object)
    return scene


def _meshes(saved: SavedMap, options: argparse.Namespace) -> tuple[bytes, int]:
    """Return the file, and the number of its meshes that are not watertight."""
    import numpy as np
    import trimesh

    scene = _scene(saved, options, has_texture=options.format == "glb")
    if not scene.geometry:
        raise InputError(f"{saved.folder} holds no meshes; write the points with --format ply")
    # STL and OBJ have one frame, whose numbers are rounded: what a reader merges is counted there.
    pieces = scene.geometry.values() if options.format == "glb" else scene.dump()
    num_open = 0
    for piece in pieces:
        read = trimesh.Trimesh(np.float32(piece.vertices), piece.faces, visual=piece.visual, process=False)
        read.merge_vertices()
        num_open += not read.is_watertight
    if options.format == "glb":
        # glTF is y up.
        scene.apply_transform(np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]))
    exported = scene.export(file_type=options.format)
    return exported.encode() if isinstance(exported, str) else exported, num_open


def _html(saved: SavedMap, options: argparse.Namespace) -> bytes:
    from hickory_stream.pictures.map_page import map_page

    return map_page(saved, _scene(saved, options, has_texture=True))


def _tum(saved: SavedMap, options: argparse.Namespace) -> bytes:
    from hickory_stream.cli.logs.odometry import tum_text
    from hickory_stream.map_folder.history.recorded import corrected_trajectory

    poses = corrected_trajectory(saved.folder, None if options.at is None else saved.snapshot)
    if not poses:
        raise InputError(f"{saved.folder} holds no poses of the camera: its run has no keyframe yet")
    return tum_text(list(poses), list(poses.values())).encode()


def _nav2(saved: SavedMap, out: Path, options: argparse.Namespace) -> dict[Path, bytes]:
    from hickory_stream.navigation.free_space import obstacle_grid
    from hickory_stream.navigation.nav2 import pgm_of, yaml_of

    robot, floor_m = robot_of_option(options.robot, "--robot"), floor_of_option(saved.snapshot, options.floor)
    grid = obstacle_grid(saved.snapshot, robot, cell_m=options.cell, floor_m=floor_m)
    picture = out.with_suffix(".pgm")
    if picture == out:
        raise InputError(f"found --out {out}, expected the name of the YAML file, not of its picture")
    return {picture: pgm_of(grid.states()), out: yaml_of(grid.frame, picture.name).encode()}


def _simulated(saved: SavedMap, out: Path, options: argparse.Namespace) -> dict[Path, bytes]:
    from hickory_stream.navigation.free_space import layer_four_of, obstacles_of
    from hickory_stream.navigation.observed import Band
    from hickory_stream.navigation.simulators import SimulatedObject, mjcf_files, urdf_files
    from hickory_stream.navigation.walls import wall_boxes
    from hickory_stream.storeys import on_storey

    floor = floor_of_option(saved.snapshot, options.floor)
    snapshot = on_storey(saved.snapshot, floor)
    meshes = {tracked.id: saved.mesh(tracked.shape) for tracked in snapshot.objects if tracked.shape is not None}
    objects = [
        SimulatedObject(
            name=f"{tracked.kind}-{tracked.id}",
            mesh=meshes.get(tracked.id),
            texture=_texture_of(saved, tracked, options, meshes[tracked.id]) if tracked.id in meshes else None,
            world_from_object=tracked.box.world_from_box if tracked.shape is None else tracked.shape.world_from_object,
            inflated=layer_four_of(tracked),
        )
        for tracked in obstacles_of(snapshot)
    ]
    band = Band(low_m=floor, high_m=floor + _WALL_HEIGHT_M)
    bodies = [item.inflated for item in objects]
    walls = wall_boxes(snapshot.submaps, band, floor, bodies)
    files = mjcf_files if options.format == "mjcf" else urdf_files
    made = files(objects, walls, floor, out.stem)
    return {out / name: data for name, data in made.items()}


def _without_meshes(
    write: Callable[[SavedMap, argparse.Namespace], bytes],
) -> Callable[[SavedMap, argparse.Namespace], tuple[bytes, int]]:
    return lambda saved, options: (write(saved, options), 0)


_WRITERS: dict[str, Callable[[SavedMap, argparse.Namespace], tuple[bytes, int]]] = {
    **{
        name: _without_meshes(write) for name, write in {"json": _json, "ply": _ply, "html": _html, "tum": _tum}.items()
    },
    **dict.fromkeys(("glb", "stl", "obj"), _meshes),
}
_SEVERAL: dict[str, Callable[[SavedMap, Path, argparse.Namespace], dict[Path, bytes]]] = {
    "nav2": _nav2,
    "mjcf": _simulated,
    "urdf": _simulated,
}
