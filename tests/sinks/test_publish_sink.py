import threading
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise
import numpy as np
import pytest
from hickory_stream.errors import InputError
from hickory_stream.navigation.robot import load_robot
from hickory_stream.records import ObjectKind, Phase, SpaceObservation
from hickory_stream.sinks import publish_sink
from hickory_stream.sinks.ros_messages import goal_message, store
from tests.navigation.rooms import boxes, snapshot, table, tracked
from tests.players.live.robot_fixtures import eventually
from tests.sinks.report_fixtures import bare_report

ROBOT = load_robot("point")
START = (0.5, 0.5)
NOTHING = np.empty(0, np.int64)


@dataclass
class Link:
    """A link that keeps what it is sent; `gate` holds it up while it is not set."""

    offers: dict[str, tuple[str, bool]] = field(default_factory=dict)
    sent: list[tuple[str, bytes]] = field(default_factory=list)
    ears: dict[str, Callable[[bytes], None]] = field(default_factory=dict)
    gate: threading.Event = field(default_factory=threading.Event)
    is_there: bool = True

    def __post_init__(self):
        self.gate.set()

    def offer(self, name, type_name, *, definition, type_hash, is_latched):
        assert definition
        assert type_hash.startswith("RIHS01_")
        self.offers[name] = (type_name, is_latched)

    def send(self, name, data):
        self.gate.wait(10.0)
        self.sent.append((name, data))
        return self.is_there

    def listen(self, name, hear):
        self.ears[name] = hear

    def last(self, name):
        data = next(data for sent, data in reversed(self.sent) if sent == name)
        return store().deserialize_cdr(data, self.offers[name][0])


def report(of, at=START):
    pose = np.eye(4)
    pose[:2, 3] = at
    space = SpaceObservation(free_keys=NOTHING, structure_keys=NOTHING, floor_z_m=0.0)
    return bare_report(
        stamp_ns=1_700_000_000_500_000_000, keyframe_index=0, world_from_camera=pose, snapshot=of, space=space
    )


def room(**options):
    crate = replace(tracked(2, boxes(((4.5, 1.0, 0.3), (0.3, 0.3, 0.3))), with_shape=False), phase=Phase.TENTATIVE)
    return snapshot(tracked(1, table()), crate, **options)


def told(*snapshots, link=None):
    """What a link has been sent once everything was."""
    link = link or Link()
    sink = publish_sink.PublishSink(ROBOT, link, odom_frame="odom")
    for of in snapshots:
        sink.show(report(of))
    sink.close()
    return link


def test_topics_have_the_types_and_durability_of_nav2():
    assert told().offers == {
        publish_sink.MAP_TOPIC: ("nav_msgs/msg/OccupancyGrid", True),
        publish_sink.UPDATES_TOPIC: ("map_msgs/msg/OccupancyGridUpdate", False),
        publish_sink.OBJECTS_TOPIC: ("vision_msgs/msg/Detection3DArray", False),
        publish_sink.MARKERS_TOPIC: ("visualization_msgs/msg/MarkerArray", True),
        publish_sink.TF_TOPIC: ("tf2_msgs/msg/TFMessage", False),
        publish_sink.PLAN_TOPIC: ("nav_msgs/msg/Path", False),
    }


def test_objects_have_ids_kinds_boxes_and_poses():
    of = room()
    attached = replace(of.objects[0], kind=ObjectKind.FIXTURE, fixture_probability=0.75)
    detections = told(replace(of, objects=(attached, of.objects[1]))).last(publish_sink.OBJECTS_TOPIC).detections
    assert [found.id for found in detections] == ["1", "2"]
    classes = [[(one.hypothesis.class_id, one.hypothesis.score) for one in found.results] for found in detections]
    assert classes == [[("fixture", 0.75), ("object", 0.25)], [("observed_only", 1), ("object", 1), ("fixture", 0)]]
    for found, item in zip(detections, of.objects, strict=True):
        center, size = found.bbox.center.position, found.bbox.size
        assert [center.x, center.y, center.z] == pytest.approx(item.box.center)
        assert [size.x, size.y, size.z] == pytest.approx(2 * item.box.half_extents_m)


def test_the_markers_begin_with_the_order_to_forget_the_others():
    markers = told(room()).last(publish_sink.MARKERS_TOPIC).markers
    assert markers[0].action == 3
    assert [(m.ns, m.id, m.type) for m in markers[1:]] == [
        ("objects", 1, 1),
        ("objects/ids", 1, 9),
        ("observed_only", 2, 1),
        ("observed_only/ids", 2, 9),
    ]


def test_the_costmap_starts_with_the_observed_and_sends_changes():
    link = told(snapshot(), room())
    assert [name for name, _ in link.sent if name in (publish_sink.MAP_TOPIC, publish_sink.UPDATES_TOPIC)] == [
        publish_sink.MAP_TOPIC,
        publish_sink.UPDATES_TOPIC,
    ]
    grid, update = link.last(publish_sink.MAP_TOPIC), link.last(publish_sink.UPDATES_TOPIC)
    states = np.array(grid.data).reshape(grid.info.height, grid.info.width)
    window = states[update.y : update.y + update.height, update.x : update.x + update.width]
    window[:] = np.array(update.data).reshape(update.height, update.width)
    column = int((4.5 - grid.info.origin.position.x) / grid.info.resolution)
    assert states[int((1.0 - grid.info.origin.position.y) / grid.info.resolution), column] == 100
    assert grid.header.frame_id == "map"


def test_map_from_odom_is_the_identity_until_a_placement():
    moved = np.eye(4)
    moved[:2, 3] = 1.0, -2.0
    for pose in (np.eye(4), moved):
        (found,) = told(snapshot(world_from_submap=pose)).last(publish_sink.TF_TOPIC).transforms
        assert (found.header.frame_id, found.child_frame_id) == ("map", "odom")
        assert [found.transform.translation.x, found.transform.translation.y] == pose[:2, 3].tolist()
        assert found.transform.rotation.w == 1.0


def asked(goal, of=None):
    link = Link()
    sink = publish_sink.PublishSink(ROBOT, link, odom_frame="odom")
    if of is not None:
        sink.show(report(of))
    link.ears[publish_sink.GOAL_TOPIC](goal)
    eventually(lambda: sum(sink.counts()["goals"].values()) == 1)
    sink.close()
    return link, sink.counts()["goals"]


def test_a_goal_gets_a_path_around_what_was_only_observed():
    link, fates = asked(goal_message(0, np.array([5.5, 1.0])), room())
    assert fates == {"answered": 1, "no_path": 0, "refused": 0, "dropped": 0}
    points = np.array([[p.pose.position.x, p.pose.position.y] for p in link.last(publish_sink.PLAN_TOPIC).poses])
    assert points[0].tolist() == list(START)
    assert points[-1].tolist() == [5.5, 1.0]
    ways = np.concatenate([np.linspace(a, b, 50) for a, b in pairwise(points)])
    assert (np.abs(ways - [4.5, 1.0]).max(axis=1) > 0.3).all()


def test_a_goal_is_planned_in_the_map_of_that_moment():
    link = Link()
    sink = publish_sink.PublishSink(ROBOT, link, odom_frame="odom")
    # The grid of the planner follows once a second: the second snapshot is not in it before it is asked for.
    for of in (snapshot(tracked(1, table())), room()):
        sink.show(report(of))
    link.ears[publish_sink.GOAL_TOPIC](goal_message(0, np.array([4.5, 1.0])))
    sink.close()
    assert sink.counts()["goals"]["no_path"] == 1
    assert link.last(publish_sink.PLAN_TOPIC).poses == []


def test_a_goal_in_the_odometry_frame_is_moved_into_the_map():
    moved = np.eye(4)
    moved[0, 3] = 0.5
    link, fates = asked(goal_message(0, np.array([1.0, 3.0]), "odom"), snapshot(world_from_submap=moved))
    assert fates["answered"] == 1
    last = link.last(publish_sink.PLAN_TOPIC).poses[-1].pose.position
    assert (last.x, last.y) == (1.5, 3.0)


@pytest.mark.parametrize(("goal", "of", "text"), [
    (b"\0\1\0\0\x05", room(), "no PoseStamped"), (goal_message(0, np.array([np.nan, 0.0])), room(), "no PoseStamped"),
    (goal_message(0, np.zeros(2), "laser"), room(), "found the frame 'laser', expected map or odom"),
    (goal_message(0, np.zeros(2)), None, "nothing was mapped yet"),
    (goal_message(0, np.array([99.0, 0.0])), room(), "goal"),
])  # fmt: skip
def test_a_bad_goal_is_refused_in_a_line(goal, of, text, caplog):
    link, fates = asked(goal, of)
    assert fates["refused"] == 1
    assert text in caplog.text
    assert publish_sink.PLAN_TOPIC not in [name for name, _ in link.sent]


def test_of_too_many_goals_the_last_are_answered():
    link = Link()
    sink = publish_sink.PublishSink(ROBOT, link, odom_frame="odom")
    sink.show(report(room()))
    with sink._lock:
        for _ in range(20):
            link.ears[publish_sink.GOAL_TOPIC](goal_message(0, np.array([5.5, 1.0])))
    eventually(lambda: sum(sink.counts()["goals"].values()) == 20)
    sink.close()
    fates = sink.counts()["goals"]
    assert fates["dropped"] >= 15
    assert fates["answered"] + fates["dropped"] == 20


def test_a_standing_link_holds_nobody_up_and_catches_up():
    link = Link()
    link.gate.clear()
    overtaken = []
    outbox = publish_sink.Outbox(link, overtaken.append, most_bytes=1000)
    for i in range(10):
        outbox.put("/map", bytes([i]) * 300)
    link.gate.set()
    outbox.close()
    fates = outbox.fates()["/map"]
    assert fates["sent"] + fates["dropped"] == 10
    assert len(overtaken) == fates["dropped"] > 0
    assert link.sent[-1][1][0] == 9


def test_after_a_dropped_window_the_next_costmap_is_whole():
    link = Link()
    sink = publish_sink.PublishSink(ROBOT, link, odom_frame="odom", parts=("costmap",))
    sink.show(report(snapshot()))
    sink._overtaken(publish_sink.UPDATES_TOPIC)
    sink.show(report(room()))
    sink.close()
    assert [name for name, _ in link.sent] == [publish_sink.MAP_TOPIC, publish_sink.MAP_TOPIC]


def test_where_nobody_is_there_messages_are_counted_as_unheard():
    link = Link(is_there=False)
    sink = publish_sink.PublishSink(ROBOT, link, odom_frame="", parts=("tf",))
    sink.show(report(snapshot()))
    sink.close()
    assert sink.counts()["topics"] == {publish_sink.TF_TOPIC: {"unheard": 1}}
    assert link.last(publish_sink.TF_TOPIC).transforms[0].child_frame_id == "odom"


def test_an_unknown_part_is_refused():
    with pytest.raises(InputError, match="found lidar to publish, expected some of costmap"):
        publish_sink.PublishSink(ROBOT, Link(), odom_frame="odom", parts=("lidar",))
