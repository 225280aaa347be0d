"""Probability that an object stays where it is until the next map, learnt from comparisons.

A Beta distribution per object counts the comparisons in which it stayed or moved, weighted by the probability of the
verdict (POCD: Qian, Chatrath, Servos, Mavrinac, Burgard, Waslander and Schoellig, RSS 2022). The counts follow an
object from map to map; unobserved objects do not count.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hickory_stream.base.json_text import dumps
from hickory_stream.changes.records import ChangesConfig, MapChanges, Verdict
from hickory_stream.errors import InputError

_VERSION = 1
# As much as two comparisons say: one move alone makes no object one that tends to move.
_PRIOR_WEIGHT = 2.0
MOVES_BELOW = 0.5
"""An object tends to move that stays with less than this probability."""


@dataclass(frozen=True, kw_only=True, slots=True)
class StayCount:
    """Number of comparisons in which an object `stayed`, and in which it `moved` or came from elsewhere."""

    stayed: float = 0.0
    moved: float = 0.0

    def probability(self, change_prior: float = ChangesConfig().change_prior) -> float:
        """Return the probability that it stays until the next map."""
        known = self.stayed + self.moved
        return (self.stayed + _PRIOR_WEIGHT * (1 - change_prior)) / (known + _PRIOR_WEIGHT)


@dataclass(frozen=True, kw_only=True, slots=True)
class Stationarity:
    """The counts of the objects of one map by id; `digest` identifies the map."""

    digest: str
    counts: Mapping[int, StayCount]

    def movable(self) -> list[int]:
        """Return the ids of the objects that tend to move."""
        return sorted(i for i, count in self.counts.items() if count.probability() < MOVES_BELOW)


def after_comparison(before: Mapping[int, StayCount], found: MapChanges) -> dict[int, StayCount]:
    """Return the counts of the later map's objects, from the earlier counts and the changes."""
    counts: dict[int, StayCount] = {}
    for change in found.changes:
        if change.id_b is None:
            continue
        known = before.get(change.id_a, StayCount()) if change.id_a is not None else StayCount()
        match change.verdict:
            case Verdict.STILL_THERE:
                stays = change.probability
                counts[change.id_b] = StayCount(stayed=known.stayed + stays, moved=known.moved + 1 - stays)
            case Verdict.MOVED:
                counts[change.id_b] = StayCount(stayed=known.stayed, moved=known.moved + change.probability)
            case Verdict.NEW | Verdict.EXCHANGED:
                # Another object stands there now: it came.
                counts[change.id_b] = StayCount(moved=change.probability)
            case _:
                counts[change.id_b] = known
    return counts


def write_stationarity(known: Stationarity) -> bytes:
    """Return the content of a stationarity file."""
    rows = [
        {"id": i, "stayed": count.stayed, "moved": count.moved, "stays": round(count.probability(), 6)}
        for i, count in sorted(known.counts.items())
    ]
    return (dumps({"version": _VERSION, "map_digest": known.digest, "objects": rows}, indent=1) + "\n").encode()


def read_stationarity(path: Path, digest: str | None) -> Stationarity:
    """Return the counts in a file of the map with this digest; raises `InputError` for an invalid or other file."""
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
        if report["version"] != _VERSION:
            raise InputError(
                f"{path} is of version {report['version']}, expected {_VERSION}; make it again with `diff`"
            )
        of = str(report["map_digest"])
        counts = {
            int(row["id"]): StayCount(stayed=_count(row["stayed"]), moved=_count(row["moved"]))
            for row in report["objects"]
        }
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}; `diff --stationarity` makes it") from None
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"{path} does not say how objects stay ({error!r}); `diff --stationarity` makes it") from None
    if of != digest:
        raise InputError(f"{path} is of a map with the digest {of[:12]}, this one has {(digest or 'none')[:12]}")
    return Stationarity(digest=of, counts=counts)


def _count(value: Any) -> float:
    count = float(value)
    if not (math.isfinite(count) and count >= 0):
        raise ValueError(f"a count of {count}")
    return count
