"""The history of a track in words, and texts of consecutive frames."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from hickory_stream.map_folder.history.track_histories import TrackHistories, TrackHistory


@dataclass(frozen=True, kw_only=True, slots=True)
class TrackStory:
    """The history of a track: its first frame, its keyframes, and its end ("" if it is live)."""

    id: int
    first_frame: int | None
    born: str
    num_keyframes: int
    turns: tuple[str, ...]
    #: when it became a fixture, or an object again, and its kind at the end
    changes: tuple[str, ...]
    ending: str
    #: object of the map that it became, itself or by merging; None for a dropped track
    map_id: int | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Stretch:
    """Consecutive keyframes with equal text: first and last frame, and their number."""

    first_frame: int
    last_frame: int
    num_keyframes: int
    text: str


def track_story(history: TrackHistory, map_id: int | None) -> TrackStory:
    """Return a track's history in words."""
    ending = history.ending
    text = ""
    if ending is not None:
        at = when(ending.frame)
        text = (
            f"merged into #{ending.into} {at}: {ending.text}"
            if ending.kind == "merged"
            else f"dropped {at}: {ending.text}"
        )
    return TrackStory(
        id=history.id,
        first_frame=history.born.frame,
        born=history.born.text,
        num_keyframes=len(history.frames),
        turns=tuple(f"{when(t.frame)}: {t.text}" for t in history.turns),
        changes=tuple(f"{when(t.frame)} {t.text}" for t in history.changes),
        ending=text,
        map_id=map_id,
    )


def stretches_of(texts: Iterable[tuple[int, str]]) -> tuple[Stretch, ...]:
    """Return the texts of frames; consecutive frames of equal text are joined."""
    stretches: list[Stretch] = []
    for frame, text in texts:
        if stretches and stretches[-1].text == text:
            last = stretches[-1]
            stretches[-1] = replace(last, last_frame=frame, num_keyframes=last.num_keyframes + 1)
        else:
            stretches.append(Stretch(first_frame=frame, last_frame=frame, num_keyframes=1, text=text))
    return tuple(stretches)


def ending_text(histories: TrackHistories, track_id: int) -> str:
    """Return how a track ended, in a phrase."""
    last = histories.last(track_id)
    if last is None:
        return f"#{track_id}, of which nothing is known"
    through = f" (merged into #{last.id})" if last.id != track_id else ""
    if last.ending is None:
        return f"#{track_id}{through}, which is in the map"
    return f"#{track_id}{through}, dropped {when(last.ending.frame)}: {last.ending.text}"


def when(frame: int | None) -> str:
    """Return the time of an event in words, from its frame index; None is the end of the log."""
    return "at the end" if frame is None else f"in frame {frame}"
