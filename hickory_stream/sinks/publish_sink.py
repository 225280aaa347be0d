"""Publishes the map to a robot over its live link, and answers its goals with paths.

Costmap, objects, markers and `map -> odom` follow the map; a `geometry_msgs/PoseStamped` on `/goal_pose` is answered
with a `nav_msgs/Path` on `/plan`. Names and QoS are the ones of Nav2 and RViz. Nothing here delays the map: a thread
sends from a bounded queue, and late messages are dropped and counted.
"""

import logging
import queue
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Collection
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import HickoryError, InputError
from hickory_stream.navigation.costmap import Costmap, Followed
from hickory_stream.navigation.free_space import FreeSpace
from hickory_stream.navigation.robot import Robot
from hickory_stream.navigation.search import NoPath, Path, plan
from hickory_stream.navigation.stand_ins import SeenSurface
from hickory_stream.records import FrameReport, MapSnapshot
from hickory_stream.sinks import ros_messages as ros

logger = logging.getLogger(__name__)

MOST_BYTES = 16 << 20
_CLOSE_S = 2.0


class ReturnLink(Protocol):
    """A live route that can publish. `send` may block, and never raises."""

    def offer(self, name: str, type_name: str, *, definition: str, type_hash: str, is_latched: bool) -> None:
        """Announce a topic, and again after a reconnection; a latched topic keeps its last message."""

    def send(self, name: str, data: bytes) -> bool:
        """Publish a message of an offered topic; return False without a subscriber."""

    def listen(self, name: str, hear: Callable[[bytes], None]) -> None:
        """Call `hear` with each message of a topic, on a thread of the link."""


class Outbox:
    """Sends messages in order; when they take too much memory, the oldest are dropped and `overtaken` gets their names.

    Fates: `sent`, `unheard` (no subscriber), `dropped`.
    """

    def __init__(
        self, link: ReturnLink, overtaken: Callable[[str], None] = lambda name: None, *, most_bytes: int = MOST_BYTES
    ) -> None:
        self._link = link
        self._overtaken = overtaken
        self._most_bytes = most_bytes
        self._changed = threading.Condition()
        self._waiting: deque[tuple[str, bytes]] = deque()
        self._num_bytes = 0
        self._is_over = False
        self._fates: Counter[tuple[str, str]] = Counter()
        self._thread = threading.Thread(target=self._run, name="publish", daemon=True)
        self._thread.start()

    def put(self, name: str, data: bytes, *, is_urgent: bool = False) -> None:
        """Queue a message; urgent ones go first."""
        dropped: list[str] = []
        with self._changed:
            if is_urgent:
                self._waiting.appendleft((name, data))
            else:
                self._waiting.append((name, data))
            self._num_bytes += len(data)
            while self._num_bytes > self._most_bytes and len(self._waiting) > 1:
                old, content = self._waiting.popleft()
                self._num_bytes -= len(content)
                self._fates[old, "dropped"] += 1
                dropped.append(old)
            self._changed.notify()
        for old in dropped:
            self._overtaken(old)

    def fates(self) -> dict[str, dict[str, int]]:
        """Return the number of messages by topic and fate."""
        with self._changed:
            found: dict[str, dict[str, int]] = {}
            for (name, fate), number in sorted(self._fates.items()):
                found.setdefault(name, {})[fate] = number
            return found

    def close(self) -> None:
        """Send the queue for a moment, then count the rest as dropped."""
        with self._changed:
            self._is_over = True
            self._changed.notify()
        self._thread.join(_CLOSE_S)
        with self._changed:
            for name, _ in self._waiting:
                self._fates[name, "dropped"] += 1
            self._waiting.clear()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._is_over)
                if not self._waiting:
                    return
                name, data = self._waiting.popleft()
                self._num_bytes -= len(data)
            is_heard = self._link.send(name, data)
            with self._changed:
                self._fates[name, "sent" if is_heard else "unheard"] += 1


MAP_TOPIC, UPDATES_TOPIC, TF_TOPIC = "/map", "/map_updates", "/tf"
OBJECTS_TOPIC, MARKERS_TOPIC = "/hickory_stream/objects", "/hickory_stream/markers"
PLAN_TOPIC, GOAL_TOPIC = "/plan", "/goal_pose"
PARTS = ("costmap", "objects", "markers", "tf", "plan")
_TOPICS = {
    "costmap": ((MAP_TOPIC, ros.GRID, True), (UPDATES_TOPIC, ros.UPDATE, False)),
    "objects": ((OBJECTS_TOPIC, ros.DETECTIONS, False),),
    "markers": ((MARKERS_TOPIC, ros.MARKERS, True),),
    "tf": ((TF_TOPIC, ros.TRANSFORMS, False),),
    "plan": ((PLAN_TOPIC, ros.PATH, False),),
}
_OBJECTS_EVERY_S = 0.5
# Maximum age of the whole grid, which a late subscriber gets without earlier windows.
_WHOLE_EVERY_S = 5.0
# A goal is planned in the newest map; frequent updates shorten the answer.
_FOLLOWED_EVERY_S = 1.0
_GOALS = 4
# As in AMCL (transform_tolerance): look-ups come a little later than the keyframe.
_TF_AHEAD_NS = 1_000_000_000
_CELL_M = 0.05


class PublishSink:
    """Publishes `parts` of `PARTS` over a link; raises `InputError` for an unknown part.

    `odom_frame` is the frame of the robot's poses.
    """

    def __init__(self, robot: Robot, link: ReturnLink, *, odom_frame: str, parts: Collection[str] = PARTS) -> None:
        unknown = sorted(set(parts) - set(PARTS))
        if unknown:
            raise InputError(f"found {unknown[0]} to publish, expected some of {', '.join(PARTS)}")
        self._parts = frozenset(parts)
        self._odom_frame = odom_frame or "odom"
        self._seen = SeenSurface()
        self._costmap = Costmap(robot, cell_m=_CELL_M, seen=self._seen)
        self._space = followed_space(robot, cell_m=_CELL_M, seen=self._seen)
        self._lock = threading.Lock()
        self._map_from_odom = np.eye(4)
        self._robot_at: NDArray[np.float64] | None = None
        self._stamp_ns = 0
        self._unfollowed: MapSnapshot | None = None
        self._told_s = self._whole_s = self._followed_s = -np.inf
        self._goals: queue.Queue[bytes | None] = queue.Queue(_GOALS)
        self._goal_fates = {"answered": 0, "no_path": 0, "refused": 0, "dropped": 0}
        ros.warm_up()
        self._outbox = Outbox(link, self._overtaken)
        for part in PARTS:
            for name, type_name, is_latched in _TOPICS[part] if part in self._parts else ():
                definition, type_hash = ros.definition_of(type_name), ros.hash_of(type_name)
                link.offer(name, type_name, definition=definition, type_hash=type_hash, is_latched=is_latched)
        self._planner: threading.Thread | None = None
        if "plan" in self._parts:
            self._planner = threading.Thread(target=self._answer_goals, name="publish-plan", daemon=True)
            self._planner.start()
            link.listen(GOAL_TOPIC, self._goals_put)

    def show(self, report: FrameReport) -> None:
        """Publish the changes of the report's snapshot."""
        snapshot = report.snapshot
        if snapshot is None:
            return
        map_from_odom = snapshot.submaps[-1].world_from_submap if snapshot.submaps else np.eye(4)
        with self._lock:
            self._stamp_ns = report.stamp_ns
            self._map_from_odom = map_from_odom
            self._robot_at = (map_from_odom @ report.world_from_camera)[:2, 3]
            self._space.drove(self._robot_at)
            if report.space is not None:
                self._seen.add(report.space, snapshot)
            self._unfollowed = snapshot
            if "plan" in self._parts and time.monotonic() - self._followed_s >= _FOLLOWED_EVERY_S:
                self._follow()
        if "tf" in self._parts:
            data = ros.transform_message(report.stamp_ns + _TF_AHEAD_NS, self._odom_frame, map_from_odom)
            self._outbox.put(TF_TOPIC, data)
        if "costmap" in self._parts:
            if time.monotonic() - self._whole_s >= _WHOLE_EVERY_S:
                self._whole_s = time.monotonic()
                self._costmap.begin_again()
            update = self._costmap.update(snapshot)
            if update is not None:
                self._outbox.put(MAP_TOPIC if update.is_whole else UPDATES_TOPIC, ros.grid_message(update)[1])
        is_last = report.frame is None
        if is_last or time.monotonic() - self._told_s >= _OBJECTS_EVERY_S:
            self._told_s = time.monotonic()
            self._tell_objects(snapshot)

    def counts(self) -> dict[str, Any]:
        """Return the number of messages by topic and fate, and of goals by outcome."""
        return {"topics": self._outbox.fates(), "goals": dict(self._goal_fates)}

    def close(self) -> None:
        """Send the queue for a moment, and end."""
        if self._planner is not None:
            self._goals_put(None)
            self._planner.join(2.0)
        self._outbox.close()

    def _follow(self) -> None:
        # Updates the planner's grid to the newest snapshot; the lock is held.
        if self._unfollowed is not None:
            self._space.update(self._unfollowed)
            self._unfollowed = None
            self._followed_s = time.monotonic()

    def _tell_objects(self, snapshot: MapSnapshot) -> None:
        if "objects" in self._parts:
            self._outbox.put(OBJECTS_TOPIC, ros.detections_message(snapshot))
        if "markers" in self._parts:
            self._outbox.put(MARKERS_TOPIC, ros.markers_message(snapshot))

    def _overtaken(self, name: str) -> None:
        # A window that is missing leaves old cells in the robot's grid.
        if name in (MAP_TOPIC, UPDATES_TOPIC):
            self._costmap.begin_again()

    def _goals_put(self, data: bytes | None) -> None:
        # Of too many goals the oldest are dropped.
        while True:
            try:
                self._goals.put_nowait(data)
            except queue.Full:
                try:
                    self._goals.get_nowait()
                    self._goal_fates["dropped"] += 1
                except queue.Empty:
                    continue
            else:
                return

    def _answer_goals(self) -> None:
        while (data := self._goals.get()) is not None:
            answer = self._answer(data)
            if isinstance(answer, str):
                self._goal_fates["refused"] += 1
                logger.warning("a goal was refused: %s", answer)
                continue
            self._goal_fates["answered" if answer is not None else "no_path"] += 1
            self._outbox.put(PLAN_TOPIC, ros.path_message(self._stamp_ns, answer), is_urgent=True)

    def _answer(self, data: bytes) -> Path | str | None:
        goal = ros.goal_of(data)
        if goal is None:
            return f"{GOAL_TOPIC} was sent {len(data)} bytes that are no PoseStamped with a finite place"
        if goal.frame not in (ros.FRAME_ID, self._odom_frame):
            return f"found the frame {goal.frame!r}, expected {ros.FRAME_ID} or {self._odom_frame}"
        with self._lock:
            self._follow()
            space, start = self._space.grid, self._robot_at
            if space is None or start is None:
                return "nothing was mapped yet"
            try:
                place = goal.place
                if goal.frame != ros.FRAME_ID:
                    place = (self._map_from_odom @ np.array([*place, 0.0, 1.0]))[:2]
                found = plan(space, start, place)
            except HickoryError as error:
                return str(error)
        if isinstance(found, NoPath):
            logger.warning("no path to (%.2f, %.2f): %s", *goal.place, found.text)
            return None
        return found


def followed_space(robot: Robot, *, cell_m: float, seen: SeenSurface) -> Followed[FreeSpace]:
    """Return the free space of a robot, updated from the snapshots of a live run."""
    num_layers = len(robot.postures) * robot.num_headings
    return Followed(
        lambda frame, floor_m: FreeSpace(robot, frame, floor_m),
        robot.heights_m,
        cell_m=cell_m,
        reach_m=robot.reach_m,
        num_layers=num_layers,
        seen=seen,
    )
