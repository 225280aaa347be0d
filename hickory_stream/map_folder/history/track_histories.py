"""History of every track of a run: masks, merges, splits, and why it was dropped.

It is derived from decisions alone, so that a viewer of a running map and a command with a journal agree.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from collections.abc import Iterable

    from hickory_stream.records import Decision, DropCause


@dataclass(frozen=True, kw_only=True, slots=True)
class Joined:
    """A mask that was associated with a track; `frame` is the index of its frame."""

    frame: int
    observation_index: int
    text: str


@dataclass(frozen=True, kw_only=True, slots=True)
class Turn:
    """Any other event in the history of a track; `frame` is None at the end of the run."""

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
class TrackHistory:
    """The history of a track."""

    id: int
    born: Turn
    masks: list[Joined] = field(default_factory=list)
    turns: list[Turn] = field(default_factory=list)
    #: Where it became a fixture, or an object again, and its kind at the end.
    changes: list[Turn] = field(default_factory=list)
    #: None for a track in the map.
    ending: Ending | None = None

    @property
    def frames(self) -> list[int]:
        """The frames with masks of the track, each once."""
        return list(dict.fromkeys(mask.frame for mask in self.masks))


class TrackHistories:
    """The histories `by_id`, built from decisions in their order."""

    def __init__(self) -> None:
        self.by_id: dict[int, TrackHistory] = {}
        self._homes: dict[tuple[int, int], int] = {}

    def add(self, frame: int | None, decisions: Iterable[Decision]) -> None:
        """Add the decisions of a keyframe by its frame's index, None for those of the end."""
        for decision in decisions:
            if decision.object_id is not None:
                self._take(frame, decision.object_id, decision)

    def home(self, frame: int, observation_index: int) -> int | None:
        """Return the track that a mask was associated with, None if it is unknown."""
        return self._homes.get((frame, observation_index))

    def final(self, track_id: int) -> int | None:
        """Return the track of the map that a track is, or was merged into; None if that was dropped."""
        last = self.last(track_id)
        return last.id if last is not None and last.ending is None else None

    def last(self, track_id: int) -> TrackHistory | None:
        """Return the history of a track, or of the last one that it was merged into, dropped or not."""
        history = self.by_id.get(track_id)
        seen = set()
        while history and history.ending and history.ending.into is not None and history.id not in seen:
            seen.add(history.id)
            history = self.by_id.get(history.ending.into)
        return history

    def _take(self, frame: int | None, track_id: int, decision: Decision) -> None:
        if decision.kind in ("create", "split"):
            split = f"split off #{decision.other_id}: " if decision.kind == "split" else ""
            self.by_id[track_id] = TrackHistory(id=track_id, born=Turn(frame=frame, text=f"{split}{decision.text}"))
        history = self.by_id.setdefault(track_id, TrackHistory(id=track_id, born=Turn(frame=frame, text="")))
        if decision.observation_index is not None and frame is not None:
            self._join(history, frame, decision.observation_index, decision.text)
        elif decision.kind == "merge" and decision.other_id is not None:
            history.turns.append(Turn(frame=frame, text=decision.text))
            other = decision.other_id
            gone = self.by_id.setdefault(other, TrackHistory(id=other, born=Turn(frame=frame, text="")))
            _, _, reason = decision.text.partition(": ")
            gone.ending = Ending(kind="merged", frame=frame, text=reason, into=track_id)
        elif decision.kind == "part":
            history.turns.append(Turn(frame=frame, text=f"parted from #{decision.other_id}: {decision.text}"))
            history.ending = None
        elif decision.kind == "drop":
            history.ending = Ending(kind="dropped", frame=frame, text=decision.text, cause=decision.cause)
        elif decision.kind in ("kind", "room"):
            history.changes.append(Turn(frame=frame, text=decision.text))
        elif decision.kind in ("phase", "shape", "trim"):
            history.turns.append(Turn(frame=frame, text=decision.text))

    def _join(self, history: TrackHistory, frame: int, observation_index: int, text: str) -> None:
        before = self._homes.get((frame, observation_index))
        if before is not None and before != history.id:
            # The track was split off the one that had the mask first.
            kept = [m for m in self.by_id[before].masks if (m.frame, m.observation_index) != (frame, observation_index)]
            self.by_id[before].masks = kept
        self._homes[frame, observation_index] = history.id
        history.masks.append(Joined(frame=frame, observation_index=observation_index, text=text))
