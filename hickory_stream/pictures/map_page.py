"""One HTML file that shows a map in a browser, without an installation or a network.

three.js comes from the notebook viewer in trimesh, with its loader of GLB; its licence (MIT) stays in the page.
"""

from __future__ import annotations

import base64
import gzip
import html
import io
import zipfile
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.base.json_text import dumps
from hickory_stream.base.terminal import visible
from hickory_stream.errors import InputError
from hickory_stream.geometry.display import color_of_id
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.superquadric_surface import display_mesh
from hickory_stream.geometry.voxels import centers_of_keys
from hickory_stream.pictures.legend import FIXTURE, FIXTURE_TEXT, GENERATED, GENERATED_TEXT
from hickory_stream.records import Phase, kind_text, number_of_kinds
from hickory_stream.storeys import floor_of, floors_of

if TYPE_CHECKING:
    import trimesh
    from numpy.typing import NDArray

    from hickory_stream.geometry.superquadric import Superquadrics
    from hickory_stream.map_folder.saved_map import SavedMap
    from hickory_stream.records import MapSnapshot, TrackedObject

_PAGE = Path(__file__).with_suffix(".html")
_BEGIN, _END = "<script>", "THREE.GLTFLoader=GLTFLoader;})();"
_FLOOR_COLOR, _WALL_COLOR, _FLOOR_BAND_M, _CUT_M = (150, 154, 162), (176, 180, 190), 0.1, 2.0
_GRID_STEPS_M = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 50.0)
_MOST_GRID_CELLS, _MOST_TAGS = 24, 60


def map_page(saved: SavedMap, meshes: trimesh.Scene) -> bytes:
    """Return the page of a map, to whose `meshes` (a node `object-ID` each, z up) the other layers are added.

    Raises `InputError`: trimesh came without three.js.
    """
    snapshot = saved.snapshot
    objects = [tracked for tracked in snapshot.objects if tracked.phase != Phase.TENTATIVE]
    floor_m = floor_of(snapshot)
    for tracked in objects:
        _add_cloud(meshes, f"points-{tracked.id}", tracked.points_world, tracked.colors)
        _add_surface(meshes, f"superquadrics-{tracked.id}", tracked.superquadrics)
        _add_surface(meshes, f"inflated-{tracked.id}", None if tracked.shape is None else tracked.shape.inflated)
    _add_room(meshes, snapshot)
    corners = np.concatenate([np.empty((0, 3)), *(tracked.box.corners_world() for tracked in objects)])
    if not len(corners):
        corners = np.array([[-1.0, -1.0, floor_m], [1.0, 1.0, floor_m + 1.0]])
    grid = _grid(corners, floor_m)
    data = {
        "objects": [_facts(tracked, meshes) for tracked in objects],
        "bounds": [corners.min(axis=0).tolist(), corners.max(axis=0).tolist()],
        "grid": grid,
        "generated": GENERATED,
        "room_m": 0.4 * max((submap.observed_space.voxel_m for submap in snapshot.submaps), default=0.05),
        "legend": [
            (FIXTURE, FIXTURE_TEXT),
            (GENERATED, GENERATED_TEXT),
            (_FLOOR_COLOR, f"floor grid of {grid['step']:g} m; x red, y green"),
        ],
        "switches": [
            ("points", "1 points", False),
            ("object", "2 meshes", True),
            ("superquadrics", "3 superquadrics", False),
            ("inflated", "4 inflated", False),
            ("tint", "tint of generated", True),
            ("room", "floor and walls", True),
            ("grid", "grid", True),
            ("tags", "ids", len(objects) <= _MOST_TAGS),
        ],
    }
    num_floors = len(floors_of(snapshot)) or 1
    name = str(saved.manifest.source.get("uri", saved.folder.name)).rstrip("/").rsplit("/", maxsplit=1)[-1]
    parts = {
        "title": html.escape(visible(name)),
        "about": f"{number_of_kinds(objects)}, {num_floors} floor{'' if num_floors == 1 else 's'}; metres, z up",
        "three": three_js(),
        # No text of the data ends its element.
        "data": dumps(data).replace("<", "\\u003c"),
        "map": base64.b64encode(gzip.compress(meshes.export(file_type="glb"), mtime=0)).decode(),
    }
    first, *rest = _PAGE.read_text(encoding="utf-8").split("{{")
    filled = [parts[key] + text for key, text in (piece.split("}}", 1) for piece in rest)]
    return "".join([first, *filled]).encode()


def three_js() -> str:
    """Return the script of three.js with its licence and loader of GLB; raises `InputError` without one."""
    import trimesh

    try:
        with zipfile.ZipFile(io.BytesIO(trimesh.resources.get_bytes("templates/viewer.zip"))) as packed:
            text = packed.read("viewer.html.template").decode()
        begin = text.index(_BEGIN) + len(_BEGIN)
        return text[begin : text.index(_END, begin) + len(_END)]
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
        version = metadata.version("trimesh")
        raise InputError(f"trimesh {version} brings no three.js for the page ({error}); install trimesh 5.2") from error


def _facts(tracked: TrackedObject, meshes: trimesh.Scene) -> dict[str, Any]:
    size = " x ".join(f"{2 * half_m:.2f}" for half_m in tracked.box.half_extents_m) + " m"
    lines = [
        f"#{tracked.id}, {kind_text(tracked.fixture_probability)}, {tracked.phase}, {tracked.sightings} sightings",
        f"size {size}",
        "centre " + ", ".join(f"{value:.2f}" for value in tracked.box.center) + " m",
        f"{len(tracked.points_world)} points",
    ]
    if tracked.shape is not None:
        seen = meshes.geometry[f"object-{tracked.id}"].vertex_attributes["_SEEN"].mean()
        lines.append(f"mesh: {seen:.0%} of its vertices seen, the rest generated")
        lines.append(f"{len(tracked.shape.fitted)} superquadrics, {len(tracked.shape.inflated)} inflated")
    return {
        "id": tracked.id,
        "size": size,
        "color": color_of_id(tracked.id, is_fixture=tracked.is_fixture),
        "box": tracked.box.corners_world().tolist(),
        "text": "\n".join(lines),
    }


def _grid(corners: NDArray[np.float64], floor_m: float) -> dict[str, Any]:
    low, high = corners[:, :2].min(axis=0) - 0.5, corners[:, :2].max(axis=0) + 0.5
    widest_m = float((high - low).max())
    step_m = next((step for step in _GRID_STEPS_M if widest_m / step <= _MOST_GRID_CELLS), _GRID_STEPS_M[-1])
    first = np.floor(low / step_m)
    cells = (np.ceil(high / step_m) - first).astype(int)
    return {"low": (first * step_m).tolist(), "step": step_m, "cells": cells.tolist(), "z": floor_m}


def _add_room(meshes: trimesh.Scene, snapshot: MapSnapshot) -> None:
    spaces = [(submap.world_from_submap, submap.observed_space) for submap in snapshot.submaps]
    clouds = [apply(pose, centers_of_keys(space.structure, space.voxel_m)) for pose, space in spaces]
    floors = np.array(floors_of(snapshot) or (floor_of(snapshot),))
    points = np.concatenate([np.empty((0, 3)), *clouds])
    # The ceiling of the top storey would hide the rooms.
    points = points[points[:, 2] <= floors.max() + _CUT_M]
    is_floor = (np.abs(points[:, 2:] - floors) <= _FLOOR_BAND_M).any(axis=1)
    _add_cloud(meshes, "room", points, np.where(is_floor[:, None], _FLOOR_COLOR, _WALL_COLOR).astype(np.uint8))


def _add_cloud(meshes: trimesh.Scene, name: str, points: NDArray[Any], colors: NDArray[np.uint8]) -> None:
    import trimesh

    if len(points):
        meshes.add_geometry(trimesh.PointCloud(points, colors=colors), node_name=name, geom_name=name)


def _add_surface(meshes: trimesh.Scene, name: str, primitives: Superquadrics | None) -> None:
    import trimesh

    if primitives is not None and len(primitives):
        parts = [trimesh.Trimesh(*display_mesh(primitives, i), process=False) for i in range(len(primitives))]
        meshes.add_geometry(trimesh.util.concatenate(parts), node_name=name, geom_name=name)
