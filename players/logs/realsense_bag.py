"""Bags of the RealSense viewer and of librealsense's recorder: ROS 1 bags with topics and messages of their own.

They have no poses and no TF: the extrinsics of each stream, and the unit of depth, are single messages. In newer
ones, images end in a depth unit that their definition in the bag does not have.
"""

import re
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from hickory_stream.geometry.rigid import invert
from players.logs.containers import Topic, UnreadableMessageError, deserialize
from players.logs.ros1_log import Ros1Log
from players.messages.records import IMAGE
from players.poses.interpolation import is_pose_row, pose_of_row
from players.poses.tf import Edge
from players.profile import RigLinks, load_profile

_IMAGES = re.compile(r"((/device_\d+/sensor_\d+)/(Depth|Color)_\d+)/image/data")
_UNITS = re.compile(r"/option/Depth[ _]Units/value|/property")
_UNIT_NAME = "Depth Units"
# In a serialised image, the length of the frame's name and the name, in whose place is a version.
_VERSIONED = slice(12, 17), b"\x01\0\0\x001"


def as_viewer_bag(log: Ros1Log) -> Ros1Log:
    """Return the log with the profile and the definitions of a viewer's bag, if it is one; else as it is."""
    streams = {hit[3]: hit for topic in log.topics if (hit := _IMAGES.fullmatch(topic.name))}
    if not streams:
        return log
    log.kind = "RealSense viewer bag (ROS 1)"
    log.topics = tuple(_with_unit(log, topic) for topic in log.topics)
    depth_sensor = streams["Depth"][2] if "Depth" in streams else "none"
    links = {role: [t.name for t in log.topics if t.name.startswith(f"{hit[1]}/tf/")] for role, hit in streams.items()}
    units = [t.name for t in log.topics if _UNITS.fullmatch(t.name.removeprefix(depth_sensor))]
    found = _first_messages(log, [*units, *(name for names in links.values() for name in names[:1])])
    units_m = [unit for name in units if name in found and 1e-6 <= (unit := _number(found[name])) <= 1.0]
    prefixes = {role.lower(): hit[1] for role, hit in streams.items()}
    log.profile = replace(
        load_profile("realsense"),
        name="realsense_viewer",
        title="RealSense viewer",
        depth_units_per_m=1.0 / units_m[0] if units_m else 1000.0,
        topics={
            **{role: (f"{prefix}/image/data",) for role, prefix in prefixes.items()},
            **{f"{role}_info": (f"{prefix}/info/camera_info",) for role, prefix in prefixes.items()},
        },
        rig=_rig({role: (names[0], found[names[0]]) for role, names in links.items() if names and names[0] in found}),
    )
    return log


def _with_unit(log: Ros1Log, topic: Topic) -> Topic:
    if topic.type_name != IMAGE or not _IMAGES.fullmatch(topic.name):
        return topic
    first = next(iter(log.messages([topic.name])), None)
    if first is None or bytes(first.data[_VERSIONED[0]]) != _VERSIONED[1]:
        return topic
    fields, line, others = topic.definition.partition("\n====")
    return replace(topic, definition=f"{fields}\nfloat32 depth_units{line}{others}")


def _first_messages(log: Ros1Log, names: list[str]) -> dict[str, Any]:
    topics = {topic.name: topic for topic in log.topics}
    found: dict[str, Any] = {}
    for message in log.messages(names):
        with suppress(UnreadableMessageError):
            content = deserialize(topics[message.topic], message.data)
            # A property is one of many of its topic.
            if getattr(content, "key", _UNIT_NAME) == _UNIT_NAME:
                found.setdefault(message.topic, content)
        if len(found) == len(names):
            break
    return found


def _number(message: Any) -> float:
    try:
        return float(getattr(message, "data", getattr(message, "value", 0)))
    except ValueError:
        return 0.0


def _rig(transforms: dict[str, tuple[str, Any]]) -> RigLinks | None:
    # Each message is stream_from_reference; the end of its topic names the reference.
    links = []
    for role, (_, message) in transforms.items():
        t, q = message.translation, message.rotation
        row = [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
        if is_pose_row(row):
            links.append(Edge(parent="reference", child=role, parent_from_child=invert(pose_of_row(np.array(row)))))
    if len(links) < 2 or len({name.rpartition("/")[2] for name, _ in transforms.values()}) != 1:
        return None
    return RigLinks(body="Color", color="Color", depth="Depth", links=tuple(links))
