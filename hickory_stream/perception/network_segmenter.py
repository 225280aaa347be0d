"""The segmenter with the packaged affinity network: geometric fragments, joined by trees that use its log-odds."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.errors import ModelError
from hickory_stream.perception.affinity.pixel_network import ODDS_ZERO, THING, PixelNetwork, PixelOdds
from hickory_stream.perception.fragments.over_segmentation import Fragments
from hickory_stream.perception.geometric_segmenter import GeometricConfig, GeometricSegmenter
from hickory_stream.perception.masks import InstanceMask
from hickory_stream.perception.regions.fragment_odds import fragment_odds, mean_log_odds
from hickory_stream.perception.regions.join import Joined, join_fragments
from hickory_stream.perception.regions.map_prior import fragment_owners
from hickory_stream.perception.regions.mask_evidence import divided_by_masks, evidence_of, sampled_masks
from hickory_stream.perception.regions.trees import Trees, embedded_trees
from hickory_stream.perception.surface import Surface, moved_surface
from hickory_stream.records import Frame, MapPrior, Segmentation


def thing_log_odds(labels: NDArray[np.int32], odds: PixelOdds) -> NDArray[np.float64]:
    """Return (n + 1,) the mean log-odds that each mask 0..n of an image (h, w) is an object; NaN if unknown."""
    few = labels[::2, ::2].ravel()
    count = int(labels.max(initial=0)) + 1
    from_even = odds.odds[THING].ravel().astype(np.float64) - ODDS_ZERO
    sums = np.bincount(few, weights=from_even, minlength=count).astype(np.int64)  # sums of integers: exact
    return mean_log_odds(sums, np.bincount(few, minlength=count))


@dataclass(frozen=True, kw_only=True, slots=True)
class NetworkJoinConfig(Ranged):
    """How the network's log-odds are used."""

    #: Added to the log-odds that a mask is part of the room; lower values reject fewer masks, -8 none.
    structure_shift: float = number(-1.0, -8, 8, "log-odds")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Prepared:
    """The results of a frame that need no map: its surface, and the network's log-odds for its pixels."""

    surface: Surface
    odds: PixelOdds


class NetworkSegmenter:
    """A `Segmenter` with the affinity network; stateless. `trees` rate pairs of regions; None: the packaged trees."""

    def __init__(
        self, network: PixelNetwork, config: NetworkJoinConfig, geometric: GeometricConfig, trees: Trees | None = None
    ) -> None:
        self._network = network
        self._config = config
        self._join = geometric.join
        self._trees = trees or embedded_trees()
        self._geometric = GeometricSegmenter(geometric, self._trees)

    def prepare(self, frame: Frame) -> Prepared:
        """Return the surface of a frame and the network's odds; raises `ModelError`."""
        surface = self._geometric.prepare(frame)
        return Prepared(surface=surface, odds=self._network.odds(surface, None))

    def moved(self, prepared: object, world_from_camera: NDArray[np.float64]) -> object:
        """Return the result of `prepare` for another pose (4, 4) of the frame; odds do not depend on it."""
        if not isinstance(prepared, Prepared):
            return None
        return replace(prepared, surface=moved_surface(prepared.surface, world_from_camera))

    def segment(self, frame: Frame, prior: MapPrior | None = None, prepared: object = None) -> Segmentation:
        """Return the instances and the structure of a frame; `prior` is the map so far."""
        return self.segment_with((), frame, prior, prepared)

    def segment_with(
        self, masks: Sequence[InstanceMask], frame: Frame, prior: MapPrior | None = None, prepared: object = None
    ) -> Segmentation:
        """Return what `segment` does, with masks of another network as evidence; raises `ModelError`."""
        width, height = frame.camera.width, frame.camera.height
        if any(min(m.box_px[:2]) < 0 or m.box_px[2] > width or m.box_px[3] > height for m in masks):
            raise ModelError(f"a mask ends beyond the frame of {width}x{height}: masks must have the size of the frame")
        found = prepared if isinstance(prepared, Prepared) else self.prepare(frame)
        pieces, evidence = self.fragments(frame, prior, found), None
        if masks:
            few = sampled_masks(masks, found.surface.factor, pieces.labels.shape)
            pieces = replace(pieces, labels=divided_by_masks(pieces.labels, few))
            evidence = evidence_of(few, pieces.labels)
        owners = fragment_owners(pieces.labels, pieces.surface, prior, self._join.map_prior)
        odds = fragment_odds(pieces.labels, found.odds)
        joined = join_fragments(pieces, self._trees, self._join, owners, odds, evidence)
        structure_odds = self._config.structure_shift - thing_log_odds(joined.labels, found.odds)
        return self._geometric.segmentation(frame, pieces, joined, structure_odds)

    def segmentation(self, frame: Frame, pieces: Fragments, joined: Joined) -> Segmentation:
        """Return the segmentation of a frame whose fragments were joined into masks."""
        return self._geometric.segmentation(frame, pieces, joined)

    def fragments(self, frame: Frame, prior: MapPrior | None = None, prepared: object = None) -> Fragments:
        """Return the over-segmentation of a frame, before any fragments are joined."""
        found = prepared if isinstance(prepared, Prepared) else self.prepare(frame)
        return self._geometric.divided(found.surface, self._geometric.room(found.surface, prior))
