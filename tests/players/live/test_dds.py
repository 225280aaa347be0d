import json
import os
import subprocess
import sys
from importlib.util import find_spec
from threading import Thread
import numpy as np
import pytest
from hickory_stream.errors import RecordingError
from hickory_stream.navigation.robot import load_robot
from hickory_stream.sinks.publish_sink import PublishSink
from players.live import open_live
from players.live.dds_domain import dds_type, ros_type, settings
from players.live.routes import route_of
from tests.navigation.rooms import snapshot
from tests.player_scenes import make_scene
from tests.players.live.robot_fixtures import eventually, scene_log
from tests.sinks.test_publish_sink import report

cyclone = pytest.mark.skipif(find_spec("cyclonedds") is None, reason="needs the extra [dds]")
DOMAIN = 20 + os.getpid() % 150


def test_types_have_wire_names_and_only_named_peers_are_heard():
    assert dds_type("sensor_msgs/msg/Image") == "sensor_msgs::msg::dds_::Image_"
    assert ros_type("sensor_msgs::msg::dds_::Image_") == "sensor_msgs/msg/Image"
    for other in ("std_srvs::srv::dds_::Empty_Request_", "ParticipantEntitiesInfo_", "a::msg::dds_::B"):
        assert ros_type(other) is None
    made = settings("eth0", ("192.168.123.161",))
    assert '<NetworkInterface name="eth0" multicast="false"/>' in made
    assert "<AllowMulticast>false</AllowMulticast>" in made
    assert '<Peers><Peer address="192.168.123.161"/></Peers>' in made
    assert 'address="10.0.0.2" multicast="false"' in settings("10.0.0.2", ("10.0.0.3",))


def test_without_cyclone_it_is_said_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "cyclonedds.core", None)
    with pytest.raises(RecordingError, match=r"dds:// needs Cyclone DDS: pip install 'hickory-stream\[dds\]'"):
        route_of("dds://")


@cyclone
def test_an_interface_that_is_not_there_is_named():
    with pytest.raises(RecordingError, match="Cyclone DDS cannot use the interface none0"):
        open_live(f"dds://{DOMAIN + 2}?interface=none0&peer=10.255.255.1", attempt_s=0.1, patience_s=0.5)


@cyclone
def test_a_robot_in_another_process_is_mapped_told_and_counted(tmp_path):
    log = scene_log(tmp_path / "log.mcap", num_frames=20)
    goal = ("--goal", "1:5.5,3.0")
    robot = [sys.executable, "-m", "tools.robot.command", str(log), "--via", "dds", "--domain", str(DOMAIN)]
    with subprocess.Popen([*robot, "--wait", *goal], stdout=subprocess.PIPE, text=True) as process:
        try:
            source = open_live(f"dds://{DOMAIN}", attempt_s=0.3, patience_s=20.0)
            sink = PublishSink(load_robot("point"), source.return_link, odom_frame=source.odom_frame)
            sink.show(report(snapshot()))
            frames = []
            reading = Thread(target=lambda: frames.extend(source.frames()), daemon=True)
            reading.start()
            said, _ = process.communicate(timeout=15)
        finally:
            process.kill()
    sent = json.loads(said)
    eventually(lambda: sum(entry.total for entry in source.account().topics) >= sum(sent["sent"].values()), 3.0)
    source.interrupt()
    reading.join(5.0)
    sink.close()
    account = source.account()
    source.close()
    totals = {entry.topic: entry.total for entry in account.topics}
    assert {name: totals[name] for name in sent["sent"]} == sent["sent"]
    assert account.as_dict()["difference"] == 0
    scene = {item.stamp_ns: item for item in make_scene(num_frames=20)}
    assert len(frames) >= 15
    for frame in frames:
        assert np.array_equal(frame.decode().rgb, scene[frame.stamp_ns].rgb)
    assert sink.counts()["goals"]["answered"] == 1
    assert set(sent["heard"]) >= {"/map", "/tf", "/plan", "/hickory_stream/objects", "/hickory_stream/markers"}
    assert len(sent["round_trips_s"]) == 1
    assert source.status().kind.endswith("interface 127.0.0.1, peers 127.0.0.1")
