"""How the robots' maps grow: what each sends, and rounds in which all of them have grown as far as one another.

Rounds count keyframes, never time: round k is what each robot's map was after k times so many keyframes, or at its end.
Whichever robot is mapped faster, before or after another, the rounds are the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.arrays import freeze
from hickory_stream.records import Phase

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from hickory_stream.records import FrameReport, MapSnapshot, TrackedObject

# More of an object's points than alignment looks at, and no more than need be sent.
_MAX_POINTS = 2000


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class GrownMap:
    """A robot's map after a number of keyframes; the clouds of `snapshot` are thinned.

    `world_from_camera` (N, 4, 4) are the camera's poses since the map that was sent before.
    """

    keyframes: int
    snapshot: MapSnapshot
    extractor: str
    world_from_camera: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze(self, "world_from_camera", np.float64, (None, 4, 4))


class GrowthSink:
    """A sink that sends the map after every so many keyframes, and once more at its end."""

    def __init__(self, every_keyframes: int, extractor: str, send: Callable[[GrownMap], None]) -> None:
        self._every = every_keyframes
        self._extractor = extractor
        self._send = send
        self._keyframes = 0
        self._poses: list[NDArray[np.float64]] = []
        self._unsent: MapSnapshot | None = None

    def show(self, report: FrameReport) -> None:
        """Take a report; sends the map where it is time."""
        if report.snapshot is None:
            return
        self._unsent = report.snapshot
        if report.segmentation is None:  # the report after the last frame: the map as it is finished
            return
        self._keyframes += 1
        self._poses.append(report.world_from_camera)
        if self._keyframes % self._every == 0:
            self._send_map(report.snapshot)

    def close(self) -> None:
        """Send what has changed since."""
        if self._unsent is not None:
            self._send_map(self._unsent)

    def _send_map(self, snapshot: MapSnapshot) -> None:
        poses = np.array(self._poses, dtype=np.float64).reshape(-1, 4, 4)
        known = tuple(_thinned(item) for item in snapshot.objects if item.phase is not Phase.TENTATIVE)
        self._send(
            GrownMap(
                keyframes=self._keyframes,
                snapshot=replace(snapshot, objects=known),
                extractor=self._extractor,
                world_from_camera=poses,
            )
        )
        self._poses, self._unsent = [], None


def _thinned(item: TrackedObject) -> TrackedObject:
    if len(item.points_world) <= _MAX_POINTS:
        return item
    kept = np.linspace(0, len(item.points_world) - 1, _MAX_POINTS).astype(np.int64)
    return replace(item, points_world=item.points_world[kept], colors=item.colors[kept])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Round:
    """The newest map of each robot that has one, by name, and which of them have grown since the round before."""

    keyframe: int
    maps: Mapping[str, GrownMap]
    grown: tuple[str, ...]


class Rounds:
    """Collects what the robots send; where it `waits`, a round needs all robots, else whichever has grown.

    Robots that are live wait for nobody.
    """

    def __init__(self, names: Sequence[str], *, waits: bool) -> None:
        self._names = tuple(names)
        self._waits = waits
        self._waiting: dict[str, list[GrownMap]] = {name: [] for name in names}
        self._ended: set[str] = set()
        self._newest: dict[str, GrownMap] = {}

    def add(self, name: str, grown: GrownMap) -> None:
        """Take a map of a robot, the next one."""
        self._waiting[name].append(grown)

    def end(self, name: str) -> None:
        """Take note that a robot sends no more."""
        self._ended.add(name)

    def complete(self) -> Iterator[Round]:
        """Yield the rounds that have become complete, each once."""
        while any(self._waiting.values()):
            if self._waits and any(not self._waiting[name] and name not in self._ended for name in self._names):
                return
            grown = tuple(name for name in self._names if self._waiting[name])
            for name in grown:
                self._newest[name] = self._waiting[name].pop(0)
            maps = {name: self._newest[name] for name in self._names if name in self._newest}
            yield Round(keyframe=max(one.keyframes for one in maps.values()), maps=maps, grown=grown)
