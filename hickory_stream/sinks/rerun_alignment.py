"""Two maps and their alignment as a Rerun recording: layer 3 of both in one frame, and a line for each pair."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.alignment.answer import Alignment
from hickory_stream.geometry.palette import color_of_id
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.superquadric import moved
from hickory_stream.geometry.superquadric_surface import display_mesh
from hickory_stream.sinks.rerun_items import new_stream

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from hickory_stream.alignment.answer import NoAlignment
    from hickory_stream.alignment.object_map import ObjectMap

_BLUE, _ORANGE = (58, 118, 190), (238, 138, 48)
_GAP = 1.2


def write_alignment(path: Path, map_a: ObjectMap, map_b: ObjectMap, answer: Alignment | NoAlignment) -> None:
    """Write an .rrd: map b lies where the alignment puts it, or beside map a where there is none.

    Raises:
        OSError: the file cannot be written.
    """
    import rerun as rr

    path.open("wb").close()
    stream = new_stream(f"alignment-{path.stem}")
    stream.save(path)
    a_from_b = answer.a_from_b if isinstance(answer, Alignment) else _beside(map_a, map_b)
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for name, objects, pose, color in (("a", map_a, np.eye(4), _BLUE), ("b", map_b, a_from_b, _ORANGE)):
        for object_id, item in zip(objects.ids, _items(objects, pose, color), strict=True):
            stream.log(f"world/{name}/{object_id}", item, static=True)
    if isinstance(answer, Alignment):
        place_a = dict(zip(map_a.ids.tolist(), map_a.centroids, strict=True))
        place_b = dict(zip(map_b.ids.tolist(), apply(a_from_b, map_b.centroids), strict=True))
        ends = [[place_a[pair.id_a], place_b[pair.id_b]] for pair in answer.pairs]
        colors = [color_of_id(pair.id_a) for pair in answer.pairs]
        labels = [f"{pair.id_a} = {pair.id_b}" for pair in answer.pairs]
        stream.log("world/pairs", rr.LineStrips3D(ends, colors=colors, labels=labels, radii=0.01), static=True)
    stream.disconnect()


def _items(objects: ObjectMap, pose: NDArray[np.float64], color: tuple[int, int, int]) -> list[Any]:
    import rerun as rr

    items = []
    for shape, box in zip(objects.shapes, objects.boxes, strict=True):
        if shape is None:
            corners = apply(pose, box.corners_world())
            items.append(rr.Points3D(corners, colors=[color] * len(corners), radii=0.02))
            continue
        placed = moved(shape, pose)
        parts = [display_mesh(placed, i) for i in range(len(placed))]
        starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts[:-1])])
        items.append(
            rr.Mesh3D(
                vertex_positions=np.concatenate([vertices for vertices, _ in parts]),
                triangle_indices=np.concatenate(
                    [faces + start for (_, faces), start in zip(parts, starts, strict=True)]
                ),
                albedo_factor=color,
            )
        )
    return items


def _beside(map_a: ObjectMap, map_b: ObjectMap) -> NDArray[np.float64]:
    """Return the shift that puts map b to the right of map a."""
    pose = np.eye(4)
    if len(map_a) and len(map_b):
        pose[0, 3] = map_a.centroids[:, 0].max() - map_b.centroids[:, 0].min() + _GAP
    return pose
