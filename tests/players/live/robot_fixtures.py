"""A fake robot in a thread, and the frames that a live source makes of it."""

import contextlib
import socket
import time
from dataclasses import dataclass
from threading import Thread
from hickory_stream.records import RawFrame
from players.live import LiveMapSource, open_live
from tests.player_scenes import Messages, make_scene, png_images, scene_messages, write_mcap
from tools.robot.command import Report, drive
from tools.robot.link import Faults, Plan, plan
from tools.robot.prepared import prepared


def free_port():
    with contextlib.closing(socket.socket()) as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def eventually(condition, timeout_s=10.0):
    """Return whether a condition comes true in time."""
    ends_s = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > ends_s:
            return False
        time.sleep(0.01)
    return True


def scene_log(path, num_frames=6, **settings):
    m = Messages(2)
    return write_mcap(path, m, scene_messages(m, make_scene(num_frames=num_frames), png_images), **settings)


@dataclass(kw_only=True)
class Mapped:
    """What a source made of a robot: its frames, and what the robot says that it sent."""

    source: LiveMapSource
    frames: list[RawFrame]
    report: Report
    plan: Plan

    def unaccounted(self):
        """Return by topic how many of the messages that the robot sent are in no bucket of the ledger."""
        account = self.source.account()
        assert account.as_dict()["difference"] == 0
        totals = {entry.topic: entry.total for entry in account.topics}
        sent = self.report.sent
        return {name: sent[name] - totals.get(name, 0) for name in sent if sent[name] != totals.get(name, 0)}


def mapped(log, publisher, uri, faults=None, *, rate=1.0, **options):
    """Have a robot play a log to a live source, and return what came of it."""
    faults = faults or Faults()
    made = plan(prepared([log]), faults)
    reports = []
    robot = Thread(target=lambda: reports.append(drive(made, publisher, faults, waits=True, rate=rate)), daemon=True)
    robot.start()
    source = open_live(uri, attempt_s=0.3, patience_s=20.0, **options)
    frames = []
    reading = Thread(target=lambda: frames.extend(source.frames()), daemon=True)
    reading.start()
    try:
        robot.join(30.0)
        wanted = sum(reports[0].sent.values())
        eventually(lambda: sum(a.num_received for a in source._log.inbox.arrivals.values()) >= wanted, 3.0)
        # What is in the inbox is read before it is ended.
        eventually(lambda: not source._log.left(), 3.0)
    finally:
        source.interrupt()
        reading.join(10.0)
        source.close()
    return Mapped(source=source, frames=frames, report=reports[0], plan=made)
