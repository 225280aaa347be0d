"""The segmenter with a network of its own: fragments by geometry, divided and joined by the network's affinities.

By itself the network joins by average linkage; trees have its odds among their inputs, or are shifted by them. Its
objectness can correct what geometry takes for structure, both ways.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import cv2
import numpy as np

from hickory_stream.geometry import portable
from hickory_stream.perception.average_linkage import averaged
from hickory_stream.perception.fragment_odds import fragment_odds
from hickory_stream.perception.geometric import GeometricSegmenter
from hickory_stream.perception.join import region_graph_of, rounds
from hickory_stream.perception.odds_split import SplitConfig, divided_by_odds
from hickory_stream.perception.pixel_network import ODDS_UNIT, ODDS_ZERO, THING, PixelOdds
from hickory_stream.perception.trees import embedded_trees
from hickory_stream.ranges import Ranged, number

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from hickory_stream.perception.fragment_odds import FragmentOdds
    from hickory_stream.perception.geometric import Fragments, GeometricConfig
    from hickory_stream.perception.pixel_network import PixelNetwork
    from hickory_stream.perception.surface import Surface
    from hickory_stream.perception.trees import Trees
    from hickory_stream.records import Frame, ObservedSpace, Segmentation

_SURE = 1e-6


@dataclass(frozen=True, kw_only=True, slots=True)
class NetworkJoinConfig(Ranged):
    """How the network's odds are used; log-odds are natural, the network's lie between -8 and 8.

    Attributes:
        join: what joins fragments: the `network` alone, the `trees` alone, `both` by weights set by hand, or trees that
            have `learned` what the network's odds are worth, the forest `odds`.
        learned_probability: those join two groups from this probability of being one thing.
        split: when the network divides fragments that geometry and colour left whole.
        least_odds: the network alone joins two groups from this mean log-odds.
        far_weight: what a pair of pixels at the network's long distances counts against one at the short ones.
        trees_weight: of the trees' log-odds, where both join.
        near_weight: of the mean log-odds at short distances, where both join.
        far_odds_weight: of those at long distances, where both join.
        odds_shift: what is added where the network says anything: it was trained to be surer of seams than they are
            frequent.
        structure_odds: a pixel is structure whatever geometry says where it is no thing by more than this; 8: never.
        thing_odds: a pixel is none where it is a thing by more than this; 8: never.
    """

    join: Literal["network", "trees", "both", "learned"] = "learned"
    learned_probability: float = number(0.35, 0, 1, "probability")
    split: SplitConfig = field(default_factory=SplitConfig)
    least_odds: float = number(0.0, -8, 8, "log-odds")
    far_weight: float = number(0.25, 0, 10, "pairs")
    trees_weight: float = number(0.6, 0, 10, "weight")
    near_weight: float = number(0.4, 0, 10, "weight")
    far_odds_weight: float = number(0.45, 0, 10, "weight")
    odds_shift: float = number(1.6, -8, 8, "log-odds")
    structure_odds: float = number(8.0, 0, 8, "log-odds")
    thing_odds: float = number(8.0, 0, 8, "log-odds")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Prepared:
    """What is found in a frame without the map: its surface, and what the network says of its pixels."""

    surface: Surface
    odds: PixelOdds


class NetworkSegmenter:
    """A `Segmenter` with a network: it has no state but its configuration.

    `trees` tell what is one thing where they are asked; None: those of the package, `odds` where they have `learned`.
    """

    def __init__(
        self, network: PixelNetwork, config: NetworkJoinConfig, geometric: GeometricConfig, trees: Trees | None = None
    ) -> None:
        self._network = network
        self._config = config
        self._join = geometric.join
        if config.join == "learned":
            self._join = replace(geometric.join, forest="odds", probability=config.learned_probability)
        self._trees = trees or embedded_trees(self._join.forest)
        self._geometric = GeometricSegmenter(geometric, self._trees)

    def prepare(self, frame: Frame) -> Prepared:
        """Return the surface of a frame and the network's odds; raises `ModelError`."""
        surface = self._geometric.prepare(frame)
        return Prepared(surface=surface, odds=self._network.odds(surface, None))

    def segment(self, frame: Frame, prior: ObservedSpace | None = None, prepared: object = None) -> Segmentation:
        """Return the instances and the structure of a frame; `prior` is the space as the map knows it."""
        found = prepared if isinstance(prepared, Prepared) else self.prepare(frame)
        pieces = self.fragments(frame, prior, found)
        return self.segmentation(frame, pieces, self._joined(pieces, found.odds))

    def segmentation(self, frame: Frame, pieces: Fragments, labels: NDArray[np.int32]) -> Segmentation:
        """Return what is said of a frame whose fragments were joined into the masks `labels` (h, w), 0 = none."""
        return self._geometric.segmentation(frame, pieces, labels)

    def fragments(self, frame: Frame, prior: ObservedSpace | None = None, prepared: object = None) -> Fragments:
        """Return the pieces that a frame falls into, before any are joined."""
        found = prepared if isinstance(prepared, Prepared) else self.prepare(frame)
        room = self._geometric.room(found.surface, prior)
        structure = corrected_structure(room.structure, found, self._config)
        pieces = self._geometric.divided(found.surface, replace(room, structure=structure))
        return replace(pieces, labels=divided_by_odds(pieces.labels, found.odds, self._config.split))

    def _joined(self, pieces: Fragments, odds: PixelOdds) -> NDArray[np.int32]:
        labels, config = pieces.labels, self._config
        if not labels.any():
            return labels
        of_fragments = fragment_odds(labels, odds)
        if config.join == "network":
            return averaged(of_fragments, config.least_odds, config.far_weight).astype(np.int32)[labels]
        return self._joined_in_rounds(pieces, of_fragments)

    def _joined_in_rounds(self, pieces: Fragments, odds: FragmentOdds) -> NDArray[np.int32]:
        config, labels = self._config, pieces.labels

        def probabilities(features: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
            by_trees = self._trees.probabilities(features)
            return combined(by_trees, features, config) if config.join == "both" else by_trees

        graph = region_graph_of(pieces.surface, labels, pieces.supports, pieces.room, self._join)
        assert graph is not None, "there are fragments"
        numbers = np.arange(len(graph.regions.pixels))
        for step in rounds(graph, probabilities, self._join, odds):
            numbers = step.numbers
        return numbers.astype(np.int32)[labels]


def combined(
    by_trees: NDArray[np.float64], features: Mapping[str, NDArray[np.float64]], config: NetworkJoinConfig
) -> NDArray[np.float64]:
    """Return (K,) the probability that each pair is one thing, by the trees and by the network's odds together.

    Where the network says nothing of a pair, the trees decide alone.
    """
    likely = np.clip(by_trees, _SURE, 1 - _SURE)
    near, far = features["odds_near"], features["odds_far"]
    says = np.isfinite(near) | np.isfinite(far)
    odds = config.trees_weight * (portable.log(likely) - portable.log(1 - likely)) + config.odds_shift
    odds = odds + config.near_weight * np.nan_to_num(near) + config.far_odds_weight * np.nan_to_num(far)
    return np.where(says, 1 / (1 + portable.exp(-odds)), by_trees)


def corrected_structure(structure: NDArray[np.bool_], found: Prepared, config: NetworkJoinConfig) -> NDArray[np.bool_]:
    """Return (H, W) what is structure where the network is sure, and elsewhere what was taken for it."""
    height, width = structure.shape
    odds = cv2.blur(found.odds.odds[THING], (3, 3))
    at_full_size = np.repeat(np.repeat(odds, 2, axis=0), 2, axis=1)[:height, :width].astype(np.float64)
    thing = (at_full_size - ODDS_ZERO) / ODDS_UNIT
    has_surface = np.isfinite(found.surface.depth_m)
    return np.asarray((structure & ~(thing > config.thing_odds)) | (has_surface & (thing < -config.structure_odds)))
