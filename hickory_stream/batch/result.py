"""What a batch has made: a row for each log, and where their maps overlap."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from hickory_stream.batch.tasks import LogOutcome


@dataclass(frozen=True, kw_only=True, slots=True)
class Row:
    """One log: what came of it, its map, and whether that was there before this run of the batch."""

    uri: str
    map: Path
    outcome: LogOutcome
    was_there: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class Overlap:
    """Two maps that were aligned: how many objects agree (0: none do), in how far, and what was said."""

    a: str
    b: str
    is_believed: bool
    num_pairs: int
    told: str


@dataclass(frozen=True, kw_only=True, slots=True)
class MergedMap:
    """One map of several logs; `num_united` of its objects are in several of their maps."""

    path: Path
    names: tuple[str, ...]
    digest: str | None
    num_objects: int
    num_united: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Joined:
    """Where maps overlap: of `num_pairs` pairs those that were aligned, and the merged maps, the largest first.

    `signature_kb` is the mean size of a map's place signature; `problems` say which maps could not be read.
    """

    num_pairs: int
    overlaps: tuple[Overlap, ...]
    merged: tuple[MergedMap, ...]
    signature_kb: float
    problems: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class BatchResult:
    """The rows in the order of the logs; `joined` None where nothing was to be merged; `stopped` says why it ended."""

    out: Path
    rows: tuple[Row, ...]
    wall_s: float
    joined: Joined | None = None
    stopped: str = ""

    @property
    def is_whole(self) -> bool:
        """Whether every log is mapped."""
        return all(row.outcome.state == "mapped" for row in self.rows)
