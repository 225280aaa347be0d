"""Repeated mapping of one log to layer 1 with one setting changed, from its keyframes or from recorded observations.

What does not depend on the map is computed once: the keyframes, what the segmenter prepares of them, and, for changes
of the mapping, the events of a first run. With those, perception's prior stays that of the first run, although a
changed map would have told another: an approximation, without which a run takes six times as long.
Shapes are answered with failures, so that the box of an object is its track's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.evaluation.match import TrueSurfaces
from hickory_stream.evaluation.truth import load_truth
from hickory_stream.events import FeaturesReady, SourceEnded
from hickory_stream.mapping.core import MapperCore
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.perception.perceive import perceive
from hickory_stream.records import MapSnapshot, MaskFeature
from tools.benchmarks.first_layer import answered, keyframes_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from hickory_stream.config import MapperConfig
    from hickory_stream.events import ComputeFeatures, FrameObserved
    from hickory_stream.records import Frame
    from tools.benchmarks.foreign_logs import WorldLog
    from tools.benchmarks.rule_switches import Way

# No box depends on what a feature is.
_FEATURE, _VARIANCE = np.zeros(8, dtype=np.float32), 0.5
_NOTHING = MapSnapshot(revision=0, stamp_ns=0, submaps=(), objects=())


@dataclass(frozen=True, kw_only=True, slots=True)
class Counts:
    """How many of `truth` true objects have a box of IoU 0.25 and 0.5 among `objects` (less those of ignored truth).

    `tracks` objects lie on the `tracked` true ones that have any.
    """

    truth: int
    found_25: int
    found_50: int
    objects: int
    tracked: int
    tracks: int

    def __add__(self, other: Counts) -> Counts:
        """Return the counts of two logs together."""
        return Counts(**{name: getattr(self, name) + getattr(other, name) for name in self.__slots__})


class _QuietCore(MapperCore):
    """A core that shows its map at the end alone: what it decides does not depend on what it shows."""

    is_quiet = True

    def snapshot(self) -> MapSnapshot:
        return _NOTHING if self.is_quiet else super().snapshot()


class RuleLog:
    """A log, every `step`-th of its keyframes, and what a first run made of them."""

    def __init__(self, log: WorldLog, config: MapperConfig, step: int = 1) -> None:
        self._truth = TrueSurfaces(load_truth(log.truth))
        self._frames: list[Frame] = list(keyframes_of(log.log, config))[::step]
        segmenter = make_segmenter(config.perception)
        self._prepared = [segmenter.prepare(frame) for frame in self._frames]
        self._events: list[FrameObserved] = []

        def kept(core: MapperCore) -> Iterable[FrameObserved]:
            for event in self._events_of(core, config, is_prepared=True):
                self._events.append(event)
                yield event

        self.baseline = self._counts(config, kept)

    def counts(self, config: MapperConfig, way: Way) -> Counts:
        """Return what a map has that is made in a way by a configuration."""
        if way == "perceived":
            return self._counts(config, lambda _: self._events)
        return self._counts(config, lambda core: self._events_of(core, config, is_prepared=way == "prepared"))

    def _events_of(self, core: MapperCore, config: MapperConfig, *, is_prepared: bool) -> Iterable[FrameObserved]:
        """Yield the keyframes as they are perceived with the map as it is: whoever asks for one gave it all before."""
        perception = config.perception
        segmenter = make_segmenter(perception)
        for frame, prepared in zip(self._frames, self._prepared, strict=True):
            seen = perceive(
                frame,
                core.prior(),
                prepared if is_prepared else None,
                segmenter,
                perception,
                lattice=config.mapping.voxels,
            )
            yield replace(seen.event(frame), coarse=None)

    def _counts(self, config: MapperConfig, events_of: Callable[[MapperCore], Iterable[FrameObserved]]) -> Counts:
        # A sketch is for people to look at.
        core = _QuietCore(replace(config.mapping, track=replace(config.mapping.track, sketch_growth=100.0)))
        stamp_ns = 0
        for event in events_of(core):
            answered(core, event, event.stamp_ns, _features)
            stamp_ns = event.stamp_ns
        answered(core, SourceEnded(stamp_ns=stamp_ns), stamp_ns, _features)
        core.is_quiet = False
        score = self._truth.score(core.snapshot(), {})
        counting = [row for row in score.truth if row.counts]
        right = {row.map_id for row in counting} - {None}
        tracks = [len(row.track_ids) for row in counting if row.track_ids]
        return Counts(
            truth=len(counting),
            found_25=len(right),
            found_50=sum(row.strict_map_id is not None for row in counting),
            objects=score.num_objects - len(set(score.ignored_ids) - right),
            tracked=len(tracks),
            tracks=sum(tracks),
        )


def _features(effect: ComputeFeatures) -> FeaturesReady:
    features = tuple(
        MaskFeature(observation_index=i, pooled=_FEATURE, variance=_VARIANCE) for i in effect.observation_indices
    )
    return FeaturesReady(frame_index=effect.frame_index, features=features)
