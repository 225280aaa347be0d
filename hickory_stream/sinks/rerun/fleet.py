"""A fleet in Rerun: each robot has a colour, and joined robots share a frame.

Objects hang on the entity of their robot, which moves when the robot is joined. Unjoined frames stand side by side. The
timeline `keyframe` counts each robot's own keyframes, since clocks may differ; `log_time` has the stamps.
"""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.display import shaded
from hickory_stream.geometry.rigid import apply, from_rotation_translation, quaternion_from_rotation
from hickory_stream.records import TrackedObject
from hickory_stream.sinks.rerun.config import RerunConfig
from hickory_stream.sinks.rerun.file import RrdFile
from hickory_stream.sinks.rerun.items import KEYFRAME, LogItem, Moment, Span, Weight, clear_item
from hickory_stream.sinks.rerun.viewer import ViewerChoice, start_viewer

_CLOSE_TIMEOUT_S = 2.0
_COLORS = ((58, 140, 226), (238, 138, 48), (72, 186, 106), (222, 84, 120), (160, 120, 226), (214, 196, 64),
           (64, 192, 196), (196, 140, 104))  # fmt: skip
_SHADES = (1.0, 0.78, 1.35)
# Distance between frames is in steps, so that a growing map rarely moves the others.
_GAP_M, _STEP_M = 1.0, 2.0
# Surfaces that several robots mapped nearly coincide.
_ALPHA = 170
_PATH_RADIUS, _LABEL_ABOVE_M = -2.0, 0.4
TEXTS, OBJECTS, FRAMES = "fleet/joins", "plots/objects", "plots/frames"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ShownRobot:
    """A robot at one moment: its objects and the new part of its path, `world_from_camera` (N, 4, 4).

    `frame` names the robot that defines its frame; `frame_from_robot` (4, 4) is its place there.
    """

    name: str
    stamp_ns: int
    objects: tuple[TrackedObject, ...]
    world_from_camera: NDArray[np.float64]
    frame: str
    frame_from_robot: NDArray[np.float64]


class FleetRecording:
    """Writes the recording of a fleet while entered, and shows it in a viewer.

    Raises `ViewerError` if the file or the viewer is not available, `OutputError` on a disk error.
    """

    def __init__(self, path: Path, names: Sequence[str], config: RerunConfig, viewer: ViewerChoice) -> None:
        self._names = tuple(names)
        self._path = path
        recording_id = str(uuid.uuid4())
        self._viewer = start_viewer(viewer, bind=config.bind, server_memory_limit=config.server_memory_limit)
        self._file = RrdFile(path, recording_id=recording_id, cap_mb=config.rrd_cap_mb)
        self._feed: Any = None
        if self._viewer is not None:
            from hickory_stream.sinks.rerun.live import LiveFeed

            self._feed = LiveFeed(
                url=self._viewer.url,
                recording_id=recording_id,
                capacity=config.live_queue_length,
                blueprint=_blueprint(np.empty((0, 3)), np.empty((0, 3))),
            )
        self._paths: dict[str, list[NDArray[np.float64]]] = {name: [] for name in names}
        self._shown: dict[str, dict[int, TrackedObject]] = {name: {} for name in names}
        self._last: Moment | None = None
        self._corners = np.empty((0, 3))
        self._ever = np.empty((0, 3))

    @property
    def web_url(self) -> str | None:
        """Address of the page of a web viewer."""
        return None if self._viewer is None else self._viewer.web_url

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            self._file.send_blueprint(_blueprint(self._corners, self._ever))
            self._file.close()
        finally:
            if kind is not None and self._path.is_file():
                self._path.unlink(missing_ok=True)
            if self._feed is not None:
                self._feed.close(_CLOSE_TIMEOUT_S)
            if self._viewer is not None and self._viewer.process is not None and not self._viewer.outlives_us:
                self._viewer.process.kill()
                self._viewer.process.wait(_CLOSE_TIMEOUT_S)

    def show(self, keyframe: int, robots: Sequence[ShownRobot], texts: Sequence[str]) -> None:
        """Log the robots after `keyframe` keyframes, and events such as joins."""
        import rerun as rr

        if self._last is None and robots:
            self._log(Moment(stamp_ns=robots[0].stamp_ns, frame=keyframe, keyframe=keyframe), self._first_items())
        places = _places(robots)
        self._corners = np.concatenate(
            [np.empty((0, 3)), *(apply(places[robot.name], _corners_of(robot.objects)) for robot in robots)]
        )
        ends = [self._corners.min(axis=0), self._corners.max(axis=0)] if len(self._corners) else []
        self._ever = np.concatenate([self._ever, *(end[None] for end in ends)])
        for robot in robots:
            is_alone = sum(other.frame == robot.frame for other in robots) == 1
            items = self._robot_items(robot, places[robot.name], is_alone=is_alone)
            self._log(Moment(stamp_ns=robot.stamp_ns, frame=keyframe, keyframe=keyframe), items)
        if self._last is not None:
            said = [LogItem(path=TEXTS, archetypes=(rr.TextLog(text, level=rr.TextLogLevel.INFO),)) for text in texts]
            frames = rr.Scalars([float(len({robot.frame for robot in robots}))])
            self._log(self._last, [*said, LogItem(path=FRAMES, archetypes=(frames,))])

    def _log(self, moment: Moment, items: list[LogItem]) -> None:
        self._last = moment
        self._file.write(moment, items)
        if self._feed is not None:
            self._feed.put(moment, items)

    def _first_items(self) -> list[LogItem]:
        import rerun as rr

        lines = [
            LogItem(
                path=f"{OBJECTS}/{name}",
                archetypes=(rr.SeriesLines(colors=color_of_robot(place), names=name),),
                span=Span.STATIC,
            )
            for place, name in enumerate(self._names)
        ]
        # How many frames there are stays until robots are joined: no slope from one round to the next.
        steps = rr.SeriesLines(names="frames", interpolation_mode=rr.components.InterpolationMode.StepAfter)
        lines.append(LogItem(path=FRAMES, archetypes=(steps,), span=Span.STATIC))
        return [LogItem(path="world", archetypes=(rr.ViewCoordinates.RIGHT_HAND_Z_UP,), span=Span.STATIC), *lines]

    def _robot_items(
        self, robot: ShownRobot, scene_from_robot: NDArray[np.float64], *, is_alone: bool
    ) -> list[LogItem]:
        import rerun as rr

        color = color_of_robot(self._names.index(robot.name))
        root = f"world/{robot.name}"
        rotation = rr.Quaternion(xyzw=quaternion_from_rotation(scene_from_robot[:3, :3]))
        place = rr.Transform3D(translation=scene_from_robot[:3, 3], quaternion=rotation)
        items = [LogItem(path=root, archetypes=(place,), span=Span.LASTING)]
        items += self._object_items(robot, root, color)
        path = self._paths[robot.name]
        path.extend(robot.world_from_camera[:, :3, 3])
        if path:
            line = rr.LineStrips3D([np.array(path)], colors=color, radii=_PATH_RADIUS)
            text = f"{robot.name}, alone" if is_alone else robot.name
            above = path[-1] + np.array([0.0, 0.0, _LABEL_ABOVE_M])
            label = rr.Points3D([above], colors=color, radii=-6.0, labels=[text], show_labels=True)
            items.append(LogItem(path=f"{root}/path", archetypes=(line,), span=Span.LASTING))
            items.append(LogItem(path=f"{root}/robot", archetypes=(label,), span=Span.LASTING))
        count = rr.Scalars([float(len(robot.objects))])
        return [*items, LogItem(path=f"{OBJECTS}/{robot.name}", archetypes=(count,))]

    def _object_items(self, robot: ShownRobot, root: str, color: tuple[int, int, int]) -> list[LogItem]:
        shown, items = self._shown[robot.name], []
        for gone in sorted(shown.keys() - {item.id for item in robot.objects}):
            del shown[gone]
            items.append(clear_item(f"{root}/objects/{gone}"))
        for item in robot.objects:
            before = shown.get(item.id)
            if before is not None and _looks_the_same(before, item):
                continue
            if before is not None and before.superquadrics is None:
                items.append(clear_item(f"{root}/objects/{item.id}"))  # of its box, which the shape does not replace
            drawn = _drawn(item, shaded(color, _SHADES[item.id % 3]))
            items.append(
                LogItem(path=f"{root}/objects/{item.id}", archetypes=(drawn,), weight=Weight.HEAVY, span=Span.LASTING)
            )
            shown[item.id] = item
        return items


def color_of_robot(place: int) -> tuple[int, int, int]:
    """Return the colour of a robot by its index in the fleet."""
    return shaded(_COLORS[place % len(_COLORS)], (1.0, 0.7, 1.5)[place // len(_COLORS) % 3])


def _drawn(item: TrackedObject, color: tuple[int, int, int]) -> Any:
    from hickory_stream.sinks.rerun.meshes import superquadric_mesh, wire_box

    if item.superquadrics is not None:
        return superquadric_mesh(item.superquadrics, color, alpha=_ALPHA, is_shaded=False)
    return wire_box(item.box.world_from_box, item.box.half_extents_m, color)


def _looks_the_same(a: TrackedObject, b: TrackedObject) -> bool:
    one, other = a.superquadrics, b.superquadrics
    if one is None or other is None:
        return one is other and np.array_equal(a.box.world_from_box, b.box.world_from_box)
    return len(one) == len(other) and np.array_equal(one.world_from_local, other.world_from_local)


def _places(robots: Sequence[ShownRobot]) -> dict[str, NDArray[np.float64]]:
    # scene_from_robot (4, 4) by robot: frames stand side by side along x.
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
    # (N, 3) corners of the final map, and of all that was shown at any time.
    import rerun.blueprint as rrb

    from hickory_stream.sinks.rerun.blueprint import arranged, scene_view
    from hickory_stream.sinks.rerun.eye import MAIN_ASPECT, SIDE_ASPECT

    main = scene_view("Robots, a colour each, where they are in the end", ["world/**"], corners, MAIN_ASPECT)
    wide = scene_view("All frames beside one another", ["world/**"], ever, SIDE_ASPECT)
    columns = rrb.TextLogColumns(timeline_columns=[KEYFRAME], text_log_columns=["body"])
    below = rrb.Horizontal(
        rrb.TextLogView(origin=TEXTS, name="Joins", columns=columns),
        rrb.TimeSeriesView(origin=OBJECTS, name="Objects"),
        rrb.TimeSeriesView(origin=FRAMES, name="Frames: 1 when all are joined"),
        column_shares=[2, 1, 1],
    )
    above = rrb.Horizontal(main, wide, column_shares=[3, 2])
    return arranged(rrb.Vertical(above, below, row_shares=[4, 1]), timeline=KEYFRAME)
