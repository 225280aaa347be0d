"""Plays a plan in real time through a publisher, and says what it sent."""

import threading
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from tools.robot.link import Faults, Plan
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
            "sent": dict(sorted(self.sent.items())),
            "unheard": dict(sorted(self.unheard.items())),
            "lost": lost,
            "bytes": self.num_bytes,
            "heard": dict(sorted(self.heard.items())),
            "round_trips_s": self.round_trips_s,
            "returned_s": self.returned_s,
            "cpu_s": round(self.cpu_s, 3),
            "wall_s": round(self.wall_s, 3),
        }


def drive(
    made: Plan,
    publisher: Publisher,
    faults: Faults,
    *,
    rate: float = 1.0,
    waits: bool = False,
    stopped: threading.Event | None = None,
    goals: Sequence[tuple[float, bytes]] = (),
) -> Report:
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
    report.num_bytes += len(sending.data) * is_heard


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
