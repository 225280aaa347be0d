"""Status of a live route and its topics: rates, ages, losses, what is missing, and the likely reason."""

from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from players.live.inbox import Arrivals
from players.live.live_log import LiveLog
from players.live.transport import LiveSource
from players.logs.containers import Topic
from players.messages.records import TF

_SILENT_S = 2.0
ROLES = ("color", "depth", "color_info", "depth_info", "pose")
_OFF_S = 1.0


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicStatus:
    """The current state of one topic."""

    topic: str
    type_name: str
    #: In the map, "" for none.
    role: str
    rate_hz: float
    #: Since the last message, None before the first.
    age_s: float | None
    bytes_per_s: float
    received: int
    #: Received and not passed on.
    dropped: int
    #: Never received, by sequence numbers.
    lost: int
    #: What is missing and the likely reason, "" if nothing is.
    problem: str


@dataclass(frozen=True, kw_only=True, slots=True)
class LiveStatus:
    """The current state of a route, by topic; on standard error."""

    uri: str
    kind: str
    #: No more messages are accepted; `problem` is the fault that ended them, "" without one.
    has_ended: bool
    is_connected: bool
    problem: str
    #: Our clock less the robot's, None before the first image.
    clock_offset_s: float | None
    clock_steps: int
    unlisted_topics: int
    topics: tuple[TopicStatus, ...]
    event: Literal["status"] = "status"

    def as_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        return asdict(self)


def status_of(route: LiveSource, log: LiveLog) -> LiveStatus:
    """Return the status of a route."""
    health, inbox = route.health(), log.inbox
    is_connected = health.is_connected and not inbox.is_closed
    now_ns = inbox.clock()
    withdrawn = inbox.withdrawn()
    entries = []
    for topic in inbox.topics:
        arrived = inbox.arrivals.get(topic.name, Arrivals())
        role = log.roles.get(topic.name, "tf" if topic.type_name in TF else "")
        rate, speed = arrived.rate(now_ns)
        age_s = (now_ns - arrived.last_ns) / 1e9 if arrived.last_ns is not None else None
        lost = arrived.fates["lost"]
        entries.append(
            TopicStatus(
                topic=topic.name,
                type_name=topic.type_name,
                role=role,
                rate_hz=round(rate, 2),
                age_s=None if age_s is None else round(age_s, 2),
                bytes_per_s=round(speed),
                received=arrived.num_received,
                dropped=arrived.fates.total() - lost,
                lost=lost,
                # A route that is down, or has ended, explains the silence of its topics.
                problem=_problem(topic, role, age_s, arrived.fates, withdrawn) if is_connected else "",
            )
        )
    offset_ns = log.clock_offset.offset_ns
    return LiveStatus(
        uri=route.uri,
        kind=route.kind,
        has_ended=inbox.is_closed,
        is_connected=is_connected,
        problem=inbox.end_reason if inbox.is_closed else health.problem,
        clock_offset_s=None if offset_ns is None else round(offset_ns / 1e9, 3),
        clock_steps=log.clock_offset.num_steps,
        unlisted_topics=inbox.num_unlisted,
        topics=tuple(entries),
    )


def _problem(topic: Topic, role: str, age_s: float | None, fates: Mapping[str, int], withdrawn: Collection[str]) -> str:
    if not role:
        return ""
    if topic.name in withdrawn:
        return "nobody publishes it any more: the node has ended, or the robot is away"
    is_latched = topic.name.endswith("tf_static")
    if age_s is None:
        if is_latched:
            return "nothing has come: it is sent once, and its publisher keeps nothing for late subscribers"
        return "announced, but nothing has come: the camera or its driver may be off, or sends on demand only"
    if not is_latched and role not in ("color_info", "depth_info") and age_s > _SILENT_S:
        return f"silent for {age_s:.0f} s"
    return ", ".join(f"{number} {_FATES.get(fate, fate)}" for fate, number in sorted(fates.items()) if number)


_FATES = {
    "queue_full": "dropped: more came than was read",
    "before_opening": "dropped: they came before all that is needed was there",
    "too_large": "refused: longer than 64 MB",
    "other_type": "refused: somebody publishes another type under this name",
    "corrupted": "corrupted, as the camera's driver says",
    "lost": "lost on the way",
}


def status_table(status: LiveStatus) -> str:
    """Return a status as lines of text: the topics of the map, then other announced ones."""
    clock = ""
    if status.clock_offset_s is not None and abs(status.clock_offset_s) > _OFF_S:
        clock = f"; the robot's clock is {_span(status.clock_offset_s)} ours, its stamps are kept"
    if status.clock_steps:
        clock += f"; it was set again {status.clock_steps} time{'s' * (status.clock_steps > 1)}"
    state = "ended" if status.has_ended else "connected" if status.is_connected else "not connected"
    note = f": {status.problem}" if status.problem else ""
    lines = [f"{status.uri} ({status.kind}): {state}{note}{clock}"]
    shown = [entry for entry in status.topics if entry.role or entry.received]
    width = max((len(entry.topic) for entry in shown), default=0)
    for entry in shown:
        age = "never" if entry.age_s is None else f"{entry.age_s:.1f} s ago"
        lines.append(
            f"  {entry.topic.ljust(width)}  {entry.role or '-':<10} {entry.rate_hz:7.1f} Hz "
            f"{entry.bytes_per_s / 1e6:7.2f} MB/s {age:>12} {entry.received:>8} came"
            + (f", {entry.dropped} dropped" if entry.dropped else "")
            + (f", {entry.lost} lost" if entry.lost else "")
            + (f"  <- {entry.problem}" if entry.problem else "")
        )
    others = len(status.topics) - len(shown) + status.unlisted_topics
    if others:
        lines.append(f"  and {others} topics that mapping does not need")
    return "\n".join(lines)


def _span(seconds: float) -> str:
    side = "behind" if seconds > 0 else "ahead of"
    size = abs(seconds)
    for unit, length in (("days", 86400.0), ("min", 60.0)):
        if size > 5 * length:
            return f"{size / length:.0f} {unit} {side}"
    return f"{size:.1f} s {side}"
