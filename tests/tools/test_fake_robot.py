import json
import os
from collections import Counter
from threading import Thread
import pytest
from players.messages.header_stamp import serialized_stamp_ns
from players.opening import open_container, open_source
from tests.player_scenes import (
    NUM_FRAMES,
    START_NS,
    Messages,
    make_scene,
    png_images,
    scene_messages,
    write_mcap,
    write_ros1,
)
from tools.robot.command import main
from tools.robot.link import Faults, plan
from tools.robot.prepared import prepared


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    m = Messages(2)
    path = tmp_path_factory.mktemp("robot") / "scene.mcap"
    return write_mcap(path, m, scene_messages(m, make_scene(), png_images))


def test_without_faults_all_is_sent_as_recorded_ros_1_as_2(log, tmp_path):
    messages = prepared([log])
    made = plan(messages, Faults())
    assert [sending.data for sending in made.sendings] == [message.data for message in messages]
    assert not made.lost
    assert messages[0].is_latched
    assert [sending.at_ns for sending in made.sendings] == sorted(message.due_ns for message in messages)
    m = Messages(1)
    messages = prepared([write_ros1(tmp_path / "scene.bag", m, scene_messages(m, make_scene(), png_images))])
    assert {message.topic.wire for message in messages} == {"cdr"}
    image = next(message for message in messages if message.topic.name.endswith("image_rect/compressed"))
    assert serialized_stamp_ns(image.topic, image.data) == START_NS


def test_loss_and_disconnection_take_what_they_say_from_a_seed(log):
    messages = prepared([log], loops=20)
    made = plan(messages, Faults(loss=0.1, disconnects=((1.0, 2.0),), seed=1))
    reasons = Counter(reason for _, reason in made.lost.elements())
    away = sum(1.0 <= message.due_ns / 1e9 < 3.0 for message in messages)
    assert reasons["offline"] == away
    assert 0.07 < reasons["loss"] / (len(messages) - away) < 0.13
    assert len(made.sendings) + made.lost.total() == len(messages)
    assert plan(messages, Faults(loss=0.1, disconnects=((1.0, 2.0),), seed=1)).lost == made.lost
    assert plan(messages, Faults(loss=0.1, disconnects=((1.0, 2.0),), seed=2)).lost != made.lost


def test_jitter_reorders_and_a_narrow_link_queues_and_drops(log):
    messages = prepared([log], loops=5)
    late = plan(messages, Faults(delay_s=0.05, jitter_s=0.2))
    numbers = [sending.sequence for sending in late.sendings if sending.due.topic.name == "/odom"]
    assert numbers != sorted(numbers)
    assert all(0.05 <= (s.at_ns - s.due.due_ns) / 1e9 <= 0.25 for s in late.sendings)
    narrow = plan(messages, Faults(bandwidth_mbit=0.1))
    assert {reason for _, reason in narrow.lost} == {"link_full"}
    carried = sum(len(sending.data) for sending in narrow.sendings)
    assert carried * 8 / 0.1e6 <= max(sending.at_ns for sending in narrow.sendings) / 1e9 + 0.01


def test_a_restart_zeroes_all_stamps_and_an_offset_moves_them(log):
    for sending in plan(prepared([log], loops=2), Faults(restart_s=0.8, clock_offset_s=-120.0)).sendings:
        stamp_ns = serialized_stamp_ns(sending.due.topic, sending.data)
        if sending.due.due_ns >= 0.8e9:
            assert 0 < stamp_ns < 10e9
        elif stamp_ns:  # the static transforms of the scene are stamped zero
            assert abs(stamp_ns - START_NS + 120e9) < 2e9


def test_stamps_go_on_when_a_log_is_played_again(log):
    once = [serialized_stamp_ns(s.due.topic, s.data) for s in plan(prepared([log]), Faults()).sendings]
    sent = [s for s in plan(prepared([log], loops=3), Faults()).sendings if s.due.topic.name == "/odom"]
    found = [serialized_stamp_ns(s.due.topic, s.data) for s in sent]
    assert found == sorted(set(found))
    assert max(found) - max(once) == sent[-1].due.later_ns > max(once) - START_NS


def test_the_command_writes_a_stream_and_says_what_it_sent(log, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("signal.signal", lambda *_: None)
    pipe, copy = tmp_path / "pipe", tmp_path / "copy.mcap"
    os.mkfifo(pipe)
    reader = Thread(target=lambda: copy.write_bytes(pipe.read_bytes()), daemon=True)
    reader.start()
    assert main([str(log), "--via", "mcap", "--listen", str(pipe), "--rate", "5"]) == 0
    reader.join(5.0)
    said = json.loads(capsys.readouterr().out)
    found = {topic.name: topic.num_messages for topic in open_container(copy).topics}
    assert said["sent"] == found
    assert len(list(open_source(copy).frames())) == NUM_FRAMES
    for wrong, told in (
        (["--via", "mcap"], "--listen PIPE"),
        (["--via", "mcap", "--listen", "x", "--loss", "2"], "expected a share of 0 to 1"),
        (["--via", "mcap", "--listen", "x", "--disconnect", "soon"], "expected AT:FOR"),
    ):
        assert main([str(log), *wrong]) == 2
        assert told in capsys.readouterr().err
