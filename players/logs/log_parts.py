"""Parts of a long log, by log time: what `doctor` reads of it takes as long as of a short one.

The parts spread evenly from its beginning to its end; only the chunks of them are read, by the container's index.
"""

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from players.logs.containers import Log, Topic
from players.messages.records import COMPRESSED_IMAGE, IMAGE, VIDEOS

_NUMBER, _LEAST_NS, _MOST_NS = 6, 3_000_000_000, 6_000_000_000
# Images begin after the poses of a part and end before them.
_MARGIN_NS = 1_000_000_000
_PART_BYTES, _PART_MESSAGES = 200_000_000, 15_000
#: A log of less is read whole.
_WHOLE_BYTES, _WHOLE_MESSAGES, _FEW_MESSAGES = 300_000_000, 100_000, 64
# Logs with a longer pause between them have different clocks, as a replay's, or are another recording.
_PAUSE_NS = 60_000_000_000
_SHARE_UNSET = 100


@dataclass(frozen=True, kw_only=True, slots=True)
class Parts:
    """Spans of log time: of all messages, and of images. `whole` names the topics that are read everywhere."""

    #: Beginnings and ends in turns.
    bounds_ns: tuple[int, ...]
    image_bounds_ns: tuple[int, ...]
    images: frozenset[str]
    whole: frozenset[str]
    #: Share of the time of images in that of the log.
    share: float

    @property
    def number(self) -> int:
        """The number of the parts."""
        return len(self.bounds_ns) // 2

    @property
    def pause_ns(self) -> int:
        """The time between two parts."""
        return self.bounds_ns[2] - self.bounds_ns[1]

    def spans(self) -> Iterator[tuple[int, int]]:
        """Yield the first and the last time of each part."""
        return zip(self.bounds_ns[::2], self.bounds_ns[1::2], strict=True)

    def at(self, log_ns: int) -> int | None:
        """Return the number of the part at a time, None outside of them."""
        after = bisect_right(self.bounds_ns, log_ns)
        return after // 2 if after % 2 else None

    def meets(self, first_ns: int, last_ns: int) -> bool:
        """Return whether a part has some of a span of time."""
        after = bisect_right(self.bounds_ns, first_ns)
        return after % 2 == 1 or (after < len(self.bounds_ns) and self.bounds_ns[after] <= last_ns)

    def wants(self, topic: str, log_ns: int) -> bool:
        """Return whether to read a message."""
        bounds_ns = self.image_bounds_ns if topic in self.images else self.bounds_ns
        return bisect_right(bounds_ns, log_ns) % 2 == 1 or topic in self.whole


class Divisible(Protocol):
    """A container that can be read in parts."""

    files: tuple[Path, ...]
    topics: tuple[Topic, ...]
    parts: Parts | None

    def span_ns(self) -> tuple[int, int] | None:
        """Return the first and the last log time; None if they are not known."""


def _leaves(log: Any) -> Iterator[Divisible]:
    joined = getattr(log, "logs", ())
    if not joined and hasattr(log, "parts"):
        yield log
    for part in joined:
        yield from _leaves(part)


def span_of(spans: Sequence[tuple[int, int]]) -> tuple[int, int] | None:
    """Return the first and the last time of chunks, without the few that a clock stamped which was not set."""
    if not spans:
        return None
    firsts_ns, lasts_ns = sorted(first_ns for first_ns, _ in spans), sorted(last_ns for _, last_ns in spans)
    few = len(spans) // _SHARE_UNSET
    first_ns, last_ns = firsts_ns[few], lasts_ns[-1 - few]
    is_apart = lasts_ns[-1] - firsts_ns[0] > 2 * (last_ns - first_ns)
    return (first_ns, last_ns) if is_apart else (firsts_ns[0], lasts_ns[-1])


def parts_of(log: Log) -> Parts | None:
    """Return the parts that are read of a log, None of a whole one."""
    return next((leaf.parts for leaf in _leaves(log) if leaf.parts is not None), None)


def divide(log: Log) -> None:
    """From now on, read only parts of a long log."""
    spans = [(span, leaf) for leaf in _leaves(log) if (span := leaf.span_ns()) is not None]
    groups: list[list[tuple[tuple[int, int], Divisible]]] = []
    for span, leaf in sorted(spans, key=lambda one: one[0]):
        if groups and span[0] - max(last_ns for (_, last_ns), _ in groups[-1]) < _PAUSE_NS:
            groups[-1].append((span, leaf))
        else:
            groups.append([(span, leaf)])
    for group in groups:
        leaves = [leaf for _, leaf in group]
        parts = _parts(leaves, group[0][0][0], max(last_ns for (_, last_ns), _ in group))
        for leaf in leaves:
            leaf.parts = parts


def _parts(leaves: Sequence[Divisible], first_ns: int, last_ns: int) -> Parts | None:
    num_bytes = sum(file.stat().st_size for leaf in leaves for file in leaf.files)
    topics = [topic for leaf in leaves for topic in leaf.topics]
    messages = sum(topic.num_messages or 0 for topic in topics)
    most = max(num_bytes / _PART_BYTES, messages / _PART_MESSAGES)
    length_ns = min(_MOST_NS, max(_LEAST_NS, round((last_ns - first_ns) / max(most, 1e-9))))
    pause_ns = (last_ns - first_ns - _NUMBER * length_ns) // (_NUMBER - 1)
    if (num_bytes < _WHOLE_BYTES and messages < _WHOLE_MESSAGES) or pause_ns < length_ns:
        return None
    starts_ns = [first_ns + i * (length_ns + pause_ns) for i in range(_NUMBER)]
    bounds_ns = [(start_ns, start_ns + length_ns) for start_ns in starts_ns]
    bounds_ns[-1] = bounds_ns[-1][0], last_ns + 1
    inner = [
        (start_ns + _MARGIN_NS * (i > 0), end_ns - _MARGIN_NS * (i < _NUMBER - 1))
        for i, (start_ns, end_ns) in enumerate(bounds_ns)
    ]
    counts: dict[str, int] = {}
    for topic in topics:
        counts[topic.name] = counts.get(topic.name, 0) + (
            _FEW_MESSAGES if topic.num_messages is None else topic.num_messages
        )
    return Parts(
        bounds_ns=tuple(ns for span in bounds_ns for ns in span),
        image_bounds_ns=tuple(ns for span in inner for ns in span),
        images=frozenset(topic.name for topic in topics if topic.type_name in (IMAGE, COMPRESSED_IMAGE, *VIDEOS)),
        whole=frozenset(name for name, number in counts.items() if number < _FEW_MESSAGES),
        share=sum(end_ns - start_ns for start_ns, end_ns in inner) / (last_ns - first_ns),
    )
