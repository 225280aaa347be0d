"""What became of the candidates of a run: every track that it began is in the map, was merged, or was dropped."""

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hickory_stream.errors import MapFolderError
from hickory_stream.journal.reader import Journal
from hickory_stream.journal.step import StepKind
from hickory_stream.map_folder.history.registration_history import steps_behind
from hickory_stream.map_folder.history.track_histories import TrackHistories

_PLAIN = {
    "never confirmed": "seen too briefly",
    "looked through": "later frames show free space there",
    "structure": "part of a floor, a wall or a ceiling",
    "in structure": "a piece of a wall or of furniture as large",
}
_CAUSES_LISTED = 3


@dataclass(frozen=True, kw_only=True, slots=True)
class Candidates:
    """Numbers of candidates; `made` is the sum of `kept`, `merged` and `dropped`, `causes` has the commonest first."""

    made: int
    kept: int
    merged: int
    dropped: int
    causes: dict[str, int]

    def text(self) -> str:
        """Return one line."""
        dropped = f"{self.dropped} dropped ({self.why_dropped()})" if self.dropped else "none dropped"
        return f"{self.made} candidates became {self.kept} objects: {self.merged} merged as parts of others, {dropped}"

    def why_dropped(self) -> str:
        """Return the commonest causes."""
        listed = list(self.causes.items())[:_CAUSES_LISTED]
        return "; ".join(f"{number} {_PLAIN.get(cause, cause)}" for cause, number in listed)


def candidates_of(path: Path, object_ids: Collection[int]) -> Candidates | None:
    """Return what became of the candidates of a map folder's run, of which `object_ids` are in the map.

    None without a journal that holds its decisions. A stopped run may still track parts of the room: they are dropped.
    """
    histories = TrackHistories()
    try:
        with Journal(path) as journal:
            for index in steps_behind(journal, len(journal)):
                told = journal.told(index)
                if told is not None:
                    histories.add(index, told.decisions)
                elif journal.step(index).kind is StepKind.KEYFRAME:
                    return None
    except MapFolderError:
        return None
    gone = [history.ending for history in histories.by_id.values() if history.id not in object_ids]
    causes = Counter(
        "structure" if ending is None or ending.cause is None else ending.cause
        for ending in gone
        if ending is None or ending.kind == "dropped"
    )
    return Candidates(
        made=len(histories.by_id),
        kept=len(histories.by_id) - len(gone),
        merged=len(gone) - causes.total(),
        dropped=causes.total(),
        causes=dict(causes.most_common()),
    )


def why_no_objects(ledger: Mapping[str, Any], candidates: Candidates | None) -> str:
    """Return in one line why a run with this ledger and these candidates has no objects."""
    frames = ledger.get("frames", {})
    keyframes, kept_out = frames.get("keyframes", 0), frames.get("keyframes_kept_out", 0)
    blind = frames.get("keyframes_without_depth", 0)
    reasons = [f"found no object in {keyframes} {'keyframe' if keyframes == 1 else 'keyframes'}"]
    if kept_out:
        reasons.append(
            f"{kept_out / (keyframes + kept_out):.0%} of all keyframes did not fit the map and were left out"
        )
    if blind:
        reasons.append(f"{blind / keyframes:.0%} of them have no depth")
    if candidates is not None and candidates.made:
        merged = f" and {candidates.merged} merged with these" if candidates.merged else ""
        dropped = f"{candidates.dropped} dropped ({candidates.why_dropped()})"
        reasons.append(f"of {candidates.made} candidates {dropped}{merged}")
    elif candidates is not None:
        reasons.append("no part of an image stood out from floor and walls")
    return "; ".join([*reasons, "`hickory-stream doctor LOG` examines depth, poses and calibration"])
