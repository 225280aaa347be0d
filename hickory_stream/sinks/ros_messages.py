"""ROS 2 messages as bytes (CDR) from the map's records, without ROS.

`vision_msgs` and `map_msgs` are not in ROS's core: their definitions here are the ones of Humble and later.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.navigation.costmap import CostmapUpdate
from hickory_stream.navigation.occupancy import GridFrame
from hickory_stream.navigation.search import Path
from hickory_stream.navigation.stand_ins import Obstacle, early_obstacles
from hickory_stream.records import MapSnapshot, TrackedObject
from players.messages.ros_messages import RosMessages

FRAME_ID = "map"
GRID, UPDATE = "nav_msgs/msg/OccupancyGrid", "map_msgs/msg/OccupancyGridUpdate"
DETECTIONS, MARKERS = "vision_msgs/msg/Detection3DArray", "visualization_msgs/msg/MarkerArray"
TRANSFORMS, PATH, GOAL = "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Path", "geometry_msgs/msg/PoseStamped"

_HEADER = "std_msgs/Header header\n"
_DEFINITIONS = {
    UPDATE: _HEADER + "int32 x\nint32 y\nuint32 width\nuint32 height\nint8[] data\n",
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score\n",
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n"
    ),
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
    "vision_msgs/msg/Detection3D": _HEADER
    + "vision_msgs/ObjectHypothesisWithPose[] results\nvision_msgs/BoundingBox3D bbox\nstring id\n",
    DETECTIONS: _HEADER + "vision_msgs/Detection3D[] detections\n",
}
_CUBE, _TEXT, _ADD, _DELETE_ALL = 1, 9, 0, 3
_SURE_RGBA, _OBSERVED_RGBA = (0.2, 0.6, 0.9, 0.5), (0.95, 0.6, 0.1, 0.5)
_FIXTURE_RGBA = (0.45, 0.5, 0.6, 0.5)
OBSERVED_ONLY, SURE, FIXTURES = "observed_only", "objects", "fixtures"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Goal:
    """A goal of a robot: `place` (2,), metres, in a frame."""

    frame: str
    place: NDArray[np.float64]


@cache
def _messages() -> RosMessages:
    from rosbags.typesys import get_types_from_msg

    messages, types = RosMessages(), dict[str, Any]()
    for name, text in _DEFINITIONS.items():
        types.update(get_types_from_msg(text, name))
    messages.store.register(types)
    return messages


def store() -> Any:
    """Return the types of ROS 2 Humble with `vision_msgs` and `map_msgs`."""
    return _messages().store


def definition_of(type_name: str) -> str:
    """Return the definition of a type and its parts as `ros2msg`."""
    text, _ = store().generate_msgdef(type_name, ros_version=2)
    return str(text)


def hash_of(type_name: str) -> str:
    """Return the RIHS01 hash of a type, which names it in rmw_zenoh."""
    return str(store().hash_rihs01(type_name))


def encoded(type_name: str, message: Any) -> bytes:
    """Return a message of a type as CDR."""
    return bytes(store().serialize_cdr(message, type_name))


def warm_up() -> None:
    """Make all encoders in advance: each takes up to a second, once."""
    nothing = MapSnapshot(revision=0, stamp_ns=0, submaps=(), objects=())
    frame = GridFrame(origin_m=np.zeros(2), cell_m=1.0, rows=1, columns=1)
    for is_whole in (True, False):
        states = np.zeros((1, 1), np.int8)
        grid_message(CostmapUpdate(stamp_ns=0, frame=frame, row=0, column=0, states=states, is_whole=is_whole))
    detections_message(nothing)
    markers_message(nothing)
    transform_message(0, "odom", np.eye(4))
    path_message(0, None)
    goal_of(goal_message(0, np.zeros(2)))


def grid_message(update: CostmapUpdate) -> tuple[str, bytes]:
    """Return type and bytes of an update: a whole grid, or a window of it."""
    data = np.ascontiguousarray(update.states).ravel()
    height, width = update.states.shape
    header = _header(update.stamp_ns)
    if not update.is_whole:
        window = _new(UPDATE, header=header, x=update.column, y=update.row, width=width, height=height, data=data)
        return UPDATE, encoded(UPDATE, window)
    x, y = update.frame.origin_m.tolist()
    info = _new(
        "nav_msgs/msg/MapMetaData",
        map_load_time=header.stamp,
        resolution=update.frame.cell_m,
        width=width,
        height=height,
        origin=_pose(np.array([x, y, 0.0])),
    )
    return GRID, encoded(GRID, _new(GRID, header=header, info=info, data=data))


def detections_message(snapshot: MapSnapshot) -> bytes:
    """Return the objects with id, upright box and pose.

    The classes are its kinds, the likelier one first; before layer 4 exists, `OBSERVED_ONLY` precedes them.
    """
    header = _header(snapshot.stamp_ns)
    found = []
    for tracked, obstacle, pose in _with_poses(snapshot):
        fixed = tracked.fixture_probability
        classes = sorted(((1 - fixed, "object"), (fixed, "fixture")), reverse=True)
        classes = [(1.0, OBSERVED_ONLY)] * obstacle.is_observed_only + classes
        with_covariance = _new("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36))
        results = [
            _new(
                "vision_msgs/msg/ObjectHypothesisWithPose",
                hypothesis=_new("vision_msgs/msg/ObjectHypothesis", class_id=name, score=score),
                pose=with_covariance,
            )
            for score, name in classes
        ]
        box = _new("vision_msgs/msg/BoundingBox3D", center=pose, size=_vector(2 * tracked.box.half_extents_m))
        found.append(_new("vision_msgs/msg/Detection3D", header=header, results=results, bbox=box, id=str(tracked.id)))
    return encoded(DETECTIONS, _new(DETECTIONS, header=header, detections=found))


def markers_message(snapshot: MapSnapshot) -> bytes:
    """Return the boxes and ids of all objects for RViz, after an order to delete earlier ones."""
    header = _header(snapshot.stamp_ns)
    markers = [_marker(header, SURE, 0, _CUBE, _DELETE_ALL)]
    for tracked, obstacle, pose in _with_poses(snapshot):
        space, rgba = (FIXTURES, _FIXTURE_RGBA) if tracked.is_fixture else (SURE, _SURE_RGBA)
        space, rgba = (OBSERVED_ONLY, _OBSERVED_RGBA) if obstacle.is_observed_only else (space, rgba)
        size = 2 * tracked.box.half_extents_m
        cube = _marker(header, space, tracked.id, _CUBE, pose=pose, scale=size, rgba=rgba)
        above = tracked.box.center + np.array([0.0, 0.0, tracked.box.half_extents_m[2] + 0.1])
        label = _marker(header, f"{space}/ids", tracked.id, _TEXT, pose=_pose(above), scale=np.full(3, 0.12))
        label.text = str(tracked.id)
        markers += [cube, label]
    return encoded(MARKERS, _new(MARKERS, markers=markers))


def transform_message(stamp_ns: int, odom_frame: str, map_from_odom: NDArray[np.float64]) -> bytes:
    """Return the pose of the odometry frame in the map."""
    translation, rotation = _vector(map_from_odom[:3, 3]), _quaternions(map_from_odom[None, :3, :3])[0]
    placed = _new("geometry_msgs/msg/Transform", translation=translation, rotation=rotation)
    stamped = _new(
        "geometry_msgs/msg/TransformStamped", header=_header(stamp_ns), child_frame_id=odom_frame, transform=placed
    )
    return encoded(TRANSFORMS, _new(TRANSFORMS, transforms=[stamped]))


def path_message(stamp_ns: int, path: Path | None) -> bytes:
    """Return a path, each pose facing along its leg; without poses if there is none, as in Nav2."""
    header = _header(stamp_ns)
    poses = []
    if path is not None:
        ahead = np.diff(path.points, axis=0, append=path.points[-1:] + np.diff(path.points, axis=0)[-1:])
        for (x, y), (dx, dy) in zip(path.points.tolist(), ahead.tolist(), strict=True):
            turned = _yaw(math.atan2(dy, dx))
            poses.append(_new(GOAL, header=header, pose=_pose(np.array([x, y, 0.0]), turned)))
    return encoded(PATH, _new(PATH, header=header, poses=poses))


def goal_of(data: bytes) -> Goal | None:
    """Return the goal of a PoseStamped; None for invalid bytes or a position that is not finite."""
    try:
        message = store().deserialize_cdr(data, GOAL)
    except Exception:  # noqa: BLE001 - a stranger's bytes break the decoder in whatever way
        return None
    place = np.array([message.pose.position.x, message.pose.position.y])
    if not np.isfinite(place).all():
        return None
    return Goal(frame=str(message.header.frame_id).lstrip("/"), place=place)


def goal_message(stamp_ns: int, place: NDArray[np.float64], frame: str = FRAME_ID) -> bytes:
    """Return a PoseStamped for `goal_of`."""
    return encoded(GOAL, _new(GOAL, header=_header(stamp_ns, frame), pose=_pose(np.array([*place, 0.0]))))


def _marker(
    header: Any,
    namespace: str,
    number: int,
    kind: int,
    action: int = _ADD,
    *,
    pose: Any = None,
    scale: NDArray[np.float64] | None = None,
    rgba: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0),
) -> Any:
    def color(r: float, g: float, b: float, a: float) -> Any:
        return _new("std_msgs/msg/ColorRGBA", r=r, g=g, b=b, a=a)

    nothing = _new("sensor_msgs/msg/CompressedImage", header=header, format="", data=np.zeros(0, np.uint8))
    none = _new("visualization_msgs/msg/MeshFile", filename="", data=np.zeros(0, np.uint8))
    return _new(
        "visualization_msgs/msg/Marker",
        header=header,
        ns=namespace,
        id=number,
        type=kind,
        action=action,
        pose=pose if pose is not None else _pose(np.zeros(3)),
        scale=_vector(scale if scale is not None else np.ones(3)),
        color=color(*rgba),
        lifetime=_new("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource="",
        texture=nothing,
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=none,
        mesh_use_embedded_materials=False,
    )


def _new(type_name: str, **fields: Any) -> Any:
    return _messages().make(type_name, **fields)


def _header(stamp_ns: int, frame: str = FRAME_ID) -> Any:
    return _messages().header(stamp_ns, frame)


def _vector(values: NDArray[np.float64]) -> Any:
    return _messages().vector("geometry_msgs/msg/Vector3", values)


def _pose(position: NDArray[np.float64], rotation: Any = None) -> Any:
    return _new(
        "geometry_msgs/msg/Pose",
        position=_messages().vector("geometry_msgs/msg/Point", position),
        orientation=rotation if rotation is not None else _yaw(0.0),
    )


def _with_poses(snapshot: MapSnapshot) -> Iterator[tuple[TrackedObject, Obstacle, Any]]:
    objects = snapshot.objects
    turned = _quaternions(np.array([tracked.box.world_from_box[:3, :3] for tracked in objects]).reshape(-1, 3, 3))
    for tracked, obstacle, rotation in zip(objects, early_obstacles(objects), turned, strict=True):
        yield tracked, obstacle, _pose(tracked.box.center, rotation)


def _yaw(angle_rad: float) -> Any:
    return _new("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(angle_rad / 2), w=math.cos(angle_rad / 2))


def _quaternions(rotations: NDArray[np.float64]) -> list[Any]:
    # One call for all (N, 3, 3) rotations, since each takes SciPy 0.2 ms.
    from scipy.spatial.transform import Rotation

    of_all = Rotation.from_matrix(rotations).as_quat().tolist() if len(rotations) else []
    return [_new("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w) for x, y, z, w in of_all]
