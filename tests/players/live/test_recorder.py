import shutil
from collections import Counter
import numpy as np
import pytest
from hickory_stream.errors import OutputError
from players.doctor.diagnosis import examine
from players.live import open_live
from players.live.inbox import Inbox
from players.live.recorder import Recorder
from players.logs.containers import LogMessage
from players.opening import open_container, open_source
from players.options import SourceOptions
from tests.players.live.live_fixtures import ScriptedRoute, scene_packets


def heard(path):
    log = open_container(path)
    return list(log.messages([topic.name for topic in log.topics]))


def test_the_recording_plays_to_the_frames_of_the_session(tmp_path):
    path = tmp_path / "session.mcap"
    route = ScriptedRoute(at_start=scene_packets())
    source = open_live(route.uri, route=route, attempt_s=0.3, recorder=Recorder(path, route.uri))
    route.end()
    live = list(source.frames())
    source.close()
    messages = heard(path)
    assert [bytes(message.data) for message in messages] == [packet.data for packet in scene_packets()]
    assert Counter(message.topic for message in messages) == route.sent
    arrivals = [message.log_ns for message in messages]
    assert arrivals == sorted(arrivals)
    played = list(open_source(path).frames())
    assert [frame.stamp_ns for frame in played] == [frame.stamp_ns for frame in live]
    assert np.array_equal(played[-1].world_from_camera, live[-1].world_from_camera)
    assert examine([path], SourceOptions()).damage == []


def test_a_session_that_was_killed_is_read_to_its_last_message(tmp_path):
    path = tmp_path / "session.mcap"
    recorder = Recorder(path, "script://robot")
    inbox = Inbox(tap=recorder.take)
    for packet in scene_packets():
        inbox.announce(packet.topic)
        inbox.put(packet.topic.name, packet.data)
    recorder._is_over = True  # its thread writes what waits, and ends; the file is not finished
    with recorder._changed:
        recorder._changed.notify_all()
    recorder._thread.join(5.0)
    copy = shutil.copy(path, tmp_path / "killed.mcap")
    assert [bytes(message.data) for message in heard(copy)] == [packet.data for packet in scene_packets()]
    with copy.open("r+b") as stream:
        stream.truncate(copy.stat().st_size - 7)
    assert len(heard(copy)) == len(scene_packets()) - 1
    assert len(list(open_source(copy).frames())) >= 5
    recorder.close()


def test_a_recording_keeps_to_its_budget_and_says_what_it_lacks(tmp_path):
    path = tmp_path / "session.mcap"
    recorder = Recorder(path, "script://robot", limit_bytes=20_000)
    packets = scene_packets()
    for packet in packets:
        recorder.take(packet.topic, _message(packet))
    recorder.close()
    assert path.stat().st_size < 30_000  # what the footer repeats comes on top
    assert 0 < recorder.num_written < len(packets)
    assert recorder.num_written + recorder.num_not_written == len(packets)
    assert len(heard(path)) == recorder.num_written
    assert f"lacks {recorder.num_not_written} messages: it has reached its limit of 2e-05 GB" in recorder.lost


def test_a_full_or_slow_disk_affects_the_recording_only(tmp_path):
    packets = scene_packets()
    full = Recorder(tmp_path / "full.mcap", "script://robot", reserve_bytes=1 << 60)
    slow = Recorder(tmp_path / "slow.mcap", "script://robot", waiting_bytes=0)
    for recorder in (full, slow):
        for packet in packets:
            recorder.take(packet.topic, _message(packet))
        recorder.close()
        assert recorder.num_not_written == len(packets)
    assert "of the disk are free" in full.lost
    assert "the disk was too slow" in slow.lost
    with pytest.raises(OutputError, match="cannot write the recording"):
        Recorder(tmp_path / "none" / "x.mcap", "script://robot")


def _message(packet):
    return LogMessage(packet.topic.name, packet.stamp_ns, packet.data)
