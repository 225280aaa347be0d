"""Statistics of a topic's stamps: rate, order, gaps, and lag of log time behind header stamps."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from players.messages.header_stamp import serialized_stamp_ns

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from players.logs.containers import LogMessage, Topic

_GAP_PERIODS = 5.0


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

    def as_dict(self) -> dict[str, Any]:
        """Return the figures of the topic."""
        stamps = self.stamps()
        figures: dict[str, Any] = {
            "type": self.topic.type_name,
            "messages": len(self.log_ns),
            "declared": self.topic.num_messages,
            "megabytes": round(self.num_bytes / 1e6, 3),
        }
        if not len(stamps):
            return figures
        steps = np.asarray(np.diff(stamps), dtype=np.int64)
        ordered = np.asarray(np.diff(np.unique(stamps)), dtype=np.int64)
        period_ns = float(np.median(ordered)) if len(ordered) else 0.0
        figures |= {
            "first_s": float(stamps.min()) / 1e9,
            "last_s": float(stamps.max()) / 1e9,
            "rate_hz": round(1e9 / period_ns, 2) if period_ns else None,
            "jitter_ms": round(float(np.std(ordered[ordered < 3 * period_ns])) / 1e6, 2) if len(ordered) > 2 else None,
            "out_of_order": int((steps < 0).sum()),
            "worst_step_back_s": round(float(-steps.min(initial=0)) / 1e9, 3),
            "duplicates": len(stamps) - len(ordered) - 1,
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
