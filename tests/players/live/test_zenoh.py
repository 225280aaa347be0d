import socket
from contextlib import closing
from dataclasses import replace
from functools import partial
from threading import Thread
import numpy as np
import pytest
from hickory_stream.errors import RecordingError
from players import SourceOptions
from players.live import open_live
from players.live.inbox import Inbox
from players.live.zenoh_keys import own_token, publication_of_key, publication_of_token, within
from players.live.zenoh_route import ZenohRoute, _callback_threads
from players.opening import open_source
from tests.players.live.robot_fixtures import eventually, free_port, mapped, scene_log
from tools.robot.command import drive
from tools.robot.foxglove_publisher import FoxglovePublisher
from tools.robot.link import Faults, plan
from tools.robot.prepared import prepared
from tools.robot.zenoh_publishers import RmwZenoh, ZenohBridge

HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return scene_log(tmp_path_factory.mktemp("zenoh") / "scene.mcap")


@pytest.fixture
def address():
    return f"127.0.0.1:{free_port()}"


# The tokens and keys are those in the documents of both projects.


@pytest.mark.parametrize(("token", "expected"), [
    ("@/5a/@ros2_lv/MP/bot1§cam§image/sensor_msgs§msg§Image/:1:0:0,10",
     ("/bot1/cam/image", "sensor_msgs/msg/Image", "bridge", False)),
    ("@/5a/@ros2_lv/MP/tf_static/tf2_msgs§msg§TFMessage/:1:1:0,1",
     ("/tf_static", "tf2_msgs/msg/TFMessage", "bridge", True)),
    ("@ros2_lv/5a/MP/chatter/std_msgs§msg§String/:::", ("/chatter", "std_msgs/msg/String", "bridge", False)),
    (f"@ros2_lv/2/8b20917502ee955a/0/10/MP/%/%/talker/%chatter/std_msgs::msg::dds_::String_/{HASH}/::,7:,:,:,,",
     ("/chatter", "std_msgs/msg/String", "rmw", False)),
    ("@ros2_lv/0/8b/0/3/MP/%/%/tf/%bot%tf_static/tf2_msgs::msg::dds_::TFMessage_/TypeHashNotSupported/:1:,1:,:,:,,",
     ("/bot/tf_static", "tf2_msgs/msg/TFMessage", "rmw", True)),
    *((token, None) for token in (
        "@/5a/@ros2_lv/MS/tf/tf2_msgs§msg§TFMessage/:::",
        "@ros2_lv/2/8b/0/0/NN/%/%/talker",
        f"@ros2_lv/2/8b/0/11/MS/%/%/listener/%chatter/std_msgs::msg::dds_::String_/{HASH}/::,10:,:,:,,",
        "@/5a/router/config",
        "@",
    )),
])  # fmt: skip
def test_tokens_say_name_type_and_durability_of_publishers(token, expected):
    found = publication_of_token(token)
    assert (found and (found.name, found.type_name, found.layout, found.is_latched)) == expected


def test_keys_of_rmw_zenoh_tell_their_type_and_others_do_not():
    found = publication_of_key(f"0/cam/image/sensor_msgs::msg::dds_::Image_/{HASH}")
    assert (found.name, found.type_name, found.key) == ("/cam/image", "sensor_msgs/msg/Image", "*/cam/image/*/*")
    assert publication_of_key("cam/image") is None
    assert within(found, "cam") == "/image"
    assert within(found, "ca") is None
    token = own_token(found, "5a", 3, "MS")
    image = f"%cam%image/sensor_msgs::msg::dds_::Image_/{HASH}"
    assert token == f"@ros2_lv/0/5a/0/3/MS/%/%/hickory_stream/{image}/::,10:,:,:,,"
    assert publication_of_token(token) is None


ROBOTS = {
    "bridge": ("zenoh", ZenohBridge), "old bridge": ("zenoh", partial(ZenohBridge, is_old=True)),
    "rmw": ("zenoh", partial(RmwZenoh, domain=7)),
    "sdk": ("foxglove", partial(FoxglovePublisher, protocols=("foxglove.sdk.v1", "foxglove.websocket.v1"))),
    "old sdk": ("foxglove", partial(FoxglovePublisher, protocols=("foxglove.websocket.v1",))),
}  # fmt: skip


@pytest.mark.parametrize("kind", ROBOTS)
def test_a_robot_is_mapped_with_what_it_sent_before_we_came(kind, log, address):
    scheme, publisher = ROBOTS[kind]
    rate = 2.0 if scheme == "foxglove" else 1.0
    found = mapped(log, publisher(address), f"{scheme}://{address}", rate=rate)
    expected = list(open_source(log).frames())
    assert [frame.stamp_ns for frame in found.frames] == [frame.stamp_ns for frame in expected]
    assert np.allclose(found.frames[-1].world_from_camera, expected[-1].world_from_camera)
    assert found.unaccounted() == {}
    assert sum(found.report.sent.values()) == sum(topic.num_messages or 0 for topic in open_source(log)._log.topics)
    # A thread of Zenoh's that is left aborts the process when it ends.
    assert _callback_threads() == []


def test_losses_are_counted_by_sequence_numbers(tmp_path, address):
    log = scene_log(tmp_path / "scene.mcap", num_frames=20)
    found = mapped(log, RmwZenoh(address), f"zenoh://{address}", Faults(loss=0.2, seed=3), rate=2.0)
    assert sum(found.plan.lost.values()) > 20
    assert found.unaccounted() == {}
    expected = {}
    for name in found.report.sent:
        numbers = [s.sequence for s in found.plan.sendings if s.due.topic.name == name]
        # Those before the first and after the last nobody can miss.
        expected[name] = max(numbers) - min(numbers) + 1 - len(numbers)
    assert {entry.topic: entry.lost for entry in found.source.status().topics} == expected
    assert 8 <= len(found.frames) < 20


@pytest.mark.parametrize(("kind", "away_s"), [("bridge", 0.7), ("sdk", 0.4)])
def test_a_robot_that_was_away_is_mapped_on(tmp_path, address, kind, away_s):
    log, (scheme, publisher) = scene_log(tmp_path / "scene.mcap", num_frames=35), ROBOTS[kind]
    found = mapped(log, publisher(address), f"{scheme}://{address}", Faults(disconnects=((0.8, away_s),)))
    gaps_ns = np.diff([frame.stamp_ns for frame in found.frames])
    assert gaps_ns.max() >= away_s * 1e9
    assert len(found.frames) - 1 - int(gaps_ns.argmax()) > 3
    assert found.source.account().as_dict()["difference"] == 0


def test_of_two_robots_the_named_namespace_is_mapped(log, address):
    publisher = ZenohBridge(address, namespace="b2")
    found = mapped(log, publisher, f"zenoh://{address}/b2")
    assert len(found.frames) == 6
    assert {entry.topic for entry in found.source.status().topics} == set(found.report.sent)
    route = ZenohRoute(f"zenoh://{address}/other")
    robot = Thread(target=drive, args=(plan(prepared([log]), Faults()), publisher, Faults()), daemon=True)
    robot.start()
    inbox = Inbox()
    route.start(inbox)
    assert eventually(lambda: "in the namespace other" in route.health().problem)
    assert inbox.topics == ()
    route.stop()
    robot.join(10.0)


def test_another_type_under_the_same_topic_is_refused_and_named(log, address):
    made = plan(prepared([log]), Faults())
    odd = replace(made.sendings[0].due.topic, name="/odom", type_name="geometry_msgs/msg/PoseStamped")
    publisher = RmwZenoh(address)
    publisher.connect([*{sending.due.topic.name: sending.due.topic for sending in made.sendings}.values()])
    token = publisher.session.liveliness().declare_token(publisher.token(odd, 99, is_latched=False))
    route, inbox = ZenohRoute(f"zenoh://{address}"), Inbox()
    route.start(inbox)
    assert eventually(lambda: "/odom is published as" in route.health().problem)
    route.subscribe(["/odom"])
    assert eventually(lambda: publisher.is_heard("/odom"))
    typed = next(topic for topic in inbox.topics if topic.name == "/odom").type_name
    other = odd if typed != odd.type_name else replace(odd, type_name="nav_msgs/msg/Odometry")
    publisher.session.put(publisher.key(other), b"no odometry")
    assert eventually(lambda: "/odom" in inbox.arrivals)
    assert inbox.arrivals["/odom"].fates == {"other_type": 1}
    assert inbox.take(0) is None
    token.undeclare()
    route.stop()
    publisher.disconnect()


def test_without_tokens_types_come_from_the_keys_of_messages(log, address, monkeypatch):
    monkeypatch.setattr("players.live.zenoh_route._TOKENLESS_S", 0.1)
    monkeypatch.setattr(RmwZenoh, "token", lambda self, topic, number, is_latched: f"@elsewhere/{number}")
    publisher = RmwZenoh(address)
    made = plan(prepared([log]), Faults())
    robot = Thread(target=drive, args=(made, publisher, Faults()), kwargs={"waits": True}, daemon=True)
    robot.start()
    route, inbox = ZenohRoute(f"zenoh://{address}"), Inbox()
    route.start(inbox)
    sent = {sending.due.topic.name for sending in made.sendings if not sending.due.is_latched}
    assert eventually(lambda: {topic.name for topic in inbox.topics} >= sent)
    assert {topic.type_name for topic in inbox.topics} >= {"nav_msgs/msg/Odometry", "sensor_msgs/msg/CameraInfo"}
    route.stop()
    robot.join(10.0)


def test_a_silent_host_and_a_foreign_port_are_reported(address, monkeypatch):
    with pytest.raises(RecordingError, match=f"{address} does not answer as a Zenoh router.*waited 0.7 s"):
        open_live(f"zenoh://{address}", patience_s=0.7)
    monkeypatch.setattr("players.live.zenoh_route._OPEN_MS", 300)
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        port = server.getsockname()[1]
        with pytest.raises(RecordingError, match=f"127.0.0.1:{port} (does not answer as a Zenoh|was not reached)"):
            open_live(f"zenoh://127.0.0.1:{port}", patience_s=0.7)


def test_without_a_host_this_machine_is_asked():
    assert ZenohRoute("zenoh://")._peer == "127.0.0.1:7447"
    assert ZenohRoute("zenoh://b2.local/b2")._peer == "b2.local:7447"


@pytest.mark.parametrize("options", [SourceOptions(odometry="depth"), SourceOptions(extrinsics="estimate")])
def test_odometry_of_a_live_route_is_refused_with_what_to_do(options):
    with pytest.raises(RecordingError, match=r"for zenoh://127\.0\.0\.1.*record the robot \(--record\) and play that"):
        open_live("zenoh://127.0.0.1", options)
