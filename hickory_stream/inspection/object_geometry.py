"""Position and geometry of an object from its best layer: its mesh, else its points."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.boxes import OrientedBox, gravity_aligned_box
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import apply
from hickory_stream.records import TrackedObject

_MIN_HALF_EXTENT_M = 0.001
_COLOR_BITS = 3


@dataclass(frozen=True, kw_only=True, slots=True)
class Place:
    """An upright box in the map's frame around the object's layer 2, or 1 (`layer`)."""

    layer: int
    center_m: tuple[float, float, float]
    #: direction of the first side from the x axis about the vertical, in 0 to 180
    yaw_deg: float
    #: sides along the yaw, across it, and upright
    size_m: tuple[float, float, float]
    #: of the mesh; of the box for layer 1
    volume_m3: float
    #: dominant colour of the points, #rrggbb
    color: str


def place_of(tracked: TrackedObject, mesh: Mesh | None) -> Place:
    """Return the pose and size of an object; `mesh` is its layer 2, None if it has none."""
    color = _dominant(tracked.colors)
    if mesh is not None and tracked.shape is not None and len(mesh.vertices):
        box = gravity_aligned_box(apply(tracked.shape.world_from_object, mesh.vertices), _MIN_HALF_EXTENT_M)
        return _placed(box, 2, _enclosed_m3(mesh), color)
    points = tracked.points_world
    box = gravity_aligned_box(points, _MIN_HALF_EXTENT_M) if len(points) else tracked.box
    return _placed(box, 1, box.volume_m3, color)


def _placed(box: OrientedBox, layer: int, volume_m3: float, color: str) -> Place:
    x, y, z = (round(float(part), 4) for part in box.center)
    length, width, height = (round(2 * float(half), 4) for half in box.half_extents_m)
    forward = box.world_from_box[:3, 0]
    yaw_deg = round(float(np.degrees(np.arctan2(forward[1], forward[0]))), 2) % 180.0
    return Place(
        layer=layer,
        center_m=(x, y, z),
        yaw_deg=yaw_deg,
        size_m=(length, width, height),
        volume_m3=round(volume_m3, 7),
        color=color,
    )


def _enclosed_m3(mesh: Mesh) -> float:
    """Return the volume inside a closed mesh, by the divergence theorem; its centre is the origin, for precision."""
    vertices = mesh.vertices.astype(np.float64)
    vertices -= vertices.mean(axis=0)
    a, b, c = (vertices[mesh.faces[:, i]] for i in range(3))
    return abs(float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum())) / 6


def _dominant(colors: NDArray[np.uint8]) -> str:
    # The mean colour of the most populated cell of a coarse RGB grid.
    if not len(colors):
        return "#000000"
    cells = colors.astype(np.int64) >> (8 - _COLOR_BITS)
    keys = (cells[:, 0] << 2 * _COLOR_BITS) | (cells[:, 1] << _COLOR_BITS) | cells[:, 2]
    fullest = colors[keys == np.bincount(keys).argmax()]
    red, green, blue = np.round(fullest.mean(axis=0)).astype(int)
    return f"#{red:02x}{green:02x}{blue:02x}"
