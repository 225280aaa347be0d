"""What became of every track of a run: the masks that went to it, what it was merged into, why it was dropped.

Made of decisions alone, so that a viewer that is told of them as they come and a command that reads them from a journal
tell the same.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from collections.abc import Iterable

    from hickory_stream.records import Decision, DropCause


@dataclass(frozen=True, kw_only=True, slots=True)
class Joined:
    """A mask that went to a track; `frame` is the index of its frame."""

    frame: int
    observation_index: int
    text: str


@dataclass(frozen=True, kw_only=True, slots=True)
class Turn:
    """Something else that happened to a track; `frame` is None at the end of the run."""

    frame: int | None
    text: str


@dataclass(frozen=True, kw_only=True, slots=True)
class Ending:
    """Why a track is not in the map: it was merged `into` another one, or dropped, by `cause`."""

    kind: Literal["merged", "dropped"]
    frame: int | None
    text: str
    into: int | None = None
    cause: DropCause | None = None


@dataclass(kw_only=True, slots=True)
class TrackFate:
    """The history of a track; `born` says how it came about, `ending` is None for one that is in the map."""

    id: int
    born: Turn
    masks: list[Joined] = field(default_factory=list)
    turns: list[Turn] = field(default_factory=list)
    ending: Ending | None = None

    @property
    def frames(self) -> list[int]:
        """The frames whose masks went to it, each once."""
        return list(dict.fromkeys(mask.frame for mask in self.masks))


class FateBook:
    """Takes decisions as they come."""

    def __init__(self) -> None:
        self.fates: dict[int, TrackFate] = {}
        self._homes: dict[tuple[int, int], int] = {}

    def add(self, frame: int | None, decisions: Iterable[Decision]) -> None:
        """Take the decisions of a keyframe by the index of its frame, None for those of the end."""
        for decision in decisions:
            if decision.object_id is not None:
                self._take(frame, decision.object_id, decision)

    def home(self, frame: int, observation_index: int) -> int | None:
        """Return the track that a mask went to, None where nothing is known of it."""
        return self._homes.get((frame, observation_index))

    def final(self, track_id: int) -> int | None:
        """Return what a track is in the end: itself, or what it was merged into; None where that was dropped."""
        seen = set()
        fate = self.fates.get(track_id)
        while fate is not None and fate.ending is not None and fate.id not in seen:
            seen.add(fate.id)
            fate = self.fates.get(fate.ending.into) if fate.ending.into is not None else None
        return None if fate is None else fate.id

    def last(self, track_id: int) -> TrackFate | None:
        """Return the history of what a track is in the end, dropped or not."""
        fate = self.fates.get(track_id)
        seen = set()
        while fate is not None and fate.ending is not None and fate.ending.into is not None and fate.id not in seen:
            seen.add(fate.id)
            fate = self.fates.get(fate.ending.into)
        return fate

    def _take(self, frame: int | None, track_id: int, decision: Decision) -> None:
        if decision.kind == "create" or (decision.kind == "split" and decision.other_id is not None):
            split = f"split off #{decision.other_id}: " if decision.kind == "split" else ""
            self.fates[track_id] = TrackFate(id=track_id, born=Turn(frame=frame, text=f"{split}{decision.text}"))
        fate = self.fates.setdefault(track_id, TrackFate(id=track_id, born=Turn(frame=frame, text="")))
        if decision.observation_index is not None and frame is not None:
            self._join(fate, frame, decision.observation_index, decision.text)
        elif decision.kind == "merge" and decision.other_id is not None:
            fate.turns.append(Turn(frame=frame, text=decision.text))
            gone = self.fates.setdefault(
                decision.other_id, TrackFate(id=decision.other_id, born=Turn(frame=frame, text=""))
            )
            _, _, reason = decision.text.partition(": ")
            gone.ending = Ending(kind="merged", frame=frame, text=reason, into=track_id)
        elif decision.kind == "drop":
            fate.ending = Ending(kind="dropped", frame=frame, text=decision.text, cause=decision.cause)
        elif decision.kind in ("phase", "shape") or (decision.kind == "split" and decision.other_id is None):
            fate.turns.append(Turn(frame=frame, text=decision.text))

    def _join(self, fate: TrackFate, frame: int, observation_index: int, text: str) -> None:
        before = self._homes.get((frame, observation_index))
        if before is not None and before != fate.id:
            # It was said of another track first, of which this one is a part no longer.
            kept = [m for m in self.fates[before].masks if (m.frame, m.observation_index) != (frame, observation_index)]
            self.fates[before].masks = kept
        self._homes[frame, observation_index] = fate.id
        fate.masks.append(Joined(frame=frame, observation_index=observation_index, text=text))
