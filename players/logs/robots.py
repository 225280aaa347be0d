"""The camera's own robot among several: poses and transforms of others may have equal names of frames.

A namespace with transforms of its own is a robot. The camera's holds its topic, unless another robot's poses are named.
"""

from collections.abc import Iterable

from hickory_stream.errors import CalibrationError
from players.logs.containers import Topic
from players.messages.records import POSE_TYPES, TF
from players.options import NO_TOPIC, SourceOptions


def other_robots(path: object, topics: Iterable[Topic], color: str, options: SourceOptions) -> frozenset[str]:
    """Return the topics of poses and transforms that do not belong to the camera of the topic `color`.

    Raises `CalibrationError`: the poses are those of several robots, and no namespace tells which one has the camera.
    """
    posed = [topic for topic in topics if topic.type_name in (*TF, *POSE_TYPES) and topic.num_messages != 0]
    links = [topic.name for topic in posed if topic.type_name in TF]
    places = [topic.name for topic in posed if topic.type_name in POSE_TYPES]
    moving = sorted({name.rpartition("/")[0] for name in links if not name.endswith("_static")})
    # Static links alone, without poses beside them, are those of a camera rather than of a robot.
    still = {name.rpartition("/")[0] for name in links}
    robots = {*moving, *(space for space in still if any(place.startswith(f"{space}/") for place in places))}
    named = options.pose_topic if options.pose_topic not in (None, NO_TOPIC) else color
    own = _robot_of(named, robots) or _robot_of(color, robots)
    if not own and "" not in moving and len(moving) < 2:
        return frozenset()
    robot_of = {topic: _robot_of(topic.name, robots) for topic in posed if topic.name != named}
    is_own = {robot: f"{own}/".startswith(f"{robot}/") or (own and robot.startswith(f"{own}/")) for robot in robots}
    others = {topic for topic, robot in robot_of.items() if robot and not is_own[robot]}
    is_asked = options.pose_file is None and options.pose_topic != NO_TOPIC and not options.estimates_poses
    if not own and "" not in moving and is_asked and all(t in others or t.name.endswith("_static") for t in posed):
        raise CalibrationError(
            f"{path}: {' and '.join(f'{robot}/tf' for robot in moving)} may be those of different robots, and {color} "
            f"lies in none of their namespaces; name the topic of the camera's with --pose-topic {moving[0]}/tf"
        )
    return frozenset(topic.name for topic in others)


def nearness(name: str, color: str) -> int:
    """Return how many parts of its namespace a topic shares with the camera's, less those that it does not."""
    shared = shared_parts(name, color)
    return 2 * shared - (name.count("/") - 1)


def shared_parts(a: str, b: str) -> int:
    """Return how many leading parts of the namespaces of two topics are equal."""
    parts = list(zip(a.strip("/").split("/")[:-1], b.strip("/").split("/")[:-1], strict=False))
    return next((i for i, (x, y) in enumerate(parts) if x != y), len(parts))


def _robot_of(name: str, robots: Iterable[str]) -> str:
    return max((robot for robot in robots if robot and name.startswith(f"{robot}/")), key=len, default="")
