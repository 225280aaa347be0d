"""A fleet in Rerun: every robot in a colour of its own, and one frame for those that were joined.

A robot's objects hang on its entity, in its own frame; when it is joined, that entity moves. Robots that are in no
other's frame stand beside those that are. The timeline `keyframe` counts every robot's own keyframes, since clocks need
not agree; `log_time` has the stamps.
"""

from __future__ import annotations

from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.errors import OutputError
from hickory_stream.geometry.palette import shaded
from hickory_stream.geometry.rigid import apply, from_rotation_translation, quaternion_from_rotation
from hickory_stream.sinks.piped_file import recorded_to
from hickory_stream.sinks.rerun_items import KEYFRAME, LOG_TIME, new_stream

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from hickory_stream.records import TrackedObject

_COLORS = ((58, 140, 226), (238, 138, 48), (72, 186, 106), (222, 84, 120), (160, 120, 226), (214, 196, 64),
           (64, 192, 196), (196, 140, 104))  # fmt: skip
_SHADES = (1.0, 0.78, 1.35)
# Frames that stand beside one another do so in steps: a map that grows does not move the others each time.
_GAP_M, _STEP_M = 1.0, 2.0
# What several robots have mapped are surfaces in nearly one place, which otherwise fight for the pixels.
_ALPHA = 170
_PATH_RADIUS, _LABEL_ABOVE_M = -2.0, 0.4
TEXTS, OBJECTS, FRAMES = "fleet/joins", "plots/objects", "plots/frames"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ShownRobot:
    """A robot at one moment: what is new of its path (N, 4, 4), its objects, and where its frame lies.

    `frame` is the name of the robot in whose frame it is, `frame_from_robot` (4, 4) its place there.
    """

    name: str
    stamp_ns: int
    objects: tuple[TrackedObject, ...]
    world_from_camera: NDArray[np.float64]
    frame: str
    frame_from_robot: NDArray[np.float64]


class FleetRecording:
    """Writes the recording of a fleet; entered with `with`, it is there when that is left.

    Raises:
        OutputError: the disk refused.
    """

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        self._names = tuple(names)
        self._stream = new_stream(f"fleet-{path.parent.name}")
        self._stack = ExitStack()
        self._path = path
        self._paths: dict[str, list[NDArray[np.float64]]] = {name: [] for name in names}
        self._shown: dict[str, dict[int, TrackedObject]] = {name: {} for name in names}
        self._corners = np.empty((0, 3))
        self._ever = np.empty((0, 3))

    def __enter__(self) -> FleetRecording:
        import rerun as rr

        self._stack.enter_context(_refusals(self._path))
        self._stack.enter_context(recorded_to(self._path, self._stream))
        self._stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for place, name in enumerate(self._names):
            line = rr.SeriesLines(colors=color_of_robot(place), names=name)
            self._stream.log(f"{OBJECTS}/{name}", line, static=True)
        return self

    def __exit__(self, *error: Any) -> None:
        self._stream.send_blueprint(_blueprint(self._corners, self._ever), make_active=True, make_default=True)
        self._stack.__exit__(*error)

    def show(self, keyframe: int, robots: Sequence[ShownRobot], texts: Sequence[str]) -> None:
        """Log the robots after so many keyframes, and what happened: robots that were joined."""
        import rerun as rr

        places = _places(robots)
        self._corners = np.concatenate(
            [np.empty((0, 3)), *(apply(places[robot.name], _corners_of(robot.objects)) for robot in robots)]
        )
        ends = [self._corners.min(axis=0), self._corners.max(axis=0)] if len(self._corners) else []
        self._ever = np.concatenate([self._ever, *(end[None] for end in ends)])
        for robot in robots:
            self._stream.reset_time()
            self._stream.set_time(KEYFRAME, sequence=keyframe)
            self._stream.set_time(LOG_TIME, timestamp=np.datetime64(robot.stamp_ns, "ns"))
            is_alone = sum(other.frame == robot.frame for other in robots) == 1
            self._log_robot(robot, places[robot.name], is_alone=is_alone)
        self._stream.reset_time()
        self._stream.set_time(KEYFRAME, sequence=keyframe)
        for text in texts:
            self._stream.log(TEXTS, rr.TextLog(text, level=rr.TextLogLevel.INFO))
        self._stream.log(FRAMES, rr.Scalars([float(len({robot.frame for robot in robots}))]))

    def _log_robot(self, robot: ShownRobot, scene_from_robot: NDArray[np.float64], *, is_alone: bool) -> None:
        import rerun as rr

        color = color_of_robot(self._names.index(robot.name))
        root = f"world/{robot.name}"
        rotation = rr.Quaternion(xyzw=quaternion_from_rotation(scene_from_robot[:3, :3]))
        self._stream.log(root, rr.Transform3D(translation=scene_from_robot[:3, 3], quaternion=rotation))
        self._log_objects(robot, root, color)
        path = self._paths[robot.name]
        path.extend(robot.world_from_camera[:, :3, 3])
        if path:
            line = rr.LineStrips3D([np.array(path)], colors=color, radii=_PATH_RADIUS)
            self._stream.log(f"{root}/path", line)
            told = f"{robot.name}, alone" if is_alone else robot.name
            above = path[-1] + np.array([0.0, 0.0, _LABEL_ABOVE_M])
            self._stream.log(
                f"{root}/robot", rr.Points3D([above], colors=color, radii=-6.0, labels=[told], show_labels=True)
            )
        self._stream.log(f"{OBJECTS}/{robot.name}", rr.Scalars([float(len(robot.objects))]))

    def _log_objects(self, robot: ShownRobot, root: str, color: tuple[int, int, int]) -> None:
        import rerun as rr

        shown = self._shown[robot.name]
        for gone in sorted(shown.keys() - {item.id for item in robot.objects}):
            del shown[gone]
            self._stream.log(f"{root}/objects/{gone}", rr.Clear(recursive=True))
        for item in robot.objects:
            before = shown.get(item.id)
            if before is None or not _looks_the_same(before, item):
                if before is not None and before.superquadrics is None:
                    self._stream.log(f"{root}/objects/{item.id}", rr.Clear(recursive=False))
                self._stream.log(f"{root}/objects/{item.id}", _drawn(item, shaded(color, _SHADES[item.id % 3])))
                shown[item.id] = item


@contextmanager
def _refusals(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise OutputError(f"cannot write the recording {path}: {error.strerror or error}") from error


def color_of_robot(place: int) -> tuple[int, int, int]:
    """Return the colour of a robot by its place in the fleet."""
    return shaded(_COLORS[place % len(_COLORS)], (1.0, 0.7, 1.5)[place // len(_COLORS) % 3])


def _drawn(item: TrackedObject, color: tuple[int, int, int]) -> Any:
    """Return layer 3 of an object, or its sketch, or its box: what is known of it."""
    import rerun as rr

    from hickory_stream.sinks.rerun_meshes import superquadric_mesh

    if item.superquadrics is not None:
        return superquadric_mesh(item.superquadrics, color, alpha=_ALPHA, is_shaded=False)
    return rr.Boxes3D(
        centers=[item.box.center],
        half_sizes=[item.box.half_extents_m],
        quaternions=[rr.Quaternion(xyzw=quaternion_from_rotation(item.box.world_from_box[:3, :3]))],
        colors=color,
        fill_mode=rr.components.FillMode.MajorWireframe,
    )


def _looks_the_same(a: TrackedObject, b: TrackedObject) -> bool:
    one, other = a.superquadrics, b.superquadrics
    if one is None or other is None:
        return one is other and np.array_equal(a.box.world_from_box, b.box.world_from_box)
    return len(one) == len(other) and np.array_equal(one.world_from_local, other.world_from_local)


def _places(robots: Sequence[ShownRobot]) -> dict[str, NDArray[np.float64]]:
    """Return where every robot's frame is drawn, scene_from_robot (4, 4): frames stand beside one another along x."""
    places: dict[str, NDArray[np.float64]] = {}
    next_m, middle = 0.0, np.zeros(3)
    for i, frame in enumerate(dict.fromkeys(robot.frame for robot in robots)):
        members = [robot for robot in robots if robot.frame == frame]
        corners = np.concatenate([apply(one.frame_from_robot, _corners_of(one.objects)) for one in members])
        low, high = (corners.min(axis=0), corners.max(axis=0)) if len(corners) else (np.zeros(3), np.zeros(3))
        shift = np.zeros(3)
        if i == 0:
            middle = (low + high) / 2
        else:
            shift = np.round((middle - (low + high) / 2) / _STEP_M) * _STEP_M
            shift[0] = np.ceil((next_m - low[0]) / _STEP_M) * _STEP_M
        next_m = high[0] + shift[0] + _GAP_M
        for one in members:
            places[one.name] = from_rotation_translation(np.eye(3), shift) @ one.frame_from_robot
    return places


def _corners_of(objects: Sequence[TrackedObject]) -> NDArray[np.float64]:
    return np.concatenate([np.empty((0, 3)), *(item.box.corners_world() for item in objects)])


def _blueprint(corners: NDArray[np.float64], ever: NDArray[np.float64]) -> Any:
    """Return the arrangement: (N, 3) corners of the map in the end, and of all there was at any time."""
    import rerun.blueprint as rrb

    from hickory_stream.sinks.rerun_blueprint import BACKGROUND
    from hickory_stream.sinks.rerun_eye import MAIN_ASPECT, SIDE_ASPECT, eye_on

    main, wide = (
        rrb.Spatial3DView(
            origin="world",
            name=name,
            background=BACKGROUND,
            line_grid=rrb.LineGrid3D(visible=False),
            eye_controls=eye_on(points, aspect).controls() if len(points) else None,
        )
        for name, points, aspect in (
            ("Robots, a colour each, where they are in the end", corners, MAIN_ASPECT),
            ("All frames beside one another", ever, SIDE_ASPECT),
        )
    )
    columns = rrb.TextLogColumns(timeline_columns=[KEYFRAME], text_log_columns=["body"])
    below = rrb.Horizontal(
        rrb.TextLogView(origin=TEXTS, name="Joins", columns=columns),
        rrb.TimeSeriesView(origin=OBJECTS, name="Objects"),
        rrb.TimeSeriesView(origin=FRAMES, name="Frames: 1 when all are joined"),
        column_shares=[2, 1, 1],
    )
    return rrb.Blueprint(
        rrb.Vertical(rrb.Horizontal(main, wide, column_shares=[3, 2]), below, row_shares=[4, 1]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=KEYFRAME),
        auto_views=False,
    )
