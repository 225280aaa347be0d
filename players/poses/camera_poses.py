"""Camera poses of a log: from pose messages and TF to poses of the colour camera's optical frame.

An odometry topic with static TF (or profile) links to the camera comes first, then a TF chain from a fixed frame.
An unknown link is an error that names both ends. `PoseReader` collects messages; a `PosePlan` combines them.
"""

from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import CalibrationError, NoPosesError
from hickory_stream.geometry.rigid import compose, invert
from players.logs.containers import LogMessage, Topic, UnreadableMessageError, deserialize
from players.logs.robots import nearness
from players.logs.timeline import Order, Placed, Timeline
from players.messages.records import CAMERA_INFO, TF, CameraInfo, StampedPose, camera_info_of, poses_of
from players.poses.interpolation import pose_of_row
from players.poses.link_faults import LinkFaults
from players.poses.tf import Chain, Edge, FrameTree
from players.poses.tracks import GrowingTrack, Jump, JumpLimits
from players.profile import RigLinks

Key = tuple[str, str, str]
"""The key of a moving link: the topic (/tf of a namespace for its /tf_static, too), parent and child."""

_NUM_FIRST = 15

_MOTION_NS, _MOVED = 1_000_000_000, 0.1
"""Robots are told apart by their motion over that time, of at least as many metres or radians."""

_FIXED_FRAMES = ("odom", "world", "map", "earth")
"""Fixed frames for poses from TF alone: odom first, since it does not jump when a loop is closed."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PoseStream:
    """A pose topic: parent_from_child over time; `child` is "" if the topic does not name it."""

    topic: str
    type_name: str
    parent: str
    child: str
    num_poses: int

    @property
    def is_own_parent(self) -> bool:
        """Whether its child frame is its parent, so that it does not name its body."""
        return bool(self.child) and self.child == self.parent

    @property
    def key(self) -> Key:
        """The key of its link."""
        return self.topic, self.parent, self.child


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Link:
    # A static link, or the key of a moving one with its value when the log was opened.
    static: NDArray[np.float64]
    key: Key | None
    is_inverted: bool


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PosePlan:
    """The composition of `world_from_camera`: a stream (None: TF alone), then links from its body to the camera."""

    stream: PoseStream | None
    links: tuple[_Link, ...]
    #: No link moves.
    is_static: bool
    source: str
    #: Names of the frames, for people.
    path: str
    #: Origin of the links, for people.
    extrinsics: str
    #: The two ends of links that are those of TF.
    ends: tuple[str, str] | None = None

    @property
    def keys(self) -> tuple[Key, ...]:
        """The moving links."""
        moving = tuple(link.key for link in self.links if link.key is not None)
        return moving if self.stream is None else (self.stream.key, *moving)

    def at(self, stamp_ns: int, epoch: int, reader: "PoseReader") -> NDArray[np.float64] | None:
        """Return the pose (4, 4) at a stamp, or None where there is none."""
        world_from_camera = np.eye(4)
        if self.stream is not None:
            track = reader.track(self.stream.key, epoch)
            pose = track.at(stamp_ns) if track is not None else None
            if pose is None:
                return None
            world_from_camera = pose
        for link in self.links:
            pose = link.static if link.key is None else _moving(link, stamp_ns, epoch, reader)
            if pose is None:
                return None
            world_from_camera = compose(world_from_camera, invert(pose) if link.is_inverted else pose)
        return world_from_camera

    def reaches(self, stamp_ns: int, epoch: int, reader: "PoseReader") -> bool:
        """Return whether the pose at a stamp is final: no later message can change it."""
        for key in self.keys:
            if reader.epoch_of(key) > epoch:
                continue
            track = reader.track(key, epoch)
            if track is None or not track.reaches(stamp_ns):
                return False
        return True

    def jump_between(self, start_ns: int, end_ns: int, epoch: int, reader: "PoseReader") -> Jump | None:
        """Return the last jump of a link between two stamps."""
        for key in self.keys:
            track = reader.track(key, epoch)
            jump = track.jump_between(start_ns, end_ns) if track is not None else None
            if jump is not None:
                return jump
        return None

    def relinked(self, tree: FrameTree) -> "PosePlan | None":
        """Return the plan with the static links as they are now; None while its moving links are not in the tree."""
        if self.ends is None:
            return self
        chain = tree.chain(*self.ends)
        now = replace(self, links=_links_of(chain)) if chain is not None else self
        return now if chain is not None and now.keys == self.keys else None


UNPOSED = PosePlan(stream=None, links=(), is_static=True, source="none", path="none", extrinsics="none")
"""The plan of a log without poses: each frame has the identity as its pose until odometry estimates one."""


def _moving(link: _Link, stamp_ns: int, epoch: int, reader: "PoseReader") -> NDArray[np.float64] | None:
    # A link that never changed is valid at any time, like static links on /tf in ROS 1.
    assert link.key is not None
    track = reader.track(link.key, epoch)
    if track is None or not track.num_added:
        return link.static
    return track.any_pose() if track.is_constant else track.at(stamp_ns)


class PoseReader:
    """Takes pose, TF and calibration messages as they stream by."""

    def __init__(
        self, topics: Iterable[Topic], max_gap_ns: int, limits: JumpLimits, *, uses_log_time: bool = False
    ) -> None:
        self._topics = {topic.name: topic for topic in topics}
        self._max_gap_ns = max_gap_ns
        self._limits = limits
        self._uses_log_time = uses_log_time
        self._timelines: dict[Key, Timeline] = {}
        self._tracks: dict[tuple[Key, int], GrowingTrack] = {}
        #: The stamps and log times of the first poses of each link.
        self.first_ns: dict[Key, list[tuple[int, int]]] = {}
        self._statics: dict[tuple[str, str], tuple[str, NDArray[np.float64]]] = {}
        self._faults = LinkFaults()
        #: How often a static link was published first or with other values than before.
        self.num_static = 0
        self._info_bytes: dict[str, bytes] = {}
        self._loaded: list[PoseStream] = []
        self.infos: dict[str, CameraInfo] = {}
        self.seen: set[str] = set()
        self.fates: Counter[str] = Counter()
        #: Why the first unreadable message is one.
        self.error = ""
        self.rejected: Counter[str] = Counter()

    def add(self, message: LogMessage, clock: int = 0, shift_ns: int = 0) -> None:
        """Take one message of one of the topics; `clock` counts the steps of the robot's clock before it.

        `shift_ns` corrects the stamps of its poses.
        """
        topic = self._topics[message.topic]
        self.seen.add(topic.name)
        if topic.type_name == CAMERA_INFO:
            self._add_info(topic, message)
        else:
            self._add_poses(topic, message, clock, shift_ns)

    def load(self, stream: PoseStream, stamps_ns: Sequence[int], rows: Sequence[Sequence[float]]) -> None:
        """Take a whole trajectory, as from a file."""
        track = self._tracks[stream.key, 0] = GrowingTrack(self._max_gap_ns, None)
        for stamp_ns, row in sorted(zip(stamps_ns, rows, strict=True)):
            track.add(stamp_ns, row)
        self._loaded.append(stream)

    def end(self) -> None:
        """Add the messages that were waiting for a later one."""
        for key, timeline in self._timelines.items():
            self._place(key, timeline.end())

    def track(self, key: Key, epoch: int) -> GrowingTrack | None:
        """Return the poses of a moving link in an epoch."""
        return self._tracks.get((key, epoch))

    def epoch_of(self, key: Key) -> int:
        """Return the current epoch of a link."""
        timeline = self._timelines.get(key)
        return timeline.epoch if timeline else 0

    def faults(self) -> dict[str, bool]:
        """Return one line for each fault of a link so far, and whether it does harm."""
        return self._faults.texts((key, track) for (key, _), track in self._tracks.items())

    def harm(self) -> list[str]:
        """Return the first of the faults that leave links out, if there is one."""
        return [text for text, is_harmful in self.faults().items() if is_harmful][:1]

    def forget(self, before_ns: int) -> None:
        """Drop poses that no later frame needs."""
        for track in self._tracks.values():
            track.forget(before_ns)

    def forget_older(self, kept_ns: int) -> None:
        """Drop the poses of each link that are older than its newest by more than this."""
        for track in self._tracks.values():
            if track.newest_ns is not None:
                track.forget(track.newest_ns - kept_ns)

    def tracks(self) -> Iterable[tuple[Key, GrowingTrack]]:
        """Yield all tracks with their keys."""
        return [(key, track) for (key, _), track in self._tracks.items()]

    def streams(self) -> tuple[PoseStream, ...]:
        """Return the pose streams so far, each with the declared number of its poses."""
        found = {stream.key: stream for stream in self._loaded}
        for key, epoch in self._tracks:
            name, parent, child = key
            if name in self._topics and self._topics[name].type_name not in TF:
                topic, track = self._topics[name], self._tracks[key, epoch]
                number = topic.num_messages if topic.num_messages is not None else track.num_added
                found[key] = PoseStream(
                    topic=name, type_name=topic.type_name, parent=parent, child=child, num_poses=number
                )
        return tuple(found.values())

    def tree(self) -> FrameTree:
        """Return the current TF tree; links that have not changed so far are static."""
        edges = [
            Edge(parent=parent, child=child, parent_from_child=pose, scope=scope)
            for (scope, child), (parent, pose) in self._statics.items()
        ]
        for ((name, parent, child), epoch), track in self._tracks.items():
            if name in self._topics and self._topics[name].type_name in TF and epoch == 0 and track.num_added:
                link = track.any_pose() if track.is_constant else track
                edges.append(
                    Edge(parent=parent, child=child, parent_from_child=link, is_published_static=False, scope=name)
                )
        return FrameTree(edges)

    def _add_info(self, topic: Topic, message: LogMessage) -> None:
        # The bytes behind the stamp are equal in every message of one calibration.
        content = bytes(message.data[12:]) if not topic.foreign_type else bytes(message.data)
        if self._info_bytes.get(topic.name) == content:
            return
        try:
            info = camera_info_of(deserialize(topic, message.data))
        except (UnreadableMessageError, ValueError, AttributeError) as error:
            self._unreadable(error)
            return
        self._info_bytes[topic.name] = content
        known = self.infos.get(topic.name)
        is_set = info.K[0, 0] > 0
        if known is None or (is_set and not known.K[0, 0] > 0):
            self.infos[topic.name] = info
        elif is_set and (known.layout != info.layout or np.abs(known.K - info.K).max() > 1e-6):
            self.fates["camera_info_changed"] += 1

    def _add_poses(self, topic: Topic, message: LogMessage, clock: int, shift_ns: int) -> None:
        try:
            poses = poses_of(topic.type_name, deserialize(topic, message.data))
        except (UnreadableMessageError, AttributeError) as error:  # A damaged definition lacks fields.
            self._unreadable(error)
            return
        is_tf = topic.type_name in TF
        is_static = is_tf and topic.name.endswith("tf_static")
        name = topic.name.removesuffix("_static") if is_static else topic.name
        num_bad = 0
        for pose in poses:
            if is_tf and pose.parent == pose.child:
                self._faults.count("self", topic.name, pose)
            elif not self._faults.is_usable(topic.name, pose):
                num_bad += 1
            elif is_static:
                self._add_static(name, pose)
            else:
                key = (name, pose.parent, pose.child)
                first_ns = self.first_ns.setdefault(key, [])
                if len(first_ns) < _NUM_FIRST:
                    first_ns.append((pose.stamp_ns, message.log_ns))
                if self._uses_log_time:
                    self._add_pose(key, pose, message.log_ns, 0)
                else:
                    # Each link has its own clock: one that is wrong does no harm to the others.
                    timeline = self._timelines.setdefault(key, Timeline())
                    self._place(key, timeline.add(pose.stamp_ns + shift_ns, pose, clock))
        if num_bad:
            self.fates["bad_pose"] += num_bad
            self.rejected[topic.name] += num_bad == len(poses)

    def _add_static(self, scope: str, pose: StampedPose) -> None:
        parent_from_child = pose_of_row(np.array(pose.row))
        before = self._statics.get((scope, pose.child))
        if before is None or self._faults.is_changed(f"{scope}_static", pose, parent_from_child, before):
            self.num_static += 1
        self._statics[scope, pose.child] = (pose.parent, parent_from_child)

    def _place(self, key: Key, placed: Iterable[Placed]) -> None:
        for entry in placed:
            if entry.order is not Order.OFF:
                self._add_pose(key, entry.item, entry.stamp_ns, entry.epoch)
            elif self._topics[key[0]].type_name in TF:
                self.fates["pose_stamp_off"] += 1
            else:
                self._reject(self._topics[key[0]], "pose_stamp_off")

    def _add_pose(self, key: Key, pose: StampedPose, stamp_ns: int, epoch: int) -> None:
        track = self._tracks.get((key, epoch))
        if track is None:
            track = self._tracks[key, epoch] = GrowingTrack(self._max_gap_ns, self._limits)
        before, doubles = track.num_teleports, track.num_duplicates
        track.add(stamp_ns, pose.row)
        self.fates["pose_teleport"] += track.num_teleports - before
        if self._topics[key[0]].type_name not in TF:
            self.fates["duplicate_pose"] += track.num_duplicates - doubles
            self.rejected[key[0]] += track.num_teleports - before + track.num_duplicates - doubles

    def _unreadable(self, error: Exception) -> None:
        self.fates["unreadable_message"] += 1
        self.error = self.error or str(error)

    def _reject(self, topic: Topic, fate: str) -> None:
        self.fates[fate] += 1
        self.rejected[topic.name] += 1


def with_extrinsics(plan: PosePlan, body_from_camera: NDArray[np.float64], origin: str) -> PosePlan:
    """Return the plan with another camera pose on its body."""
    link = _Link(static=body_from_camera, key=None, is_inverted=False)
    return replace(plan, links=(link,), is_static=True, extrinsics=origin)


def body_from_camera_of(plan: PosePlan) -> NDArray[np.float64]:
    """Return `body_from_camera` (4, 4) of a plan without moving links."""
    body_from_camera = np.eye(4)
    for link in plan.links:
        body_from_camera = compose(body_from_camera, invert(link.static) if link.is_inverted else link.static)
    return body_from_camera


def plan_poses(
    path: object,
    reader: PoseReader,
    camera_frame: str,
    *,
    color_topic: str,
    pose_frame: str | None,
    is_named: bool,
    rig: RigLinks | None,
    rig_topics: Collection[str],
    profile_name: str,
) -> PosePlan:
    """Return the plan of the camera's pose; `is_named`: a pose topic was asked for, so that TF does not replace it.

    `rig` is the profile's and is valid for `rig_topics` only, since a profile does not know the body of other topics.

    Raises `CalibrationError`: no pose is connected to the camera's frame; `NoPosesError`: there is no pose.
    """
    tree, streams = reader.tree(), reader.streams()
    if rig is None or not is_named:
        carried = [plan for stream in streams if (plan := _carried(stream, tree, camera_frame, pose_frame))]
        if carried:
            return _preferred(path, carried, color_topic, reader)
        if not is_named and rig is None and (chain := _chain_from_fixed(tree, camera_frame)) is not None:
            return _plan_of(None, chain, chain.frames, "TF of the log")
    elif carried := [plan for s in streams if s.child and (plan := _carried(s, tree, camera_frame, pose_frame))]:
        return _preferred(path, carried, color_topic, reader)
    of_the_rig = [stream for stream in streams if stream.topic in rig_topics]
    if rig is not None and of_the_rig:
        stream = max(of_the_rig, key=lambda s: (s.num_poses, s.topic))
        chain = FrameTree(rig.links).chain(rig.body, rig.color)
        if chain is None:
            raise CalibrationError(f"profile {profile_name}: its links do not connect {rig.body} to {rig.color}")
        frames = (stream.parent, *([stream.child] if stream.child else []), *chain.frames)
        return _plan_of(stream, chain, frames, f"profile {profile_name}")
    if not streams and not tree.edges:
        raise NoPosesError(f"{path}: the pose topics hold no pose; --odometry depth estimates them")
    reason = "; ".join([_unconnected(path, streams, tree, camera_frame), *reader.harm()])
    if not streams and not any(isinstance(edge.parent_from_child, GrowingTrack) for edge in tree.edges.values()):
        raise NoPosesError(f"{reason}, or estimate poses with --odometry depth")
    if rig is not None:
        reason += f". The profile {profile_name} knows the body of {' or '.join(rig_topics)} only: play that log, too"
    raise CalibrationError(reason)


def _carried(stream: PoseStream, tree: FrameTree, camera_frame: str, pose_frame: str | None) -> PosePlan | None:
    body = pose_frame or (stream.child if not stream.is_own_parent else "")
    chain = tree.chain(body, camera_frame) if body else None
    if chain is None or stream.parent in chain.frames[1:]:
        return None
    extrinsics = "TF of the log" if chain.edges else "none: the pose is the camera's"
    return _plan_of(stream, chain, (stream.parent, *chain.frames), extrinsics)


def _plan_of(stream: PoseStream | None, chain: Chain, frames: Sequence[str], extrinsics: str) -> PosePlan:
    return PosePlan(
        stream=stream,
        links=_links_of(chain),
        is_static=chain.is_static,
        source=stream.topic if stream is not None else "TF",
        path=" <- ".join(frames),
        extrinsics=extrinsics,
        ends=(chain.frames[0], chain.frames[-1]) if chain.edges and not extrinsics.startswith("profile") else None,
    )


def _links_of(chain: Chain) -> tuple[_Link, ...]:
    links = []
    for edge, is_inverted in chain.edges:
        link = edge.parent_from_child
        is_fixed = isinstance(link, np.ndarray) and edge.is_published_static
        static = link.any_pose() if isinstance(link, GrowingTrack) else np.asarray(link)
        key = None if is_fixed else (edge.scope, edge.parent, edge.child)
        links.append(_Link(static=static, key=key, is_inverted=is_inverted))
    return tuple(links)


def _preferred(path: object, plans: Sequence[PosePlan], color_topic: str, reader: PoseReader) -> PosePlan:
    # Topics that differ in their namespace only may be those of two robots: the one nearest to the camera's is taken.
    best = max(plans, key=_preference)
    name = best.source.rpartition("/")[2]
    twins = [plan for plan in plans if plan.path == best.path and plan.source.rpartition("/")[2] == name]
    nearest = max(nearness(plan.source, color_topic) for plan in twins)
    twins = [plan for plan in twins if nearness(plan.source, color_topic) == nearest]
    best = max(twins, key=_preference)
    rivals = [plan for plan in twins if plan is not best and not _are_alike(plan, best, reader)]
    if rivals:
        raise CalibrationError(
            f"{path}: {best.source} and {rivals[0].source} give poses of one frame that do not move alike, and may "
            f"be those of two robots; name the one with the camera of {color_topic} with --pose-topic"
        )
    return best


def _are_alike(a: PosePlan, b: PosePlan, reader: PoseReader) -> bool:
    # Motions over a second do not depend on where the two worlds lie.
    tracks = [track for plan in (a, b) if (track := reader.track(plan.keys[0], 0)) is not None]
    start_ns = max(track.first_ns or 0 for track in tracks)
    end_ns = min(track.newest_ns or 0 for track in tracks) - _MOTION_NS
    moved, apart = [0.0], [0.0]
    for stamp_ns in range(start_ns, end_ns + 1, max(1, (end_ns - start_ns) // 20)):
        poses = [(track.at(stamp_ns), track.at(stamp_ns + _MOTION_NS)) for track in tracks]
        steps = [compose(invert(before), after) for before, after in poses if before is not None and after is not None]
        if len(steps) == 2:
            moved += [float(np.abs(step - np.eye(4)).max()) for step in steps]
            apart.append(float(np.abs(steps[0] - steps[1]).max()))
    return max(moved) > _MOVED and float(np.median(apart)) < 0.3 * max(moved)


def _preference(plan: PosePlan) -> tuple[bool, bool, int, str]:
    # Static links, then other odometry than wheels alone, then the most poses.
    assert plan.stream is not None
    is_wheels = any(word in plan.source.lower() for word in ("wheel", "velocity_controller"))
    return plan.is_static, not is_wheels, plan.stream.num_poses, plan.source


def _chain_from_fixed(tree: FrameTree, camera_frame: str) -> Chain | None:
    # From a frame of a known name, else from the root if it moves.
    above = tree.ancestors(camera_frame)[1:]
    names = {frame.rsplit("/", 1)[-1]: frame for frame in reversed(above)}
    named = next((names[name] for name in _FIXED_FRAMES if name in names), None)
    if named is not None:
        return tree.chain(named, camera_frame)
    chain = tree.chain(above[-1], camera_frame) if above else None
    return None if chain is None or chain.is_static else chain


def own_parent_text(stream: PoseStream) -> str:
    """Return why a topic is left out whose child frame is its parent."""
    return (
        f"{stream.topic} is left out: its child frame {stream.child} is its parent, so that its body is not known; "
        "name that with --pose-frame"
    )


def _unconnected(path: object, streams: Sequence[PoseStream], tree: FrameTree, camera_frame: str) -> str:
    known = f"frames of TF: {', '.join(sorted(tree.edges)) or 'none'}"
    open_ended = [stream for stream in streams if not stream.child]
    ended = [stream for stream in streams if stream.child and not stream.is_own_parent]
    own_parents = [stream for stream in streams if stream.is_own_parent]
    if own_parents and not ended:
        return f"{path}: {own_parent_text(own_parents[0])}; {known}"
    if ended:
        bodies = ", ".join(f"{stream.topic} gives {stream.child} in {stream.parent}" for stream in ended)
        return (
            f"{path}: no transform from {ended[0].child} to the camera's frame {camera_frame}: {bodies}; {known}. "
            f"Record /tf_static, say with --pose-frame that the pose is that of {camera_frame}, or name a --profile "
            "with the links of this robot"
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
