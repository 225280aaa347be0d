"""Statistics of a topic's stamps: rate, order, gaps, and lag of log time behind header stamps.

They are counted while the log is played, so that each message is read once.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from players.logs.joined_log import JoinedLog
from players.logs.log_parts import Parts
from players.messages.header_stamp import serialized_stamp_ns
from players.messages.records import TF

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping

    from numpy.typing import NDArray

    from players.logs.containers import Log, LogMessage, Topic

_GAP_PERIODS = 5.0
_STEP_S, _ALIKE_S, _DRIFT = 0.3, 0.2, 3e-4


@dataclass(slots=True)
class StreamStats:
    """The messages of a topic: header stamps (log times for types without a header), log times, sizes."""

    topic: Topic
    num_bytes: int = 0
    header_ns: array[int] = field(default_factory=lambda: array("q"))
    log_ns: array[int] = field(default_factory=lambda: array("q"))

    def add(self, message: LogMessage) -> None:
        """Count a message."""
        self.num_bytes += len(message.data)
        self.log_ns.append(message.log_ns)
        stamp_ns = serialized_stamp_ns(self.topic, message.data)
        if stamp_ns is not None:
            self.header_ns.append(stamp_ns)

    @property
    def has_headers(self) -> bool:
        """Whether the type begins with a header."""
        return len(self.header_ns) == len(self.log_ns) > 0

    def stamps(self, *, uses_log_time: bool = False) -> NDArray[np.int64]:
        """Return the stamps (N,) that count, in the order of the log."""
        chosen = self.log_ns if uses_log_time or not self.has_headers else self.header_ns
        return np.asarray(chosen, dtype=np.int64)

    def as_dict(self, parts: Parts | None = None) -> dict[str, Any]:
        """Return the figures of the topic; of a log that was read in parts, the index has the number of messages."""
        stamps, number = self.stamps(), len(self.log_ns)
        total = number if parts is None or self.topic.num_messages is None else self.topic.num_messages
        figures: dict[str, Any] = {
            "type": self.topic.type_name,
            "messages": total,
            "declared": self.topic.num_messages,
            "megabytes": round(self.num_bytes / 1e6 * total / max(number, 1), 3),
        }
        if not len(stamps):
            return figures
        steps = np.asarray(np.diff(stamps), dtype=np.int64)
        ordered = np.asarray(np.diff(np.unique(stamps)), dtype=np.int64)
        num_duplicates = len(stamps) - len(ordered) - 1
        if parts is not None:
            ordered = ordered[ordered < parts.pause_ns // 2]
        period_ns = float(np.median(ordered)) if len(ordered) else 0.0
        figures |= {
            "first_s": float(stamps.min()) / 1e9,
            "last_s": float(stamps.max()) / 1e9,
            "rate_hz": round(1e9 / period_ns, 2) if period_ns else None,
            "jitter_ms": round(float(np.std(ordered[ordered < 3 * period_ns])) / 1e6, 2) if len(ordered) > 2 else None,
            "out_of_order": int((steps < 0).sum()),
            "worst_step_back_s": round(float(-steps.min(initial=0)) / 1e9, 3),
            "duplicates": num_duplicates,
            "gaps": int((ordered > max(_GAP_PERIODS * period_ns, 1e8)).sum()),
            "longest_gap_s": round(float(ordered.max(initial=0)) / 1e9, 3),
        }
        if self.has_headers:
            offsets = (np.asarray(self.log_ns) - np.asarray(self.header_ns)) / 1e9
            figures |= {
                "unset_stamps": int((stamps == 0).sum()),
                "log_offset_s": round(float(np.median(offsets)), 3),
                "log_offset_spread_s": round(float(np.percentile(offsets, 95) - np.percentile(offsets, 5)), 3),
            }
        return figures


class CountedLog(JoinedLog):
    """A `Log` that counts all messages of each pass, also of topics that are not asked for."""

    def __init__(self, log: Log) -> None:
        super().__init__(log.path, log.kind, [log])
        #: Of the latest pass that reached the end.
        self.stats: dict[str, StreamStats] = {}

    def messages(self, topics: Collection[str]) -> Iterator[LogMessage]:
        """Yield the messages of some topics in the order of the log."""
        stats = {topic.name: StreamStats(topic) for topic in self.topics}
        for message in self.logs[0].messages(list(stats)):
            stats[message.topic].add(message)
            if message.topic in topics:
                yield message
        self.stats.update(stats)


def clock_steps(stats: Mapping[str, StreamStats], parts: Parts) -> list[str]:
    """Return the steps of the robot's clock between parts, by which the lags of all topics moved alike."""
    ends_s = [(first_ns / 1e9, last_ns / 1e9) for first_ns, last_ns in parts.spans()]
    lags_s = []
    for one in stats.values():
        if one.has_headers and one.topic.type_name not in TF:
            log_ns = np.asarray(one.log_ns)
            part = np.searchsorted(parts.bounds_ns, log_ns, side="right")
            lag_s = (log_ns - np.asarray(one.header_ns)) / 1e9
            each = [lag_s[part == 2 * i + 1] for i in range(parts.number)]
            lags_s.append([float(np.median(some)) if len(some) else np.nan for some in each])
    moved_s = np.diff(np.array(lags_s).reshape(-1, parts.number), axis=1)
    found = []
    for i, moves_s in enumerate(moved_s.T):
        known_s = moves_s[np.isfinite(moves_s)]
        # A clock that drifts moves by little.
        if (
            len(known_s) < 2
            or np.ptp(known_s) > _ALIKE_S
            or np.abs(known_s).min() < _STEP_S + _DRIFT * parts.pause_ns / 1e9
        ):
            continue
        way, (_, before_s), (after_s, _) = "back" if known_s[0] > 0 else "ahead", ends_s[i], ends_s[i + 1]
        found.append(
            f"the robot's clock was set {way} by {abs(float(np.median(known_s))):.2f} s between log times "
            f"{before_s:.3f} and {after_s:.3f} s"
        )
    return found


def nearest_ms(color_ns: NDArray[np.int64], depth_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the signed milliseconds (N,) from each colour image to the nearest depth image."""
    if not len(color_ns) or not len(depth_ns):
        return np.zeros(0)
    depth_ns = np.sort(depth_ns)
    after = np.clip(np.searchsorted(depth_ns, color_ns), 1, max(1, len(depth_ns) - 1))
    if len(depth_ns) == 1:
        return np.asarray((depth_ns[0] - color_ns) / 1e6)
    before_ms, after_ms = (depth_ns[after - 1] - color_ns) / 1e6, (depth_ns[after] - color_ns) / 1e6
    return np.where(np.abs(before_ms) <= np.abs(after_ms), before_ms, after_ms)
