"""`tools/fake_robot LOG --via ROUTE`: the command line."""
# Plays a plan in real time through a publisher, and says what it sent.

import argparse
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hickory_stream.base.json_text import dumps
from hickory_stream.errors import HickoryError, InputError
from hickory_stream.sinks.ros_messages import goal_message
from tools.robot.link import Faults, Plan, plan
from tools.robot.prepared import prepared
from tools.robot.publishers import Publisher

_POLL_S = 0.02
_SETTLED_S = 0.4
_SENT_S = 0.1
"""What was handed over is on its way by then: a disconnection here loses nothing that is counted as sent."""


@dataclass(slots=True)
class Report:
    """What a robot says it did: messages by topic that were sent to somebody, and that nobody had asked for."""

    # `heard` is what whoever maps the robot has told it, `round_trips_s` how long after each goal a path came.
    # `returned_s` is when it began to be back after a disconnection, by the clock of this machine.
    sent: Counter[str] = field(default_factory=Counter)
    unheard: Counter[str] = field(default_factory=Counter)
    lost: Counter[tuple[str, str]] = field(default_factory=Counter)
    num_bytes: int = 0
    returned_s: list[float] = field(default_factory=list)
    heard: Counter[str] = field(default_factory=Counter)
    round_trips_s: list[float] = field(default_factory=list)
    cpu_s: float = 0.0
    wall_s: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        lost: dict[str, dict[str, int]] = {}
        for (topic, reason), number in sorted(self.lost.items()):
            lost.setdefault(topic, {})[reason] = number
        return {
            "sent": dict(sorted(self.sent.items())), "unheard": dict(sorted(self.unheard.items())), "lost": lost,
            "bytes": self.num_bytes, "heard": dict(sorted(self.heard.items())), "round_trips_s": self.round_trips_s,
            "returned_s": self.returned_s, "cpu_s": round(self.cpu_s, 3), "wall_s": round(self.wall_s, 3),
        }  # fmt: skip


def drive(
    made: Plan, publisher: Publisher, faults: Faults, *, rate: float = 1.0, waits: bool = False,
    stopped: threading.Event | None = None, goals: Sequence[tuple[float, bytes]] = (),
) -> Report:  # fmt: skip
    """Publish what was planned, `rate` times as fast as it was recorded, and return what was sent."""
    # `waits`: until somebody has asked for topics, and asks for no more of them. Messages of a time at which the robot
    # is disconnected are not in the plan; here it is then gone for as long. `goals`: at so many seconds, what it asks.
    stopped = stopped or threading.Event()
    topics = {sending.due.topic.name: sending.due.topic for sending in made.sendings}
    latched = [sending for sending in made.sendings if sending.due.is_latched]
    report = Report(lost=made.lost)
    publisher.connect(topics.values())
    cpu_s, began_s = time.process_time(), time.monotonic()
    try:
        for sending in latched:
            _send(publisher, sending, report)
        if waits:
            _await_subscribers(publisher, [name for name in topics if not name.endswith("tf_static")], stopped)
        cpu_s, began_s = time.process_time(), time.monotonic()
        gone, asked = sorted(faults.disconnects), sorted(goals)
        for sending in made.sendings:
            if sending.due.is_latched:
                continue
            if gone and sending.at_ns / 1e9 >= gone[0][0]:
                at_s, for_s = gone.pop(0)
                _wait(began_s + at_s / rate, stopped)
                stopped.wait(_SENT_S)
                publisher.disconnect()
                _wait(began_s + (at_s + for_s) / rate, stopped)
                report.returned_s.append(time.time())
                publisher.connect(topics.values())
                for kept in latched:
                    _send(publisher, kept, report)
            while asked and sending.at_ns / 1e9 >= asked[0][0]:
                publisher.ask(asked.pop(0)[1])
            if not _wait(began_s + sending.at_ns / 1e9 / rate, stopped):
                break
            _send(publisher, sending, report)
        report.cpu_s, report.wall_s = time.process_time() - cpu_s, time.monotonic() - began_s
        stopped.wait(_SETTLED_S)  # what was handed over last is on its way
        report.heard, report.round_trips_s = publisher.heard.counts, publisher.heard.round_trips_s
    finally:
        publisher.disconnect()
    return report


def _send(publisher: Publisher, sending: Any, report: Report) -> None:
    name = sending.due.topic.name
    is_heard = publisher.is_heard(name)
    publisher.send(sending)
    (report.sent if is_heard else report.unheard)[name] += 1
    report.num_bytes += len(sending.due.data) * is_heard


def _await_subscribers(publisher: Publisher, names: list[str], stopped: threading.Event) -> None:
    heard, since_s = 0, time.monotonic()
    while not stopped.wait(_POLL_S):
        number = sum(publisher.is_heard(name) for name in names)
        if number != heard:
            heard, since_s = number, time.monotonic()
        elif heard and time.monotonic() - since_s > _SETTLED_S:
            return


def _wait(until_s: float, stopped: threading.Event) -> bool:
    left_s = until_s - time.monotonic()
    return not (stopped.wait(left_s) if left_s > 0 else stopped.is_set())


ROUTES = ("zenoh-bridge", "rmw-zenoh", "foxglove", "dds", "mcap")
_PORTS = {"zenoh-bridge": 7447, "rmw-zenoh": 7447, "foxglove": 8765}


def publisher_of(options: argparse.Namespace) -> Publisher:
    """Return the publisher that the options name; on the loopback address unless told otherwise."""
    if options.via == "mcap":
        from tools.robot.publishers import McapPublisher

        if options.listen is None:
            raise InputError("found --via mcap without --listen, expected --listen PIPE, the pipe or file to write")
        return McapPublisher(Path(options.listen))
    if options.via == "dds":
        from tools.robot.dds_publisher import DdsPublisher

        return DdsPublisher(options.domain)
    address = options.listen or f"127.0.0.1:{_PORTS[options.via]}"
    if options.via == "foxglove":
        from tools.robot.foxglove_publisher import FoxglovePublisher

        return FoxglovePublisher(address)
    from tools.robot.zenoh_publishers import RmwZenoh, ZenohBridge

    if options.via == "rmw-zenoh":
        return RmwZenoh(address, domain=options.domain, namespace=options.namespace)
    return ZenohBridge(address, namespace=options.namespace, is_old=options.old_bridge)


def main(arguments: Sequence[str] | None = None) -> int:
    """Play a log as a robot, print what was sent as JSON, and return the exit status."""
    parser = argparse.ArgumentParser(
        prog="tools/fake_robot", description="Play a log as a robot that publishes it, over a link that may be bad."
    )
    parser.add_argument("log", nargs="+", type=Path)
    parser.add_argument("--via", required=True, choices=ROUTES)
    parser.add_argument("--listen", metavar="HOST:PORT|PIPE", help="where it can be reached (this machine only)")
    parser.add_argument("--namespace", default="", help="of all topics")
    parser.add_argument("--domain", type=int, default=0, help="the ROS domain (rmw-zenoh, dds)")
    parser.add_argument("--old-bridge", action="store_true", help="a bridge before 1.5, with its publication cache")
    parser.add_argument("--rate", type=float, default=1.0, help="so many times as fast as it was recorded")
    parser.add_argument("--loop", type=int, default=1, metavar="N", help="play it N times; stamps go on")
    parser.add_argument("--seconds", type=float, metavar="S", help="only the beginning of the log")
    parser.add_argument("--wait", action="store_true", help="begin when somebody listens")
    parser.add_argument("--loss", type=float, default=0.0, metavar="SHARE", help="of the messages never arrive")
    parser.add_argument("--delay", type=float, default=0.0, metavar="MS", help="of every message")
    parser.add_argument("--jitter", type=float, default=0.0, metavar="MS", help="more, at random; messages overtake")
    parser.add_argument("--bandwidth", type=float, metavar="MBIT/S", help="what the link carries")
    parser.add_argument(
        "--disconnect", action="append", default=[], metavar="AT:FOR", help="be gone, seconds; repeatable"
    )
    parser.add_argument("--clock-offset", type=float, default=0.0, metavar="S", help="of the robot's clock")
    parser.add_argument("--restart", type=float, metavar="AT", help="from then on the clock begins at zero")
    parser.add_argument(
        "--goal", action="append", default=[], metavar="AT:X,Y", help="ask for a path then (--publish); repeatable"
    )
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    stopped = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopped.set())
    try:
        faults = _faults(options)
        made = plan(prepared(options.log, most_s=options.seconds, loops=options.loop), faults)
        publisher = publisher_of(options)
        print("ready", file=sys.stderr, flush=True)
        goals = [_goal(text) for text in options.goal]
        report = drive(made, publisher, faults, rate=options.rate, waits=options.wait, stopped=stopped, goals=goals)
    except HickoryError as error:
        print(f"tools/fake_robot: {error}", file=sys.stderr)
        return error.exit_status
    except BrokenPipeError:
        print("tools/fake_robot: nobody reads the pipe any more", file=sys.stderr)
        return 2
    print(dumps(report.as_dict()))
    return 0


def _goal(text: str) -> tuple[float, bytes]:
    try:
        at, _, place = text.partition(":")
        x, y = map(float, place.split(","))
        return float(at), goal_message(0, np.array([x, y]))
    except ValueError as error:
        raise InputError(f"found --goal {text}, expected AT:X,Y in seconds and metres, e.g. 5:1.5,0") from error


def _faults(options: argparse.Namespace) -> Faults:
    try:
        disconnects = tuple((float(at), float(s)) for at, _, s in (text.partition(":") for text in options.disconnect))
    except ValueError as error:
        raise InputError(f"found --disconnect {options.disconnect}, expected AT:FOR in seconds, e.g. 10:30") from error
    if not 0 <= options.loss <= 1:
        raise InputError(f"found --loss {options.loss:g}, expected a share of 0 to 1, e.g. 0.1")
    return Faults(
        loss=options.loss, delay_s=options.delay / 1e3, jitter_s=options.jitter / 1e3, bandwidth_mbit=options.bandwidth,
        disconnects=disconnects, clock_offset_s=options.clock_offset, restart_s=options.restart, seed=options.seed,
    )  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
