"""A plan as a Rerun recording: layer 4, the grid on the floor, the path, and the robot that drives it on a timeline."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.geometry.palette import color_of_id
from hickory_stream.geometry.superquadric_surface import display_mesh
from hickory_stream.navigation.free_space import layer_four_of, obstacles_of
from hickory_stream.navigation.search import NoPath
from hickory_stream.sinks.rerun_items import new_stream

if TYPE_CHECKING:
    from pathlib import Path as FilePath

    from numpy.typing import NDArray

    from hickory_stream.navigation.free_space import FreeSpace
    from hickory_stream.navigation.robot import Posture
    from hickory_stream.navigation.search import Path
    from hickory_stream.records import MapSnapshot

TIMELINE = "path_m"
_STEP_M = 0.05
_LIFT_M = 0.01


def write_plan(path: FilePath, snapshot: MapSnapshot, space: FreeSpace, answer: Path | NoPath) -> None:
    """Write an .rrd; the timeline `path_m` is the length driven, in metres.

    Raises:
        OSError: the file cannot be written.
    """
    import rerun as rr

    path.open("wb").close()
    stream = new_stream(f"plan-{path.stem}")
    stream.save(path)
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for tracked in obstacles_of(snapshot):
        inflated = layer_four_of(tracked)
        for i in range(len(inflated)):
            vertices, faces = display_mesh(inflated, i)
            mesh = rr.Mesh3D(
                vertex_positions=vertices, triangle_indices=faces, albedo_factor=(*color_of_id(tracked.id), 150)
            )
            stream.log(f"world/layer4/{tracked.id}/{i}", mesh, static=True)
    stream.log("world/grid", _grid(space), static=True)
    if not isinstance(answer, NoPath):
        z = space.floor_z_m + _LIFT_M
        points = np.column_stack([answer.points, np.full(len(answer.points), z)])
        stream.log("world/path", rr.LineStrips3D([points], colors=(28, 98, 196), radii=0.015), static=True)
        _drive(stream, space, answer)
    stream.disconnect()


def _grid(space: FreeSpace) -> Any:
    """Return the cells that are blocked in every posture and heading, as squares on the floor."""
    import rerun as rr

    centers = space.frame.centers_m()[space.blocked().all(axis=(0, 1))]
    half = np.array([space.frame.cell_m / 2, space.frame.cell_m / 2, 0.001])
    return rr.Points3D(
        np.column_stack([centers, np.full(len(centers), space.floor_z_m)]), colors=(90, 96, 108), radii=float(half[0])
    )


def _drive(stream: Any, space: FreeSpace, answer: Path) -> None:
    driven = 0.0
    for i, (start, end) in enumerate(zip(answer.points[:-1], answer.points[1:], strict=True)):
        length = float(np.linalg.norm(end - start))
        posture = space.robot.postures[int(answer.postures[i])]
        for share in np.linspace(0, 1, max(int(length / _STEP_M), 1) + 1):
            stream.reset_time()
            stream.set_time(TIMELINE, duration=driven + share * length)
            place = start + share * (end - start)
            stream.log("world/robot", _body(posture, place, float(answer.headings_rad[i]), space.floor_z_m))
        driven += length


def _body(posture: Posture, place: NDArray[np.float64], heading_rad: float, floor_z_m: float) -> Any:
    """Return the parts of a body as their bounding boxes, turned with the robot."""
    import rerun as rr

    centers, halves = [], []
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    for part in posture.parts:
        round_m = part.disc_m + part.ball_m
        low, high = part.corners_m.min(axis=0) - round_m, part.corners_m.max(axis=0) + round_m
        middle = np.array([[c, -s], [s, c]]) @ ((low + high) / 2) + place
        bottom, top = part.low_m - part.ball_m, part.high_m + part.ball_m
        centers.append([*middle, floor_z_m + (bottom + top) / 2])
        halves.append([*((high - low) / 2), (top - bottom) / 2])
    turn = rr.Quaternion(xyzw=[0.0, 0.0, np.sin(heading_rad / 2), np.cos(heading_rad / 2)])
    return rr.Boxes3D(
        centers=centers,
        half_sizes=halves,
        quaternions=[turn] * len(centers),
        colors=(238, 138, 48),
        labels=posture.name,
    )
