"""A plan as a Rerun recording: layer 4, floor cells, the path, and the moving robot.

Cells, path and robot lie at different heights, since coplanar surfaces flicker.
"""

from pathlib import Path as FilePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.display import color_of_id
from hickory_stream.navigation.free_space import FreeSpace, layer_four_of, obstacles_of
from hickory_stream.navigation.observed import rectangles
from hickory_stream.navigation.robot import Posture
from hickory_stream.navigation.search import NoPath, Path
from hickory_stream.records import MapSnapshot
from hickory_stream.sinks.rerun.items import new_stream
from hickory_stream.sinks.rerun.piped_file import recorded_to

TIMELINE = "path_m"
_STEP_M = 0.05
# Below the lowest surface of an inflated object, which reaches a little below the floor; above the floor.
_GRID_BELOW_M, _PATH_ABOVE_M, _PATH_RADIUS_M = 0.08, 0.05, 0.02
_LABEL_ABOVE_M = 0.25
_FREE, _BLOCKED, _PATH, _ROBOT = (74, 80, 92), (40, 44, 53), (64, 160, 255), (238, 138, 48)
_ALPHA = 150
_MEANINGS = (
    ("free for the robot", _FREE),
    ("too near to an object or wall, or not observed", _BLOCKED),
    ("path", _PATH),
    ("robot", _ROBOT),
    ("with numbers: layer 4 of objects", color_of_id(2)),
)


def write_plan(
    path: FilePath,
    snapshot: MapSnapshot,
    space: FreeSpace,
    answer: Path | NoPath,
    *,
    start: NDArray[np.float64],
    goal: NDArray[np.float64],
) -> None:
    """Write an .rrd; the timeline `path_m` is the distance driven in metres. Raises `OSError` on a disk error."""
    import rerun as rr

    from hickory_stream.sinks.rerun.blueprint import one_map
    from hickory_stream.sinks.rerun.eye import WHOLE_ASPECT, eye_on
    from hickory_stream.sinks.rerun.labels import WIDE_LEGEND_PX, label_items, legend_item
    from hickory_stream.sinks.rerun.meshes import superquadric_mesh, tiles_mesh

    stream = new_stream(f"plan-{path.stem}")
    with recorded_to(path, stream):
        stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for tracked in obstacles_of(snapshot):
            # In one shade: the primitives of an object share many planes.
            mesh = superquadric_mesh(layer_four_of(tracked), color_of_id(tracked.id), alpha=_ALPHA, is_shaded=False)
            stream.log(f"world/layer4/{tracked.id}", mesh, static=True)
        boxes = {tracked.id: tracked.box.corners_world() for tracked in obstacles_of(snapshot)}
        is_blocked = np.asarray(space.blocked().all(axis=(0, 1)))
        for name, cells, color in (("free", ~is_blocked, _FREE), ("blocked", is_blocked, _BLOCKED)):
            stream.log(
                f"world/grid/{name}",
                tiles_mesh(_tiles(space, cells), space.floor_z_m - _GRID_BELOW_M, color),
                static=True,
            )
        ends = np.column_stack([[start, goal], np.full(2, space.floor_z_m + _PATH_ABOVE_M)])
        stream.log(
            "world/ends",
            rr.Points3D(
                ends, colors=[(46, 170, 96), (226, 80, 50)], radii=2 * _PATH_RADIUS_M, labels=["start", "goal"]
            ),
            static=True,
        )
        if not isinstance(answer, NoPath):
            points = np.column_stack([answer.points, np.full(len(answer.points), space.floor_z_m + _PATH_ABOVE_M)])
            stream.log("world/path", rr.LineStrips3D([points], colors=_PATH, radii=_PATH_RADIUS_M), static=True)
            _drive(stream, space, answer)
        corners = np.concatenate([ends, *boxes.values()])
        colors = {i: color_of_id(i) for i in boxes}
        labels = label_items("world/labels", boxes, {i: str(i) for i in boxes}, colors, eye_on(corners, WHOLE_ASPECT))
        for item in [*labels, legend_item(_MEANINGS, WIDE_LEGEND_PX)]:
            stream.log(item.path, *item.archetypes, static=True)
        stream.send_blueprint(one_map("Plan", corners, timeline=TIMELINE), make_active=True, make_default=True)


def _tiles(space: FreeSpace, cells: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return (N, 4) rectangles in the world that make up (rows, columns) of the grid."""
    found = np.array(rectangles(cells.T), dtype=np.float64).reshape(-1, 4)
    return found * space.frame.cell_m + np.tile(space.frame.origin_m, 2)


def _drive(stream: Any, space: FreeSpace, answer: Path) -> None:
    import rerun as rr

    driven = 0.0
    for i, (start, end) in enumerate(zip(answer.points[:-1], answer.points[1:], strict=True)):
        length = float(np.linalg.norm(end - start))
        posture = space.robot.postures[int(answer.postures[i])]
        for share in np.linspace(0, 1, max(int(length / _STEP_M), 1) + 1):
            stream.reset_time()
            stream.set_time(TIMELINE, duration=driven + share * length)
            place = start + share * (end - start)
            stream.log("world/robot", _body(posture, place, float(answer.headings_rad[i]), space.floor_z_m))
            # A label hangs below its point: this one stands above the robot, clear of those at the ends of the path.
            above = [*place, space.floor_z_m + posture.height_m + _LABEL_ABOVE_M]
            label = rr.Points3D([above], radii=-0.1, colors=_ROBOT, labels=posture.name, show_labels=True)
            stream.log("world/robot/posture", label)
        driven += length


def _body(posture: Posture, place: NDArray[np.float64], heading_rad: float, floor_z_m: float) -> Any:
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
        colors=_ROBOT,
        radii=-1.5,
        fill_mode=rr.components.FillMode.MajorWireframe,
    )
