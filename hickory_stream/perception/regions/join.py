"""Region merging: fragments are merged into instances in rounds, by learned trees.

A round rates all pairs of regions that touch, nearly touch or are bridged behind an occluder, and merges the pairs in
which each region is the most probable partner of the other. Bridged regions are merged without the trees.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.geometry import portable
from hickory_stream.perception.fragments.over_segmentation import Fragments
from hickory_stream.perception.regions.features import joined
from hickory_stream.perception.regions.fragment_odds import FragmentOdds
from hickory_stream.perception.regions.map_prior import FragmentOwners, MapPriorConfig
from hickory_stream.perception.regions.mask_evidence import MaskEvidence
from hickory_stream.perception.regions.occlusion_bridging import is_bridged
from hickory_stream.perception.regions.odds_features import odds_features
from hickory_stream.perception.regions.pair_features import pair_features
from hickory_stream.perception.regions.region_graph import RegionGraph, build_region_graph
from hickory_stream.perception.regions.trees import Trees

# Maximum number of rounds.
_MAX_ROUNDS = 12
# Pixels are neighbours across fewer than this many unlabelled pixels; the trees were grown with it.
_REACH_PX = 3
# Maximum distance of fragments that are rated without touching in the image; the trees were grown with it.
_GAP_M = 0.2


@dataclass(frozen=True, kw_only=True, slots=True)
class JoinConfig(Ranged):
    """How fragments are merged."""

    #: Minimum probability for a merge.
    probability: float = number(0.35, 0, 1, "probability")
    #: How the objects of the map lower the probability of a merge.
    map_prior: MapPriorConfig = field(default_factory=MapPriorConfig)


class Groups:
    """A partition of labels 0..n - 1 into groups that can only be united; a group is named by its lowest label."""

    def __init__(self, count: int) -> None:
        self._parent = list(range(count))

    def unite(self, pairs: Iterable[tuple[int, int]]) -> None:
        """Make one group of the groups of each pair."""
        for a, b in pairs:
            ra, rb = self._root(a), self._root(b)
            self._parent[max(ra, rb)] = min(ra, rb)

    def numbers(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return (n,) the group of each label, numbered 0, 1, ... in the order of names, and the names (groups,)."""
        roots = np.array([self._root(i) for i in range(len(self._parent))])
        names, numbers = np.unique(roots, return_inverse=True)
        return numbers, names

    def _root(self, i: int) -> int:
        while self._parent[i] != i:
            i = self._parent[i]
        return i


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Joined:
    """Instance labels (h, w) 1..n, 0 = none, numbered in the order of their first fragments."""

    #: joined with the map prior
    labels: NDArray[np.int32]
    #: joined without it, unions of instances of `labels`; None: the same
    alone: NDArray[np.int32] | None = None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Round:
    """The input of a round: the region of each fragment (n,), pairs (K, 2) of regions, and their features."""

    numbers: NDArray[np.int64]
    pairs: NDArray[np.int64]
    features: Mapping[str, NDArray[np.float64]]


def join_fragments(
    fragments: Fragments,
    trees: Trees,
    config: JoinConfig,
    owners: FragmentOwners | None = None,
    odds: FragmentOdds | None = None,
    masks: MaskEvidence | None = None,
) -> Joined:
    """Return the fragments joined into instances, with the map prior (`owners`) and without."""
    labels, graph = fragments.labels, region_graph_of(fragments)
    if graph is None:
        return Joined(labels=labels)
    *_, last = rounds(graph, trees.probabilities, config, odds, owners, masks=masks)
    together = last.numbers.astype(np.int32)[labels]
    if owners is None:
        return Joined(labels=together)
    # For the result of this frame alone, the rounds continue from there without the map prior.
    *_, alone = rounds(graph, trees.probabilities, config, odds, start=last, masks=masks)
    return Joined(labels=together, alone=alone.numbers.astype(np.int32)[labels])


def region_graph_of(fragments: Fragments) -> RegionGraph | None:
    """Return the region graph of fragments before any are merged; None if there are none."""
    if not fragments.labels.any():
        return None
    return build_region_graph(fragments, reach_px=_REACH_PX, gap_m=_GAP_M)


def rounds(
    graph: RegionGraph,
    probabilities: Callable[[Mapping[str, NDArray[np.float64]]], NDArray[np.float64]],
    config: JoinConfig,
    odds: FragmentOdds | None = None,
    owners: FragmentOwners | None = None,
    start: Round | None = None,
    most: int = _MAX_ROUNDS,
    masks: MaskEvidence | None = None,
) -> Iterator[Round]:
    """Yield the rounds of merging, from single fragments (or `start`) to the final regions.

    `probabilities` rates features of pairs; `odds`: the log-odds of a network; `owners`: the map prior; `most`: the
    maximum number of rounds; `masks`: masks of another network.
    """
    groups = Groups(len(graph.regions.pixels))
    if start is not None:
        _, first = np.unique(start.numbers, return_index=True)
        groups.unite((int(first[region]), i) for i, region in enumerate(start.numbers))
    for i in range(most + 1):
        numbers, names = groups.numbers()
        now = start if i == 0 and start is not None else _round(graph, numbers, len(names), odds)
        yield now
        pairs, features = now.pairs, now.features
        # Bridged regions are surely one object, but too rare in the training data for the trees to learn it.
        pixels = portable.exp(features["small_pixels"])
        proven = is_bridged(features["bridged_level"], features["bridged_upright"], pixels)
        likely = np.where(proven, 1.0, probabilities(features))
        if masks is not None:
            likely = masks.combined(likely, pairs, numbers, len(names))
        if owners is not None:
            likely = owners.against(likely, pairs, numbers, len(names))
        chosen = _closest(pairs, likely, len(names), config.probability)
        if len(chosen) == 0 or i == most:
            return
        groups.unite((int(names[a]), int(names[b])) for a, b in chosen)


def _round(graph: RegionGraph, numbers: NDArray[np.int64], count: int, odds: FragmentOdds | None) -> Round:
    # `numbers` (n,) gives the region, of `count`, of each fragment.
    pairs, features = pair_features(graph, numbers, count)
    of_odds = odds_features(None if odds is None else odds.of_groups(numbers, count), pairs, count)
    return Round(numbers=numbers, pairs=pairs, features=joined(features, of_odds))


def _closest(pairs: NDArray[np.int64], probability: NDArray[np.float64], count: int, least: float) -> NDArray[np.int64]:
    # (M, 2) pairs of at least the `least` probability that are the most probable pair of both regions.
    best = np.zeros(count)
    for side in (0, 1):
        np.maximum.at(best, pairs[:, side], probability)
    return pairs[(probability >= least) & (probability >= best[pairs].max(axis=1))]
