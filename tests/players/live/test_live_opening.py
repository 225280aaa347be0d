import time
from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.errors import CalibrationError, RecordingError
from players import SourceOptions
from players.live import open_live
from players.live.inbox import Inbox
from players.live.transport import Health
from players.opening import open_source
from players.poses.camera_poses import PoseReader
from tests.player_scenes import OPTICAL, Messages, make_scene, png_bytes, png_images, scene_messages, write_mcap
from tests.players.live.live_fixtures import ScriptedRoute, scene_packets
from tools.robot.prepared import restamped

INFOS = "camera_info"


def opened(route, *, inbox=None, patience_s=5.0, **options):
    return open_live(route.uri, route=route, inbox=inbox, patience_s=patience_s, attempt_s=0.3, **options)


def ended(packets):
    """Return a route that sent packets and ended, and the source that was opened before its end."""
    route = ScriptedRoute(at_start=packets)
    source = opened(route)
    route.end()
    return route, source


def unaccounted(source, route):
    """Return, by topic, how many of the messages that a route sent are in no bucket of the ledger."""
    entries = {entry.topic: entry for entry in source.account().topics}
    return {name: number - entries[name].total for name, number in route.sent.items() if number != entries[name].total}


def test_what_arrives_gives_the_frames_that_the_same_log_gives(tmp_path):
    m = Messages(2)
    path = write_mcap(tmp_path / "scene.mcap", m, scene_messages(m, make_scene(), png_images))
    route, source = ended(scene_packets())
    live, logged = list(source.frames()), list(open_source(path).frames())
    assert [frame.stamp_ns for frame in live] == [frame.stamp_ns for frame in logged]
    for a, b in zip(live, logged, strict=True):
        assert np.array_equal(a.world_from_camera, b.world_from_camera)
        assert np.array_equal(a.decode().depth_m, b.decode().depth_m, equal_nan=True)
    assert unaccounted(source, route) == {}
    assert source.account().as_dict()["difference"] == 0
    assert source.info.uri == route.uri


def test_only_what_mapping_needs_is_asked_for():
    beside = replace(scene_packets()[0].topic, name="/other/image", type_name="sensor_msgs/msg/Imu")
    route = ScriptedRoute(at_start=scene_packets(), announced=[beside])
    source = opened(route)
    assert "/other/image" not in route.asked
    assert {"/odom", "/tf_static", "/cam/color/image_rect/compressed"} <= route.asked
    source.close()


def test_images_tell_the_roles_that_names_do_not():
    names = {
        "/cam/color/image_rect/compressed": "/eye/left/compressed",
        "/cam/aligned_depth/image_rect/compressedDepth": "/eye/range",
    }

    class OnDemand(ScriptedRoute):
        def subscribe(self, names):
            self.send(p for p in packets if p.topic.name in set(names) - self.asked)
            super().subscribe(names)

    packets = [replace(p, topic=replace(p.topic, name=names.get(p.topic.name, p.topic.name))) for p in scene_packets()]
    infrared = replace(packets[0].topic, name="/eye/infra1/image", type_name="sensor_msgs/msg/Image")
    route = OnDemand(announced=[*{p.topic.name: p.topic for p in packets}.values(), infrared])
    infos = ("/cam/color/camera_info", "/cam/aligned_depth/camera_info")
    source = opened(route, options=SourceOptions(color_info_topic=infos[0], depth_info_topic=infos[1]))
    assert (dict(source.info.streams)["color"], dict(source.info.streams)["depth"]) == tuple(names.values())
    assert infrared.name not in route.asked
    source.close()


def test_calibration_that_comes_late_is_waited_for_by_name():
    late = [packet for packet in scene_packets() if INFOS in packet.topic.name]
    route = ScriptedRoute(at_start=[packet for packet in scene_packets() if INFOS not in packet.topic.name])
    told = []

    def tell(text):
        told.append(text)
        route.send(late)

    source = opened(route, report=tell, patience_s=20.0)
    route.end()
    assert "no intrinsics for /cam/color/image_rect/compressed" in told[0]
    # The images that came before it were kept: all frames are there.
    assert len(list(source.frames())) == 6
    assert unaccounted(source, route) == {}


def test_topics_are_reported_as_they_appear():
    packets = scene_packets()
    parts = [[p for p in packets if word in p.topic.name] for word in ("tf_static", "odom", "color", "depth")]
    route = ScriptedRoute()
    told = []

    def tell(text):
        told.append(text)
        if parts:
            route.send(parts.pop(0))

    source = opened(route, report=tell, patience_s=30.0)
    route.end()
    assert "announced no topics" in told[0]
    assert [any(word in text for text in told) for word in ("no images", "no depth topic")] == [True, True]
    assert len(list(source.frames())) == 6


def test_a_route_without_images_or_a_link_says_what_is_missing():
    route = ScriptedRoute(announced=[packet.topic for packet in scene_packets()])
    with pytest.raises(RecordingError, match=r"image_rect.* holds no image.*waited 0\.2 s for script://robot"):
        opened(route, patience_s=0.2)
    assert route.state.problem == "stopped"
    down = ScriptedRoute(state=Health(is_connected=False, problem="robot:7447 does not answer"))
    with pytest.raises(RecordingError, match="robot:7447 does not answer; waited"):
        opened(down, patience_s=0.2)
    route = ScriptedRoute(at_start=[packet for packet in scene_packets() if "tf_static" not in packet.topic.name])
    with pytest.raises(CalibrationError, match=r"base_link.*cam_optical"):
        opened(route, patience_s=0.3)


def test_a_robot_restarted_at_clock_zero_is_still_mapped():
    packets = scene_packets()
    first_ns = packets[0].stamp_ns
    again = [replace(packet, data=restamped(packet.topic, packet.data, 5_000_000_000 - first_ns)) for packet in packets]
    route, source = ended(packets + again)
    stamps = [frame.stamp_ns for frame in source.frames()]
    assert [sum(ns > first_ns for ns in stamps), sum(ns < 10_000_000_000 for ns in stamps)] == [6, 6]
    assert source.ledger()["clock_steps"] == 1
    assert unaccounted(source, route) == {}


@pytest.mark.parametrize("back_s", [0.3, 0.8])
def test_a_clock_that_is_set_back_a_little_is_found(back_s):
    packets, now_ns = scene_packets(40), [0]
    middle_ns, back_ns = packets[len(packets) // 2].stamp_ns, round(back_s * 1e9)

    class Timely(ScriptedRoute):
        def send(self, packets):
            for packet in packets:
                now_ns[0] = packet.stamp_ns - time.monotonic_ns()
                is_after = packet.stamp_ns >= middle_ns and "static" not in packet.topic.name
                data = restamped(packet.topic, packet.data, -back_ns) if is_after else packet.data
                super().send([replace(packet, data=data)])

    route = Timely(at_start=packets)
    source = opened(route, inbox=Inbox(clock=lambda: now_ns[0] + time.monotonic_ns()))
    route.end()
    frames = list(source.frames())
    truth = {frame.stamp_ns: frame.world_from_camera for frame in make_scene(num_frames=40)}
    places = [
        truth[frame.stamp_ns + back_ns * (i >= sum(ns < middle_ns for ns in truth))] for i, frame in enumerate(frames)
    ]
    assert len(frames) == 40
    for frame, place in zip(frames, places, strict=True):
        np.testing.assert_allclose(frame.world_from_camera, place, atol=2e-3)
    assert source.ledger()["clock_steps"] == 1
    assert f"the robot's clock was set back by {back_s:.2f} s" in source.account().findings[0]


def test_doubled_and_reordered_messages_are_counted():
    packets = scene_packets(12)
    swapped = [packets[i ^ 1] if (i ^ 1) < len(packets) else packets[i] for i in range(len(packets))]
    route, source = ended([packet for i, packet in enumerate(swapped) for _ in range(1 + (i % 5 == 0))])
    stamps = [frame.stamp_ns for frame in source.frames()]
    assert stamps == sorted(set(stamps))
    assert len(stamps) == 12
    assert source.ledger()["duplicate_color"] >= 1
    assert unaccounted(source, route) == {}


def test_frames_end_with_the_run_and_the_rest_is_counted():
    route = ScriptedRoute(at_start=scene_packets(12))
    source = opened(route)
    frames = source.frames()
    next(frames)
    source.interrupt()
    assert len(list(frames)) < 11
    account = source.account().as_dict()
    assert account["not_played"] > 0
    assert account["difference"] == 0
    assert unaccounted(source, route) == {}


def test_a_frame_is_there_as_soon_as_its_images_and_its_pose_are():
    # Images of one stamp, with poses on both sides of it: nothing else is waited for.
    frames, early_ns = make_scene(), -9_000_000
    packets = [
        replace(p, stamp_ns=p.stamp_ns + early_ns, data=restamped(p.topic, p.data, early_ns))
        if p.topic.name.endswith("compressedDepth") else p for p in scene_packets()
    ]  # fmt: skip
    ordered = sorted(packets, key=lambda packet: packet.stamp_ns)
    second_ns, pose_ns = frames[1].stamp_ns, frames[1].stamp_ns + 20_000_000
    source = opened(ScriptedRoute(at_start=[packet for packet in ordered if packet.stamp_ns <= pose_ns]))
    reading = source.frames()
    assert [next(reading).stamp_ns, next(reading).stamp_ns] == [frames[0].stamp_ns, second_ns]
    source.close()


def test_poses_without_images_do_not_fill_the_memory(monkeypatch):
    monkeypatch.setattr("players.logs.log_source._FORGET_EVERY", 50)
    odometry = next(packet for packet in scene_packets() if packet.topic.name == "/odom")
    route = ScriptedRoute(at_start=scene_packets())
    frames = opened(route).frames()
    next(frames)
    readers, forget, data = [], PoseReader.forget_older, odometry.data
    monkeypatch.setattr(PoseReader, "forget_older", lambda self, kept: (readers.append(self), forget(self, kept))[1])
    route.send(replace(odometry, data=restamped(odometry.topic, data, i * 20_000_000)) for i in range(100, 10_000))
    route.end()
    list(frames)
    track = next(track for key, track in readers[-1].tracks() if key[0] == "/odom")
    assert len(track._stamps_ns) < 60 * 50 + 2200


def test_images_that_change_size_in_mid_stream_are_counted():
    packets = scene_packets(12)
    m, store = Messages(2), Messages(2).store
    color = next(packet.topic for packet in packets if packet.topic.name.endswith("image_rect/compressed"))
    changed = []
    for packet in packets:
        if packet.topic == color and packet.stamp_ns > packets[-1].stamp_ns - 400_000_000:
            message = store.deserialize_cdr(packet.data, color.type_name)
            stamp_ns = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
            other = m.compressed(stamp_ns, OPTICAL, "png", png_bytes(np.zeros((30, 40, 3), dtype=np.uint8)))
            packet = replace(packet, data=bytes(store.serialize_cdr(other, color.type_name)))
        changed.append(packet)
    route, source = ended(changed)
    frames = list(source.frames())
    fates = source.ledger()
    assert fates["frame_of_other_size"] + len(frames) == 12
    assert 2 <= fates["frame_of_other_size"] <= 5
    assert unaccounted(source, route) == {}


def test_the_camera_decides_between_robots_with_equal_frames():
    def of(robot, shift_m):
        store, moved = Messages(2).store, []
        for packet in scene_packets(12):
            data = packet.data
            if packet.topic.name == "/odom":
                message = store.deserialize_cdr(data, packet.topic.type_name)
                message.pose.pose.position.x += shift_m
                data = bytes(store.serialize_cdr(message, packet.topic.type_name))
            moved.append(replace(packet, topic=replace(packet.topic, name=f"{robot}{packet.topic.name}"), data=data))
        return moved

    ours = of("/b2", 0.0)
    # The other one has no camera that could be taken for ours; the frames of both are odom, base_link and so on.
    theirs = [p for p in of("/b3", 50.0) if "/cam/" not in p.topic.name and "tf_static" not in p.topic.name]
    tf = next(packet for packet in ours if packet.topic.name.endswith("tf_static"))
    theirs.append(replace(tf, topic=replace(tf.topic, name="/b3/tf_static")))
    for packets in (sorted([*ours, *theirs], key=lambda packet: packet.stamp_ns), [*theirs, *ours]):
        route, source = ended(packets)
        frames = list(source.frames())
        assert len(frames) == 12
        assert all(abs(frame.world_from_camera[0, 3]) < 5.0 for frame in frames)
        assert "/b3/odom" not in route.asked
        assert unaccounted(source, route) == {}
