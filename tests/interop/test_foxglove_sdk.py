"""The Foxglove SDK's own server is mapped, and told what the map knows."""

import subprocess
import sys
from threading import Thread
import numpy as np
import pytest
from hickory_stream.navigation.robot import load_robot
from hickory_stream.sinks.publish_sink import PublishSink
from players.live import open_live
from tests.navigation.rooms import snapshot
from tests.player_scenes import make_scene
from tests.players.live.robot_fixtures import eventually, free_port, scene_log
from tests.sinks.test_publish_sink import report

pytestmark = pytest.mark.interop


def test_a_robot_behind_the_sdks_server_is_mapped_and_told(tmp_path):
    pytest.importorskip("foxglove")
    log, port = scene_log(tmp_path / "log.mcap", num_frames=30), free_port()
    robot = [sys.executable, "tests/interop/foxglove_robot.py", str(log), str(port), "8"]
    with subprocess.Popen(robot, stdout=subprocess.PIPE, text=True) as process:
        try:
            source = open_live(f"foxglove://127.0.0.1:{port}", attempt_s=0.5, patience_s=15.0)
            frames = []
            reading = Thread(target=lambda: frames.extend(source.frames()), daemon=True)
            reading.start()
            assert source.return_link is not None
            sink = PublishSink(load_robot("point"), source.return_link, odom_frame=source.odom_frame)
            sink.show(report(snapshot()))
            assert eventually(lambda: len(frames) >= 15, 10.0), source.status()
            said, _ = process.communicate(timeout=20)
        finally:
            source.interrupt()
            process.kill()
    reading.join(5.0)
    sink.close()
    account = source.account()
    source.close()
    assert account.as_dict()["difference"] == 0
    scene = {item.stamp_ns: item for item in make_scene(num_frames=30)}
    for raw in frames:
        assert np.array_equal(raw.decode().rgb, scene[raw.stamp_ns].rgb)
    assert {"/map", "/tf", "/hickory_stream/objects", "/hickory_stream/markers"} <= set(said.split())
