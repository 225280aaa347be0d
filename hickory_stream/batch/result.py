"""Result of a batch: a row for each log, and the overlaps of their maps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from hickory_stream.batch.tasks import LogOutcome

if TYPE_CHECKING:
    from pathlib import Path

    from hickory_stream.fleet.finish import MergedFrame


@dataclass(frozen=True, kw_only=True, slots=True)
class Row(LogOutcome):
    """Outcome of a log; `was_there`: an earlier run finished it."""

    log: str
    map: str
    was_there: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class Overlap:
    """Two maps that were aligned: number of agreeing objects (0: none), and the outcome in words."""

    a: str
    b: str
    is_believed: bool
    num_pairs: int
    told: str


@dataclass(frozen=True, kw_only=True, slots=True)
class Joined:
    """Overlaps among `num_pairs` pairs, and the merged maps, the largest first.

    `signature_kb` is the mean size of a map's place signature; `problems` are maps that cannot be read.
    """

    num_pairs: int
    overlaps: tuple[Overlap, ...]
    merged: tuple[MergedFrame, ...]
    signature_kb: float
    problems: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class BatchResult:
    """Rows in the order of the logs; `joined` is None without merging; `stopped` is the reason of an early end."""

    out: Path
    rows: tuple[Row, ...]
    wall_s: float
    joined: Joined | None = None
    stopped: str = ""

    @property
    def is_whole(self) -> bool:
        """Whether every log is mapped, and has objects."""
        return all(row.state == "mapped" and row.objects for row in self.rows)
