"""Result of a fleet: each robot's map and joins, or why it is alone."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.answer import Alignment
from hickory_stream.fleet.finish import Finished, MergedFrame, why_alone
from hickory_stream.fleet.joins import JoinEvent, joined_since
from hickory_stream.fleet.messages import Ended


@dataclass(frozen=True, kw_only=True, slots=True)
class Joined:
    """A final alignment with another robot; `since_keyframe` None: only the finished maps were joined."""

    name: str
    num_pairs: int
    sigma_m: float
    sigma_rad: float
    since_keyframe: int | None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RobotResult:
    """Result of one robot; `map` is None without one.

    `frame` names the robot that defines its frame, itself if alone; `frame_from_robot` (4, 4) is None without a map.
    `reason` says why it is alone, "" if it is not; `notes` are losses of its log.
    """

    name: str
    map: Path | None
    digest: str | None
    num_keyframes: int
    num_objects: int
    is_finished: bool
    frame: str
    frame_from_robot: NDArray[np.float64] | None
    joined: tuple[Joined, ...]
    reason: str
    notes: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FleetResult:
    """All robots in the order of the fleet, the merged maps (largest first), and the joins."""

    robots: tuple[RobotResult, ...]
    merged: tuple[MergedFrame, ...]
    events: tuple[JoinEvent, ...]
    notes: tuple[str, ...]
    was_stopped: bool

    @property
    def is_whole(self) -> bool:
        """Whether every robot has a finished map with objects, and all are in one."""
        return all(robot.is_finished and robot.num_objects for robot in self.robots) and any(
            len(merged.names) == len(self.robots) for merged in self.merged
        )


def result_of(
    ended: Mapping[str, Ended],
    folders: Mapping[str, Path],
    keyframes: Mapping[str, int],
    finished: Finished,
    events: Sequence[JoinEvent],
) -> FleetResult:
    """Return the result of a fleet from the ends of its robots and the finished maps."""
    robots = tuple(
        _robot(name, one, folders[name], keyframes.get(name, 0), finished, events) for name, one in ended.items()
    )
    return FleetResult(
        robots=robots,
        merged=finished.merged,
        events=tuple(events),
        notes=_clock_notes(ended),
        was_stopped=any(one.was_stopped for one in ended.values()),
    )


def _robot(
    name: str, ended: Ended, folder: Path, num_keyframes: int, finished: Finished, events: Sequence[JoinEvent]
) -> RobotResult:
    saved = finished.maps.get(name)
    frame = next((frame for frame in finished.frames if name in frame.names), None)
    joined = (
        () if frame is None else tuple(_joined(name, pair, finished, events) for pair in frame.pairs if name in pair)
    )
    reason = ended.reason if saved is None else "" if joined else why_alone(name, finished.answers)
    lost = () if saved is None or not ended.reason else (ended.reason,)
    return RobotResult(
        name=name,
        map=folder if folder.is_dir() else None,
        digest=ended.digest,
        num_keyframes=num_keyframes,
        num_objects=0 if saved is None else len(saved.snapshot.objects),
        is_finished=ended.is_finished and saved is not None,
        frame=name if frame is None else frame.names[0],
        frame_from_robot=None if frame is None else frame.frame_from_robot[frame.names.index(name)],
        joined=joined,
        reason=reason or finished.problems.get(name, ""),
        notes=(*lost, *ended.notes),
    )


def _joined(name: str, pair: tuple[str, str], finished: Finished, events: Sequence[JoinEvent]) -> Joined:
    answer = finished.answers[pair]
    assert isinstance(answer, Alignment)
    return Joined(
        name=pair[1] if name == pair[0] else pair[0],
        num_pairs=len(answer.pairs),
        sigma_m=answer.translation_sigma_m,
        sigma_rad=answer.rotation_sigma_rad,
        since_keyframe=joined_since(events, *pair),
    )


def _clock_notes(ended: Mapping[str, Ended]) -> tuple[str, ...]:
    # Clocks need not overlap, but the timeline of stamps then has gaps.
    apart = [
        f"{a} and {b}"
        for (a, one), (b, other) in combinations(ended.items(), 2)
        if one.start_ns is not None
        and one.end_ns is not None
        and other.start_ns is not None
        and other.end_ns is not None
        and (one.end_ns < other.start_ns or other.end_ns < one.start_ns)
    ]
    text = f"the clocks of {', '.join(apart)} do not overlap; the timeline of keyframes shows them side by side"
    return (text,) if apart else ()
