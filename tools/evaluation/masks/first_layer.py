"""Playback of a log through perception and the core in one thread: layer 1 as `play` makes it, without shapes."""
# Masks are scored as they come in playback, each keyframe with the map as it is after the one before.

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from hickory_stream.config import MapperConfig
from hickory_stream.events import ComputeFeatures, Effect, Event, FeaturesReady, Publish, RequestShape, ShapeFailed
from hickory_stream.mapping.core import MapperCore
from hickory_stream.mapping.rules.keyframes import Keyframe, is_keyframe
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.perception.descriptor import ColorTextureDescriptor
from hickory_stream.perception.perceive import Perceived, features_of, perceive
from hickory_stream.ports import FeatureExtractor, Segmenter
from hickory_stream.records import Frame, MapPrior, MapSnapshot
from players import open_source


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PlayedKeyframe:
    """A keyframe as it was perceived with the prior of the map, and the map after it with metrics of the core."""

    frame: Frame
    prior: MapPrior | None
    perceived: Perceived
    snapshot: MapSnapshot
    metrics: Mapping[str, float]


def keyframes_of(log: Path | Sequence[Path], config: MapperConfig, max_keyframes: int | None = None) -> Iterator[Frame]:
    source = open_source(log)
    try:
        last, count = None, 0
        for raw in source.frames():
            if not is_keyframe(last, raw.stamp_ns, raw.world_from_camera, config.keyframes):
                continue
            last = Keyframe(stamp_ns=raw.stamp_ns, world_from_camera=raw.world_from_camera)
            yield raw.decode()
            count += 1
            if count == max_keyframes:
                return
    finally:
        source.close()


def play_first_layer(
    log: Path | Sequence[Path], *, config: MapperConfig | None = None, segmenter: Segmenter | None = None,
    extractor: FeatureExtractor | None = None, max_keyframes: int | None = None,
) -> Iterator[PlayedKeyframe]:  # fmt: skip
    """Yield every keyframe of a log with what perception and the core made of it; shapes are answered with failures."""
    config = config or MapperConfig()
    segmenter = segmenter or make_segmenter(config.perception)
    extractor = extractor or ColorTextureDescriptor()
    core = MapperCore(config.mapping)
    for frame in keyframes_of(log, config, max_keyframes):
        prior = core.prior()
        perceived = perceive(frame, prior, None, segmenter, config.perception, lattice=config.mapping.voxels)
        event = perceived.event(frame)

        def features(effect: ComputeFeatures, frame: Frame = frame, perceived: Perceived = perceived) -> FeaturesReady:
            patches = extractor.extract(frame.rgb)
            return features_of(effect, perceived.observations, patches, extractor.patch_px)

        published = answered(core, event, frame.stamp_ns, features)
        yield PlayedKeyframe(
            frame=frame, prior=prior, perceived=perceived, snapshot=published.snapshot, metrics=dict(published.metrics)
        )


def answered(
    core: MapperCore, event: Event, stamp_ns: int, features: Callable[[ComputeFeatures], FeaturesReady]
) -> Publish:
    """Give the core an event and the answers to its requests, at once; return its last publication."""
    waiting: list[Effect] = core.handle(event)
    published: Publish | None = None
    while waiting:
        effect = waiting.pop(0)
        if isinstance(effect, ComputeFeatures):
            waiting += core.handle(features(effect))
        elif isinstance(effect, RequestShape):
            failed = ShapeFailed(
                ticket=effect.ticket, object_id=effect.object_id, stamp_ns=stamp_ns, reason="not asked"
            )
            waiting += core.handle(failed)
        elif isinstance(effect, Publish):
            published = effect
    assert published is not None, "every keyframe ends with a publication"
    return published
