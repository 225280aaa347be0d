"""The perception pipeline for one keyframe: from a frame to the event for the core."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hickory_stream.events import ComputeFeatures, FeaturesReady, FrameObserved
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.perception.coarse import coarse_frame
from hickory_stream.perception.descriptor import mask_feature
from hickory_stream.perception.geometric_segmenter import GeometricConfig
from hickory_stream.perception.models.dinov2 import DinoConfig
from hickory_stream.perception.models.fastsam import FastSamConfig
from hickory_stream.perception.models.network import NetworkConfig
from hickory_stream.perception.models.sam import SamConfig
from hickory_stream.perception.models.semantic_graph import SemanticConfig
from hickory_stream.perception.network_segmenter import NetworkJoinConfig
from hickory_stream.perception.observe import observe
from hickory_stream.perception.space import SpaceConfig, observe_space
from hickory_stream.ports import Segmenter
from hickory_stream.records import Frame, MapPrior, Observation, RejectedMask, Segmentation, SpaceObservation


@dataclass(frozen=True, kw_only=True, slots=True)
class PerceptionConfig:
    """The segmenter, the lifting of masks to 3D, and the observed space.

    Attributes:
        segmenter: `network` splits and joins fragments with the affinity network of the package; `geometric` joins
            them by trees alone; `fastsam` and `sam` are networks in the folder of models.
        extractor: the source of patch features: `color_texture` needs no weights; `dinov2` is a network.
        semantics: the model whose classes are votes for the room: `none`, `oneformer`, or another `graph` that gives
            scores or class ids.
    """

    segmenter: Literal["geometric", "network", "fastsam", "sam"] = "network"
    extractor: Literal["color_texture", "dinov2"] = "color_texture"
    semantics: Literal["none", "oneformer", "graph"] = "none"
    geometric: GeometricConfig = field(default_factory=GeometricConfig)
    affinities: NetworkJoinConfig = field(default_factory=NetworkJoinConfig)
    network: NetworkConfig = field(default_factory=NetworkConfig)
    fastsam: FastSamConfig = field(default_factory=FastSamConfig)
    sam: SamConfig = field(default_factory=SamConfig)
    dinov2: DinoConfig = field(default_factory=DinoConfig)
    semantic: SemanticConfig = field(default_factory=SemanticConfig)
    space: SpaceConfig = field(default_factory=SpaceConfig)

    @property
    def has_network(self) -> bool:
        """Whether an installed network gives masks, classes or features."""
        return self.segmenter in ("fastsam", "sam") or self.semantics != "none" or self.extractor != "color_texture"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Perceived:
    """The results of perception for a keyframe."""

    segmentation: Segmentation
    observations: tuple[Observation, ...]
    rejected: tuple[RejectedMask, ...]
    space: SpaceObservation

    def event(self, frame: Frame) -> FrameObserved:
        """Return the event for the core."""
        return FrameObserved(
            frame_index=frame.index,
            stamp_ns=frame.stamp_ns,
            world_from_camera=frame.world_from_camera,
            observations=self.observations,
            space=self.space,
            rejected=self.rejected,
            coarse=coarse_frame(frame.depth_m, self.segmentation.structure, frame.camera),
            degenerate=frame.degenerate,
            depth_law=frame.sensor.law,
        )


def perceive(
    frame: Frame,
    prior: MapPrior | None,
    prepared: object,
    segmenter: Segmenter,
    config: PerceptionConfig,
    *,
    lattice: Lattice,
    free_keys: NDArray[np.int64] | None = None,
) -> Perceived:
    """Return the results of perception for a keyframe; `prior` is the map so far.

    `prepared`, `free_keys`: results of the segmenter's `prepare` and of `free_space`, None if they were not called.
    """
    segmentation = segmenter.segment(frame, prior, prepared)
    observations, rejected = observe(frame, segmentation, lattice)
    return Perceived(
        segmentation=segmentation,
        observations=observations,
        rejected=rejected,
        space=observe_space(frame, segmentation, config.space, lattice, free_keys),
    )


def features_of(
    effect: ComputeFeatures, observations: Sequence[Observation], patches: NDArray[np.float32], patch_px: int
) -> FeaturesReady:
    """Return the features that the core requests of a keyframe, pooled from its (h, w, D) patches."""
    features = tuple(mask_feature(observations[i], patches, patch_px) for i in effect.observation_indices)
    return FeaturesReady(frame_index=effect.frame_index, features=features)
