"""What the processes of a crew do in tests, by the robot's name; in a module of its own, which loads quickly."""

import os
import signal
import time
from hickory_stream.fleet.messages import Ended, Opened
from hickory_stream.fleet.robot_process import listen


def main(task, connection):
    """Send what is played; then end well, be killed, leave without a word, or go on until it is stopped."""
    name = task.robot.name
    is_stopped = False

    def stop(number, frame):
        nonlocal is_stopped
        is_stopped = True

    if name.startswith("late"):
        time.sleep(0.3)
    signal.signal(signal.SIGINT, stop)
    listen()
    connection.send(Opened(text=(name, str(time.monotonic_ns()))))
    if name.startswith("killed"):
        os.kill(os.getpid(), signal.SIGKILL)
    if name.startswith("silent"):
        os._exit(7)
    while "endless" in name and not is_stopped:
        time.sleep(0.01)
    connection.send(Ended(is_finished=not is_stopped, was_stopped=is_stopped, digest=name))
