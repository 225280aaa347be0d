"""Where the camera is: from the pose topics and the frames of a log to poses of the colour camera's optical frame.

By default the pose is that of an odometry topic whose body carries the camera by static links; else it is a chain of TF
from a fixed frame. A link that nobody published is an error that names both ends: frames are never guessed.
"""

from __future__ import annotations

from array import array
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.errors import CalibrationError, RecordingError
from players.containers import UnreadableMessageError, deserialize
from players.messages import CAMERA_INFO, TF, CameraInfo, StampedPose, camera_info_of, poses_of
from players.poses import PoseTrack, is_pose_row, pose_of_row, track_of
from players.tf import Chain, Edge, FrameTree

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from players.containers import Log, Topic

_FIXED_FRAMES = ("odom", "world", "map", "earth")
"""Fixed frames for poses from TF alone: odom first, since it does not jump when a loop is closed."""


@dataclass(slots=True)
class _Samples:
    """The poses of one link as they come: eight numbers each, not an object."""

    stamps_ns: array[int] = field(default_factory=lambda: array("q"))
    numbers: array[float] = field(default_factory=lambda: array("d"))

    def add(self, pose: StampedPose) -> None:
        self.stamps_ns.append(pose.stamp_ns)
        self.numbers.extend(pose.row)

    def rows(self) -> NDArray[np.float64]:
        return np.asarray(self.numbers, dtype=np.float64).reshape(-1, 7)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PoseStream:
    """A pose topic: where `child` is in `parent` over time; an empty `child` is a frame that the topic leaves open."""

    topic: str
    type_name: str
    parent: str
    child: str
    track: PoseTrack


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rig:
    """What the small messages of a log say: poses, the tree of frames, calibrations by topic, and bad messages."""

    streams: tuple[PoseStream, ...]
    tree: FrameTree
    infos: dict[str, CameraInfo]
    fates: Counter[str]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CameraPoses:
    """`world_from_camera` over time: a track and a chain from its body to the camera, or a chain alone."""

    track: PoseTrack | None
    body_from_camera: Chain
    source: str
    path: str

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """The first and the last stamp that have a pose; None where nothing moves."""
        spans = [span for span in (self.track.span_ns if self.track else None, self.body_from_camera.span_ns) if span]
        return (max(start for start, _ in spans), min(end for _, end in spans)) if spans else None

    def at(self, stamp_ns: int) -> NDArray[np.float64] | None:
        """Return the pose (4, 4) at a stamp, or None where there is none."""
        body_from_camera = self.body_from_camera.at(stamp_ns)
        if self.track is None or body_from_camera is None:
            return body_from_camera
        world_from_body = self.track.at(stamp_ns)
        return None if world_from_body is None else world_from_body @ body_from_camera


def read_rig(log: Log, topics: Iterable[Topic], max_gap_ns: int) -> Rig:
    """Return the poses, transforms and calibrations of a log, in one pass over those topics.

    Of a `CameraInfo` topic the first message counts. Poses that are no pose (NaN, a quaternion without length) are
    counted as `bad_pose` and left out.
    """
    by_name = {topic.name: topic for topic in topics}
    infos: dict[str, CameraInfo] = {}
    samples: dict[tuple[str, str, str], _Samples] = {}
    fates: Counter[str] = Counter()
    for message in log.messages(by_name):
        topic = by_name[message.topic]
        if message.topic in infos:
            continue
        try:
            decoded = deserialize(topic, message.data)
        except UnreadableMessageError:
            fates["unreadable_message"] += 1
            continue
        if topic.type_name == CAMERA_INFO:
            infos[topic.name] = camera_info_of(decoded)
            continue
        for pose in poses_of(topic.type_name, decoded):
            if is_pose_row(pose.row):
                samples.setdefault((topic.name, pose.parent, pose.child), _Samples()).add(pose)
            else:
                fates["bad_pose"] += 1
    tracks = {key: track_of(s.stamps_ns, s.rows(), max_gap_ns) for key, s in samples.items()}
    edges, streams = [], []
    for (name, parent, child), track in tracks.items():
        assert track is not None  # a key exists only with a pose
        if by_name[name].type_name in TF:
            edges.append(_edge(parent, child, track, is_static=name.endswith("tf_static")))
        else:
            type_name = by_name[name].type_name
            streams.append(PoseStream(topic=name, type_name=type_name, parent=parent, child=child, track=track))
    return Rig(streams=tuple(streams), tree=FrameTree(edges), infos=infos, fates=fates)


def camera_poses(path: object, rig: Rig, camera_frame: str, pose_frame: str | None, *, is_named: bool) -> CameraPoses:
    """Return the poses of the camera; `is_named` when a pose topic was asked for by name, so that TF is no substitute.

    Raises:
        CalibrationError: no pose can be carried to the camera's frame.
        RecordingError: there is no pose at all.
    """
    carried = [poses for stream in rig.streams if (poses := _carried(stream, rig.tree, camera_frame, pose_frame))]
    if carried:
        return max(carried, key=_preference)
    if not is_named and (chain := _chain_from_fixed(rig.tree, camera_frame)) is not None:
        return CameraPoses(track=None, body_from_camera=chain, source="TF", path=" <- ".join(chain.frames))
    if not rig.streams and not rig.tree.edges:
        raise RecordingError(f"{path}: the pose topics hold no pose")
    raise CalibrationError(_unconnected(path, rig, camera_frame))


def _carried(stream: PoseStream, tree: FrameTree, camera_frame: str, pose_frame: str | None) -> CameraPoses | None:
    """Return the camera's poses from a stream, or None where its body is not connected to the camera.

    The camera's frame itself needs no connection.
    """
    body = pose_frame or stream.child
    chain = tree.chain(body, camera_frame) if body else None
    if chain is None or stream.parent in chain.frames[1:]:
        return None
    path = " <- ".join((stream.parent, *chain.frames))
    return CameraPoses(track=stream.track, body_from_camera=chain, source=stream.topic, path=path)


def _preference(poses: CameraPoses) -> tuple[bool, bool, int, str]:
    """Rank poses: carried by static links, not of wheels alone, then the most of them."""
    assert poses.track is not None
    is_wheels = any(word in poses.source.lower() for word in ("wheel", "velocity_controller"))
    return poses.body_from_camera.is_static, not is_wheels, len(poses.track.stamps_ns), poses.source


def _chain_from_fixed(tree: FrameTree, camera_frame: str) -> Chain | None:
    """Return the chain from a fixed frame above the camera: one of a known name, else the top if it moves."""
    above = tree.ancestors(camera_frame)[1:]
    names = {frame.rsplit("/", 1)[-1]: frame for frame in reversed(above)}
    named = next((names[name] for name in _FIXED_FRAMES if name in names), None)
    if named is not None:
        return tree.chain(named, camera_frame)
    chain = tree.chain(above[-1], camera_frame) if above else None
    return None if chain is None or chain.is_static else chain


def _edge(parent: str, child: str, track: PoseTrack, *, is_static: bool) -> Edge:
    """Return the link of a track; a transform that never changes is static wherever it was published (ROS 1's /tf)."""
    if is_static or np.ptp(track.rows, axis=0).max() < 1e-9:
        return Edge(parent=parent, child=child, parent_from_child=pose_of_row(track.rows[-1]))
    return Edge(parent=parent, child=child, parent_from_child=track)


def _unconnected(path: object, rig: Rig, camera_frame: str) -> str:
    """Return what is missing between the poses and the camera."""
    known = f"frames of TF: {', '.join(sorted(rig.tree.edges)) or 'none'}"
    open_ended = [stream for stream in rig.streams if not stream.child]
    ended = [stream for stream in rig.streams if stream.child]
    if ended:
        bodies = ", ".join(f"{stream.topic} gives {stream.child} in {stream.parent}" for stream in ended)
        return (
            f"{path}: no transform from {ended[0].child} to the camera's frame {camera_frame}: {bodies}; {known}. "
            f"Record /tf_static, or say with --pose-frame that the pose is that of {camera_frame}"
        )
    if open_ended:
        stream = open_ended[0]
        return (
            f"{path}: {stream.topic} ({stream.type_name}) does not say which frame it is the pose of; "
            f"name it with --pose-frame (the camera's is {camera_frame}); {known}"
        )
    return (
        f"{path}: TF does not connect the camera's frame {camera_frame} to a fixed frame; {known}; name a --pose-topic"
    )
