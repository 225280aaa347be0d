"""Growing maps of robots: what each sends, and rounds of equal numbers of keyframes.

Round k has each robot's map after k times `every_keyframes`, or at its end, however fast each is mapped.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.arrays import freeze
from hickory_stream.records import FrameReport, MapSnapshot, Phase, TrackedObject

# More of an object's points than alignment looks at, and no more than need be sent.
_MAX_POINTS = 2000


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class GrownMap:
    """A robot's map after a number of keyframes, with thinned clouds.

    `world_from_camera` (N, 4, 4) are the camera's poses since the previous map.
    """

    keyframes: int
    snapshot: MapSnapshot
    extractor: str
    world_from_camera: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze(self, "world_from_camera", np.float64, (None, 4, 4))


class GrowthSink:
    """Sends the map after every `every_keyframes`, and once more at its end."""

    def __init__(self, every_keyframes: int, extractor: str, send: Callable[[GrownMap], None]) -> None:
        self._every = every_keyframes
        self._extractor = extractor
        self._send = send
        self._keyframes = 0
        self._poses: list[NDArray[np.float64]] = []
        self._unsent: MapSnapshot | None = None

    def show(self, report: FrameReport) -> None:
        """Keep a report; send the map when it is due."""
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
        """Send the remaining changes."""
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
    """The newest map of each robot by name, and the names of maps that grew since the previous round."""

    keyframe: int
    maps: Mapping[str, GrownMap]
    grown: tuple[str, ...]


class Rounds:
    """Collects maps into rounds; with `waits` a round needs all robots, without (live) any that has grown."""

    def __init__(self, names: Sequence[str], *, waits: bool) -> None:
        self._names = tuple(names)
        self._waits = waits
        self._waiting: dict[str, list[GrownMap]] = {name: [] for name in names}
        self._ended: set[str] = set()
        self._newest: dict[str, GrownMap] = {}

    def add(self, name: str, grown: GrownMap) -> None:
        """Add the next map of a robot."""
        self._waiting[name].append(grown)

    def end(self, name: str) -> None:
        """Mark a robot as ended."""
        self._ended.add(name)

    def complete(self) -> Iterator[Round]:
        """Yield newly complete rounds."""
        while any(self._waiting.values()):
            if self._waits and any(not self._waiting[name] and name not in self._ended for name in self._names):
                return
            grown = tuple(name for name in self._names if self._waiting[name])
            for name in grown:
                self._newest[name] = self._waiting[name].pop(0)
            maps = {name: self._newest[name] for name in self._names if name in self._newest}
            yield Round(keyframe=max(one.keyframes for one in maps.values()), maps=maps, grown=grown)
