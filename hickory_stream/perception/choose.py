"""Construction of the configured segmenter, feature extractor and semantic model."""

from typing import assert_never

from hickory_stream.perception.descriptor import ColorTextureDescriptor
from hickory_stream.perception.geometric_segmenter import GeometricSegmenter
from hickory_stream.perception.models.fastsam import MaskNetwork
from hickory_stream.perception.models.library import Kind, ModelEntry
from hickory_stream.perception.models.network import Network
from hickory_stream.perception.network_segmenter import NetworkSegmenter
from hickory_stream.perception.perceive import PerceptionConfig
from hickory_stream.perception.semantic_filter import FilteredSegmenter
from hickory_stream.ports import FeatureExtractor, Segmenter


def make_segmenter(config: PerceptionConfig) -> Segmenter:
    """Return the segmenter, filtered by the semantic model if there is one.

    Raises:
        ModelError: a network is missing, damaged, of another kind, or cannot run here.
        ConfigError: an excluded class is not in the model's table.
    """
    segmenter = _bare_segmenter(config)
    if config.semantics == "none":
        return segmenter
    from hickory_stream.perception.models.semantic_graph import GraphSemantics

    semantic = config.semantic
    entry, network = _network(config, semantic.model, "oneformer" if config.semantics == "oneformer" else "semantic")
    warm_up, panoptic = config.network.warm_up, semantic.panoptic
    model = GraphSemantics(network, entry.labels, short_px=semantic.short_px, panoptic=panoptic, warm_up=warm_up)
    return FilteredSegmenter(segmenter, model, semantic.exclude)


def make_extractor(config: PerceptionConfig) -> FeatureExtractor:
    """Return the extractor of patch features; raises `ModelError`."""
    match config.extractor:
        case "color_texture":
            return ColorTextureDescriptor()
        case "dinov2":
            from hickory_stream.perception.models.dinov2 import DinoExtractor

            entry, network = _network(config, config.dinov2.model, "dinov2")
            name = f"dinov2-{entry.sha256[:16]}"
            return DinoExtractor(network, config.dinov2, name=name, warm_up=config.network.warm_up)
        case _:
            assert_never(config.extractor)


def _network(config: PerceptionConfig, name: str, kind: Kind) -> tuple[ModelEntry, Network]:
    from hickory_stream.perception.models.library import find_model
    from hickory_stream.perception.models.network import Network

    entry, path = find_model(name, kind)
    return entry, Network(path, config.network)


def _bare_segmenter(config: PerceptionConfig) -> Segmenter:
    match config.segmenter:
        case "geometric":
            return GeometricSegmenter(config.geometric)
        case "network":
            return _own_network(config)
        case "fastsam":
            from hickory_stream.perception.models.fastsam import FastSam

            _, network = _network(config, config.fastsam.model, "fastsam")
            return _of_masks(config, FastSam(network, config.fastsam, warm_up=config.network.warm_up))
        case "sam":
            from hickory_stream.perception.models.sam import open_sam

            entry, encoder = _network(config, config.sam.model, "sam")
            return _of_masks(config, open_sam(entry, encoder, config.network, config.sam))
        case _:
            assert_never(config.segmenter)


def _of_masks(config: PerceptionConfig, network: MaskNetwork) -> Segmenter:
    from hickory_stream.perception.models.fastsam import FastSamSegmenter

    return FastSamSegmenter(network, _own_network(config))


def _own_network(config: PerceptionConfig) -> NetworkSegmenter:
    from hickory_stream.perception.affinity.pixel_network import PixelNetwork

    return NetworkSegmenter(PixelNetwork(), config.affinities, config.geometric)
