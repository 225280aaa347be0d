"""A simulated link with faults: loss, delay and order of each message, drawn from a seed before the run."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tools.robot.prepared import Due, restamped

_MOST_QUEUED_S = 2.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Faults:
    """What is wrong with a robot and its network."""

    # `loss`: share that never arrives; `jitter_s`: uniform, messages overtake each other; `bandwidth_mbit`: None is
    # all, a wait over 2 s drops; `disconnects`: (at, for) in s; from `restart_s` on stamps begin at zero.
    loss: float = 0.0
    delay_s: float = 0.0
    jitter_s: float = 0.0
    bandwidth_mbit: float | None = None
    disconnects: tuple[tuple[float, float], ...] = ()
    clock_offset_s: float = 0.0
    restart_s: float | None = None
    seed: int = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class Sending:
    """A message as it is sent: `sequence` is its number among those of its topic, lost ones included."""

    at_ns: int
    due: Due
    sequence: int
    #: the robot's clock is that of the log and so much more
    by_ns: int

    @property
    def data(self) -> bytes:
        """The message with its stamps by the robot's clock; made when asked for: a log may fill the memory once."""
        return restamped(self.due.topic, self.due.data, self.by_ns)


@dataclass(slots=True)
class Plan:
    """What is sent, in the order of time, and how many messages of each topic are lost for which reason."""

    sendings: list[Sending] = field(default_factory=list)
    lost: Counter[tuple[str, str]] = field(default_factory=Counter)


def plan(messages: Sequence[Due], faults: Faults) -> Plan:
    """Return what becomes of every message; latched ones are delayed, but never lost."""
    rng = np.random.default_rng(faults.seed)
    made = Plan()
    sequences: Counter[str] = Counter()
    first_of: dict[str, int] = {}
    free_ns = 0
    for due in messages:
        name = due.topic.name
        sequences[name] += 1
        draw, wobble = rng.random(2)
        reason = _loss(due, faults, draw)
        at_ns = due.due_ns + round((faults.delay_s + wobble * faults.jitter_s) * 1e9)
        if reason is None and faults.bandwidth_mbit is not None:
            begins_ns = max(free_ns, at_ns)
            if begins_ns - at_ns > _MOST_QUEUED_S * 1e9 and not due.is_latched:
                reason = "link_full"
            else:
                free_ns = at_ns = begins_ns + round(len(due.data) * 8e3 / faults.bandwidth_mbit)
        if reason is not None:
            made.lost[name, reason] += 1
            continue
        by_ns = due.later_ns + round(faults.clock_offset_s * 1e9)
        if faults.restart_s is not None and due.due_ns >= faults.restart_s * 1e9:
            # The clock begins anew for all topics at one moment, which the first stamp after it tells.
            by_ns = due.later_ns + first_of.setdefault("", _zero(due))
        made.sendings.append(Sending(at_ns=at_ns, due=due, sequence=sequences[name], by_ns=by_ns))
    made.sendings.sort(key=lambda sending: sending.at_ns)
    return made


def _loss(due: Due, faults: Faults, draw: float) -> str | None:
    if due.is_latched:
        return None
    if any(at_s <= due.due_ns / 1e9 < at_s + for_s for at_s, for_s in faults.disconnects):
        return "offline"
    return "loss" if draw < faults.loss else None


def _zero(due: Due) -> int:
    from players.messages.header_stamp import serialized_stamp_ns

    stamp_ns = serialized_stamp_ns(due.topic, due.data)
    return 1_000_000_000 - (stamp_ns or 0) - due.later_ns
