from contextlib import contextmanager
from threading import Event, Thread
import numpy as np
import pytest
from hickory_stream.navigation.robot import load_robot
from hickory_stream.sinks.publish_sink import MAP_TOPIC, MARKERS_TOPIC, OBJECTS_TOPIC, PLAN_TOPIC, TF_TOPIC, PublishSink
from hickory_stream.sinks.ros_messages import PATH, TRANSFORMS, goal_message, store
from players.live import open_live
from players.live.zenoh_keys import publication_of_key, publication_of_token
from players.logs.containers import Topic
from tests.navigation.rooms import snapshot
from tests.players.live.robot_fixtures import eventually, free_port, scene_log
from tests.sinks.test_publish_sink import report
from tools.robot.command import drive
from tools.robot.foxglove_publisher import FoxglovePublisher
from tools.robot.link import Faults, plan
from tools.robot.prepared import prepared
from tools.robot.zenoh_publishers import RmwZenoh, ZenohBridge

LATCHED = (MAP_TOPIC, MARKERS_TOPIC)
WHOLE = (MAP_TOPIC, OBJECTS_TOPIC, MARKERS_TOPIC, TF_TOPIC)
ROUTES = ("zenoh-bridge", "rmw-zenoh", "foxglove")


def publisher_of(route, place):
    if route == "foxglove":
        return f"foxglove://{place}", FoxglovePublisher(place)
    namespaced = f"zenoh://{place}/spot"
    if route == "zenoh-bridge":
        return namespaced, ZenohBridge(place, namespace="/spot")
    return namespaced, RmwZenoh(place, domain=7, namespace="/spot")


@contextmanager
def listening(uri, robot, log):
    """A source of a robot that plays a log, once it has all that it needs; and what sends the robot away."""
    made, stopped = plan(prepared([log], loops=40), Faults()), Event()
    playing = Thread(target=lambda: drive(made, robot, Faults(), waits=True, stopped=stopped), daemon=True)

    def away():
        stopped.set()
        playing.join(10.0)

    playing.start()
    source = open_live(uri, attempt_s=0.3, patience_s=20.0)
    try:
        yield source, away
    finally:
        source.close()
        away()


@contextmanager
def shown(source, **options):
    """A sink of a robot that was shown a map."""
    sink = PublishSink(load_robot("point"), source.return_link, odom_frame=source.odom_frame, **options)
    sink.show(report(snapshot()))
    yield sink
    sink.close()


@pytest.mark.parametrize("route", ROUTES)
def test_all_that_is_published_arrives_and_a_goal_is_answered(route, tmp_path):
    uri, robot = publisher_of(route, f"127.0.0.1:{free_port()}")
    with listening(uri, robot, scene_log(tmp_path / "log.mcap")) as (source, _), shown(source) as sink:
        assert eventually(lambda: all(robot.heard.counts[name] for name in WHOLE)), robot.heard.counts
        robot.ask(goal_message(0, np.array([5.5, 3.0])))
        assert eventually(lambda: bool(robot.heard.round_trips_s)), sink.counts()
    path = store().deserialize_cdr(robot.heard.last[PLAN_TOPIC], PATH)
    assert (path.poses[-1].pose.position.x, path.poses[-1].pose.position.y) == (5.5, 3.0)
    transform = store().deserialize_cdr(robot.heard.last[TF_TOPIC], TRANSFORMS).transforms[0]
    assert transform.child_frame_id == source.odom_frame != ""
    counts = sink.counts()
    assert counts["goals"] == {"answered": 1, "no_path": 0, "refused": 0, "dropped": 0}
    # A router of rmw_zenoh may deliver the first message before it announces who listens.
    may_be = ({"sent": 1}, {"unheard": 1}) if route == "rmw-zenoh" else ({"sent": 1},)
    assert all(fates in may_be for fates in counts["topics"].values()), counts["topics"]


@pytest.mark.parametrize("route", ROUTES)
def test_a_returned_robot_gets_what_is_latched(route, tmp_path):
    place = f"127.0.0.1:{free_port()}"
    uri, robot = publisher_of(route, place)
    log = scene_log(tmp_path / "log.mcap")
    with listening(uri, robot, log) as (source, away), shown(source):
        assert eventually(lambda: all(robot.heard.counts[name] for name in WHOLE))
        away()
        _, returned = publisher_of(route, place)
        returned.connect({due.topic.name: due.topic for due in prepared([log])}.values())
        assert eventually(lambda: all(returned.heard.counts[name] for name in LATCHED)), returned.heard.counts
    returned.disconnect()


def test_a_server_that_takes_nothing_is_named(tmp_path):
    place = f"127.0.0.1:{free_port()}"
    robot = FoxglovePublisher(place, takes=False)
    with listening(f"foxglove://{place}", robot, scene_log(tmp_path / "log.mcap")) as (source, _):
        with shown(source, parts=("tf",)) as sink:
            pass
        assert "takes no messages of ROS 2" in source.status().problem
    assert sink.counts()["topics"] == {TF_TOPIC: {"unheard": 1}}


def test_our_topics_are_publishers_to_nodes_of_rmw_zenoh(tmp_path):
    import zenoh

    place = f"127.0.0.1:{free_port()}"
    robot = RmwZenoh(place, domain=7)
    with listening(f"zenoh://{place}", robot, scene_log(tmp_path / "log.mcap")) as (source, _):
        sink = PublishSink(load_robot("point"), source.return_link, odom_frame="odom", parts=("costmap",))
        tokens = []

        def note(sample):
            if sample.kind == zenoh.SampleKind.PUT:
                tokens.append(str(sample.key_expr))

        watching = robot.session.liveliness().declare_subscriber("@ros2_lv/**", note, history=True)
        assert eventually(lambda: any("hickory_stream/%map/" in token for token in tokens)), tokens
        watching.undeclare()
        sink.close()
        status = source.status()
    (ours,) = {token for token in tokens if "hickory_stream/%map/" in token}
    found = publication_of_token(ours)
    expected = ("/map", "nav_msgs/msg/OccupancyGrid", "7", True)
    assert (found.name, found.type_name, found.domain, found.is_latched) == expected
    assert publication_of_key(f"7/map/nav_msgs::msg::dds_::OccupancyGrid_/{found.hash}") is not None
    assert MAP_TOPIC not in [entry.topic for entry in status.topics]


@pytest.mark.parametrize("route", ["zenoh-bridge", "rmw-zenoh"])
def test_a_robot_does_not_hear_us_on_its_own_topic(route):
    _, robot = publisher_of(route, f"127.0.0.1:{free_port()}")
    tf = Topic(name="/tf", type_name=TRANSFORMS, num_messages=None, wire="cdr", definition_format="none", definition="")
    robot.connect([tf])
    assert not eventually(lambda: robot.is_heard("/tf"), 0.5)
    robot.disconnect()
