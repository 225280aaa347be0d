"""Construction of the segmenter, the feature extractor and the semantic model that the configuration names."""

from __future__ import annotations

from typing import TYPE_CHECKING, assert_never

from hickory_stream.perception.descriptor import ColorTextureDescriptor
from hickory_stream.perception.geometric_segmenter import GeometricSegmenter
from hickory_stream.perception.semantic_filter import FilteredSegmenter

if TYPE_CHECKING:
    from hickory_stream.perception.perceive import PerceptionConfig
    from hickory_stream.ports import FeatureExtractor, Segmenter, SemanticModel


def make_segmenter(config: PerceptionConfig) -> Segmenter:
    """Return the segmenter, with the semantic model's filter around it where there is one.

    Raises:
        ModelError: a network is missing, damaged, of another kind, or cannot run here.
        ConfigError: a class that is to be excluded is not in the model's table.
    """
    segmenter = _bare_segmenter(config)
    semantics = make_semantics(config)
    return segmenter if semantics is None else FilteredSegmenter(segmenter, semantics, config.semantic.exclude)


def make_extractor(config: PerceptionConfig) -> FeatureExtractor:
    """Return the extractor of patch features; raises `ModelError`."""
    match config.extractor:
        case "color_texture":
            return ColorTextureDescriptor()
        case "dinov2":
            from hickory_stream.perception.models.dinov2 import DinoExtractor
            from hickory_stream.perception.models.library import find_model
            from hickory_stream.perception.models.network import Network

            entry, path = find_model(config.dinov2.model, "dinov2")
            name = f"dinov2-{entry.sha256[:16]}"
            return DinoExtractor(
                Network(path, config.network), config.dinov2, name=name, warm_up=config.network.warm_up
            )
        case _:
            assert_never(config.extractor)


def make_semantics(config: PerceptionConfig) -> SemanticModel | None:
    """Return the semantic model, None if none is configured; raises `ModelError`."""
    if config.semantics == "none":
        return None
    from hickory_stream.perception.models.library import find_model
    from hickory_stream.perception.models.network import Network
    from hickory_stream.perception.models.semantic_graph import GraphSemantics

    entry, path = find_model(config.semantic.model, "oneformer" if config.semantics == "oneformer" else "semantic")
    return GraphSemantics(
        Network(path, config.network),
        entry.labels,
        short_px=config.semantic.short_px,
        panoptic=config.semantic.panoptic,
        warm_up=config.network.warm_up,
    )


def _bare_segmenter(config: PerceptionConfig) -> Segmenter:
    match config.segmenter:
        case "geometric":
            return GeometricSegmenter(config.geometric)
        case "network":
            from hickory_stream.perception.affinity.pixel_network import PixelNetwork
            from hickory_stream.perception.network_segmenter import NetworkSegmenter

            return NetworkSegmenter(PixelNetwork(), config.affinities, config.geometric)
        case "fastsam":
            from hickory_stream.perception.models.fastsam import FastSam, FastSamSegmenter
            from hickory_stream.perception.models.library import find_model
            from hickory_stream.perception.models.network import Network

            _, path = find_model(config.fastsam.model, "fastsam")
            network = FastSam(Network(path, config.network), config.fastsam, warm_up=config.network.warm_up)
            return FastSamSegmenter(
                network,
                masks=config.masks,
                surface=config.geometric.surface,
                structure=config.geometric.structure,
            )
        case _:
            assert_never(config.segmenter)
