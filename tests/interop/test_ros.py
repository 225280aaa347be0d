"""Real ROS 2 (rclpy on Fast DDS) is mapped over DDS: what its nodes publish arrives as it was."""

import os
import subprocess
from threading import Thread
import numpy as np
import pytest
from hickory_stream.geometry.rigid import quaternion_from_rotation
from players.live import open_live
from tests.interop.scene_file import scene_file
from tests.player_scenes import make_scene
from tests.players.live.robot_fixtures import eventually

pytestmark = pytest.mark.interop
DOMAIN = 20 + os.getpid() % 150


def test_frames_of_real_nodes_are_those_that_they_published(ros_python, tmp_path):
    pytest.importorskip("cyclonedds")
    scene = make_scene(num_frames=6)
    robot = [ros_python, "tests/interop/ros_robot.py", str(scene_file(tmp_path / "scene.npz")), "6"]
    surroundings = {**os.environ, "ROS_DOMAIN_ID": str(DOMAIN), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    with subprocess.Popen(robot, env=surroundings, stdout=subprocess.PIPE, text=True) as process:
        try:
            source = open_live(f"dds://{DOMAIN}", attempt_s=0.5, patience_s=15.0)
            frames = []
            reading = Thread(target=lambda: frames.extend(source.frames()), daemon=True)
            reading.start()
            assert eventually(lambda: len(frames) >= 15, 10.0), source.status()
        finally:
            source.interrupt()
            process.terminate()
    reading.join(5.0)
    account = source.account()
    source.close()
    assert account.as_dict()["difference"] == 0
    start_ns = scene[0].stamp_ns
    for raw in frames:
        item = scene[(raw.stamp_ns - start_ns) // 100_000_000 % len(scene)]
        frame = raw.decode()
        assert np.array_equal(frame.rgb, item.rgb)
        assert np.array_equal(frame.depth_m, item.depth_m, equal_nan=True)
        turned = quaternion_from_rotation(item.world_from_camera[:3, :3])
        assert np.allclose(np.abs(quaternion_from_rotation(frame.world_from_camera[:3, :3]) @ turned), 1.0, atol=1e-6)
