"""Flaws in the bytes of a log, each listed once by its place, however often the log is read."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Flaw:
    """Bytes that could not be read."""

    file: str
    offset: int
    what: str
    num_bytes: int
    #: Lost messages by topic, as far as an index counts them.
    lost: tuple[tuple[str, int], ...] = ()
    #: Further lost messages of unknown topics.
    num_unknown: int = 0

    @property
    def num_lost(self) -> int:
        """Number of messages known to be lost."""
        return self.num_unknown + sum(number for _, number in self.lost)


class Flaws:
    """The flaws of one log; a flaw found again at the same place replaces the earlier one."""

    def __init__(self, file: str = "") -> None:
        self._file = file
        self._by_place: dict[tuple[str, int], Flaw] = {}

    def note(
        self, offset: int, what: str, num_bytes: int, lost: Mapping[str, int] | None = None, num_unknown: int = 0
    ) -> None:
        """Add a flaw of the file; `lost` messages by topic, "" for unknown ones."""
        known = {topic: number for topic, number in (lost or {}).items() if topic}
        num_unknown += (lost or {}).get("", 0)
        self.add(Flaw(self._file, offset, what, num_bytes, tuple(known.items()), num_unknown))

    def add(self, flaw: Flaw) -> None:
        """Note a flaw; of two at one place the later one is kept, since it is more complete."""
        self._by_place[flaw.file, flaw.offset] = flaw

    def __iter__(self) -> Iterator[Flaw]:
        """Yield the flaws in the order of their places."""
        return iter([self._by_place[place] for place in sorted(self._by_place)])

    def __len__(self) -> int:
        return len(self._by_place)

    @property
    def num_bytes(self) -> int:
        """Number of unreadable bytes."""
        return sum(flaw.num_bytes for flaw in self)

    def lost(self) -> Mapping[str, int]:
        """Return how many messages of each topic are known to be lost; under "" those of unknown topics."""
        lost: Counter[str] = Counter()
        for flaw in self:
            lost.update(dict(flaw.lost))
            lost[""] += flaw.num_unknown
        return {topic: number for topic, number in sorted(lost.items()) if number}
