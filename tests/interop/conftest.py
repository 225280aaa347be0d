"""Fixtures of the tests against implementations by others."""

import os
import subprocess
import sys
import pytest


@pytest.fixture(scope="session")
def ros_python():
    """An interpreter with rclpy: this one, or that of $HICKORY_ROS_PYTHON."""
    chosen = os.environ.get("HICKORY_ROS_PYTHON", sys.executable)
    if subprocess.run([chosen, "-c", "import rclpy, nav_msgs.msg"], capture_output=True, check=False).returncode:
        pytest.skip(f"{chosen} has no rclpy (pip install 'hickory-stream[interop]', or $HICKORY_ROS_PYTHON)")
    return chosen
