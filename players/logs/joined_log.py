"""Several logs as one: split recordings, or odometry in a separate bag.

Logs are merged by header stamp, since odometry from a replay has the log times of the replay.
"""

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from players.logs.containers import Log, LogMessage, merged_topics
from players.logs.log_damage import Flaws
from players.messages.header_stamp import serialized_stamp_ns


@dataclass(slots=True)
class _Head:
    message: LogMessage
    rest: Iterator[LogMessage]
    stamp_ns: int


class JoinedLog:
    """A `Log` of several logs."""

    def __init__(self, path: Path | str, kind: str, logs: Sequence[Log]) -> None:
        self.path = path
        self.kind = kind
        self.logs = tuple(logs)
        self.files = tuple(file for log in logs for file in log.files)
        self.topics = merged_topics([topic for log in logs for topic in log.topics])
        self.profile = next((profile for log in logs if (profile := getattr(log, "profile", None))), None)
        self.unreadable: tuple[str, ...] = ()
        """Files of the log that cannot be read at all, with the reason."""
        self.notes: tuple[str, ...] = ()
        self._topic_of = [{topic.name: topic for topic in log.topics} for log in logs]

    @property
    def flaws(self) -> Flaws:
        """The flaws of all logs."""
        flaws = Flaws()
        for log in self.logs:
            for flaw in log.flaws:
                flaws.add(flaw)
        return flaws

    @property
    def checksum(self) -> str:
        """The checksums of all logs, "" if one of them has none."""
        found = sorted({log.checksum for log in self.logs})
        return ", ".join(found) if all(found) else ""

    def declared(self) -> dict[str, int] | None:
        """Return the sums over the logs, None if one of them declares no counts."""
        total: Counter[str] = Counter()
        for log in self.logs:
            declared = log.declared()
            if declared is None:
                return None
            total.update(declared)
        return dict(total)

    def messages(self, topics: Collection[str]) -> Iterator[LogMessage]:
        """Yield the messages of all logs, each time from the log with the oldest next message."""
        heads: list[_Head | None] = [
            self._next(i, log.messages([name for name in topics if name in self._topic_of[i]]), None)
            for i, log in enumerate(self.logs)
        ]
        while waiting := [(head.stamp_ns, i) for i, head in enumerate(heads) if head is not None]:
            _, i = min(waiting)
            head = heads[i]
            assert head is not None
            yield head.message
            heads[i] = self._next(i, head.rest, head.stamp_ns)

    def _next(self, i: int, rest: Iterator[LogMessage], before_ns: int | None) -> _Head | None:
        message = next(rest, None)
        if message is None:
            return None
        # Static transforms may have any stamp, and stamps may be unset: neither changes the log's position in time.
        stamp_ns = serialized_stamp_ns(self._topic_of[i][message.topic], message.data) or 0
        return _Head(message, rest, max(stamp_ns, before_ns or 0))
