"""Account of a log: every message in exactly one bucket, compared with the counts that the container declares.

Used: part of a frame, or a pose, transform or calibration. Not needed: of a topic that was not asked for.
Unreadable: damaged. Not played: behind the end of the pass. The rest is the difference, 0 for a sound log.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import islice
from threading import Lock
from typing import Any

from players.logs.containers import Log
from players.logs.log_parts import parts_of
from players.logs.log_setup import LogSetup

_MAX_FLAWS = 5


class Ledger:
    """Counts by name, with a lock, since frames are decoded in other threads than the reading one.

    `read` and `rejected` count by topic; a message that was read, and is neither rejected nor unreadable, is used.
    """

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._lock = Lock()
        self.read: Counter[str] = Counter()
        self.unreadable: Counter[str] = Counter()
        self.rejected: Counter[tuple[str, str]] = Counter()
        #: The first error of each name, in words.
        self.reasons: dict[str, str] = {}
        self.is_complete = False

    def count(self, fate: str, number: int = 1) -> None:
        """Add `number` to the count of that name."""
        with self._lock:
            self._counts[fate] += number

    def reject(self, topic: str, reason: str) -> None:
        """Note a message that was read and cannot be used; called by the thread that reads."""
        self.rejected[topic, reason] += 1

    def as_dict(self) -> dict[str, int]:
        """Return the counts so far, sorted by name."""
        with self._lock:
            return dict(sorted((fate, number) for fate, number in self._counts.items() if number))


@dataclass(frozen=True, kw_only=True, slots=True)
class TopicAccount:
    """The messages of one topic by bucket; `declared` is None if the container does not declare a count."""

    topic: str
    declared: int | None
    used: int = 0
    not_needed: int = 0
    unreadable: int = 0
    not_played: int = 0
    rejected: Mapping[str, int] = field(default_factory=dict)

    @property
    def total(self) -> int:
        """The sum of the buckets."""
        return self.used + self.not_needed + self.unreadable + self.not_played + sum(self.rejected.values())

    @property
    def difference(self) -> int:
        """Number of declared messages that are in no bucket."""
        return 0 if self.declared is None else self.declared - self.total


@dataclass(frozen=True, kw_only=True, slots=True)
class Account:
    """The messages of a log by topic and bucket; for a folder, files are counted."""

    topics: tuple[TopicAccount, ...]
    #: The pass reached the end of the log.
    is_complete: bool
    num_flaws: int = 0
    #: The first damaged places.
    flaws: tuple[str, ...] = ()
    explanation: str = ""
    unit: str = "messages"
    #: Faults of transforms and clocks, one line each.
    findings: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return it for `ledger.json`."""
        names = ("used", "not_needed", "unreadable", "not_played", "difference")
        rejected: Counter[str] = Counter()
        for entry in self.topics:
            rejected.update(entry.rejected)
        is_declared = all(e.declared is not None for e in self.topics)
        return {
            "unit": self.unit,
            "declared": sum(e.declared or 0 for e in self.topics) if is_declared else None,
            **({name: sum(getattr(e, name) for e in self.topics) for name in names} if self.topics else {}),
            "rejected": dict(sorted(rejected.items())),
            "is_complete": self.is_complete,
            "damaged_places": self.num_flaws,
            "damage": list(self.flaws),
            "explanation": self.explanation,
            **({"findings": list(self.findings)} if self.findings else {}),
            "topics": {
                entry.topic: {
                    **{name: getattr(entry, name) for name in ("declared", "used", "not_needed")},
                    "rejected": dict(sorted(entry.rejected.items())),
                    **{name: getattr(entry, name) for name in ("unreadable", "not_played")},
                }
                for entry in self.topics
            },
        }


def account_of(log: Log, setup: LogSetup, ledger: Ledger) -> Account:
    """Return the ledger of one pass over a log."""
    declared, lost = log.declared(), log.flaws.lost()
    is_complete = ledger.is_complete and parts_of(log) is None
    needed = {setup.topics.color.name, setup.topics.depth.name, *(topic.name for topic in setup.small_topics)}
    entries = []
    # A copy, since another thread may still be reading the log.
    rejected_of = dict(ledger.rejected)
    for topic in log.topics:
        claimed = topic.num_messages if declared is None else declared.get(topic.name, 0)
        unreadable = lost.get(topic.name, 0)
        if topic.name not in needed:
            readable = max(0, (claimed or 0) - unreadable)
            entries.append(TopicAccount(topic=topic.name, declared=claimed, not_needed=readable, unreadable=unreadable))
            continue
        rejected = {reason: number for (name, reason), number in rejected_of.items() if name == topic.name and number}
        read, bad = ledger.read[topic.name], ledger.unreadable[topic.name]
        not_played = 0 if is_complete or claimed is None else max(0, claimed - read - unreadable)
        entries.append(
            TopicAccount(
                topic=topic.name,
                declared=claimed,
                used=read - bad - sum(rejected.values()),
                unreadable=unreadable + bad,
                not_played=not_played,
                rejected=rejected,
            )
        )
    if lost.get(""):
        entries.append(TopicAccount(topic="(topic not known)", declared=0, unreadable=lost[""]))
    return Account(
        topics=tuple(entries),
        is_complete=is_complete,
        num_flaws=len(log.flaws),
        flaws=tuple(f"{f.file} at byte {f.offset}: {f.what}" for f in islice(log.flaws, _MAX_FLAWS)),
        explanation=_explanation(log, entries),
    )


def _explanation(log: Log, entries: list[TopicAccount]) -> str:
    difference = sum(entry.difference for entry in entries)
    if log.declared() is None:
        return "the container declares no totals (its index is missing or damaged): they are those that were found"
    if difference > 0:
        return f"{difference} messages lay in damaged bytes whose topics no index lists"
    if difference < 0:
        return f"{-difference} messages more than the container declares were found: its index is older than its data"
    return ""
