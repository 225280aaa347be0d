"""Joining fragments into things: by rounds, those that learned trees take for one thing.

A round looks at every two groups of fragments that meet, nearly meet or are bridged behind what hides them, and joins
those that are likelier one thing with each other than with any third group. The next round sees the groups. Planes that
go on behind what hides them prove what trees only guess.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry import portable
from hickory_stream.perception.affinity import pair_features
from hickory_stream.perception.hidden import HiddenConfig, are_one_behind
from hickory_stream.perception.odds_features import odds_features
from hickory_stream.perception.parts import measure
from hickory_stream.perception.trees import Forest  # noqa: TC001 (read with the configuration)
from hickory_stream.ranges import Ranged, number

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from numpy.typing import NDArray

    from hickory_stream.perception.fragment_odds import FragmentOdds
    from hickory_stream.perception.parts import Measures
    from hickory_stream.perception.scenery import Scenery
    from hickory_stream.perception.surface import Surface
    from hickory_stream.perception.trees import Trees


@dataclass(frozen=True, kw_only=True, slots=True)
class JoinConfig(Ranged):
    """How fragments are joined; the trees were grown with the defaults of `reach_px`, `gap_m` and `hidden`.

    Attributes:
        forest: which trees say so; those of `mixed` make fewer false objects in rooms by others and find fewer things,
            from a `probability` of 0.5.
        probability: two groups are joined from this probability of being one thing; over a half, for a map joins what
            was in pieces, but hardly divides what was joined.
        rounds: at most so many.
        reach_px: pixels are neighbours across fewer than this many pixels without a label.
        gap_m: fragments that do not meet are looked at together up to this distance.
    """

    forest: Forest = "sizes"
    probability: float = number(0.65, 0, 1, "probability")
    rounds: int = number(12, 0, 1000, "rounds")
    reach_px: int = number(3, 1, 100, "px")
    gap_m: float = number(0.2, 0, 10, "m")
    hidden: HiddenConfig = field(default_factory=HiddenConfig)


class Groups:
    """A partition of labels 0..n - 1 that only grows coarser; a group is named by its lowest label."""

    def __init__(self, count: int) -> None:
        self._parent = list(range(count))

    def unite(self, pairs: Iterable[tuple[int, int]]) -> None:
        """Make one group of the groups of each pair."""
        for a, b in pairs:
            ra, rb = self._root(a), self._root(b)
            self._parent[max(ra, rb)] = min(ra, rb)

    def numbers(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return (n,) the groups numbered without gaps in the order of their names, and the names (groups,)."""
        roots = np.array([self._root(i) for i in range(len(self._parent))])
        names, numbers = np.unique(roots, return_inverse=True)
        return numbers, names

    def _root(self, i: int) -> int:
        while self._parent[i] != i:
            i = self._parent[i]
        return i


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Round:
    """What a round of joining looks at: `numbers` (n,) the group of each fragment, `pairs` (K, 2) of groups."""

    numbers: NDArray[np.int64]
    pairs: NDArray[np.int64]
    features: Mapping[str, NDArray[np.float64]]


def join_fragments(
    surface: Surface,
    labels: NDArray[np.int32],
    supports: NDArray[np.int32],
    scenery: Scenery,
    trees: Trees,
    config: JoinConfig,
) -> NDArray[np.int32]:
    """Return (h, w) instance labels 1..n: joined fragments, numbered in the order of their first fragment."""
    measures = measured(surface, labels, supports, scenery, config)
    if measures is None:
        return labels
    numbers = np.arange(len(measures.parts.pixels))
    for step in rounds(measures, trees.probabilities, config):
        numbers = step.numbers
    return numbers.astype(np.int32)[labels]


def measured(
    surface: Surface, labels: NDArray[np.int32], supports: NDArray[np.int32], scenery: Scenery, config: JoinConfig
) -> Measures | None:
    """Return what is measured of fragments before they are joined; None where there are none."""
    if not labels.any():
        return None
    return measure(
        surface,
        labels,
        supports,
        scenery.areas_m2,
        scenery.structure,
        scenery.floor_z_m,
        reach_px=config.reach_px,
        gap_m=config.gap_m,
        hidden=config.hidden,
    )


def rounds(
    measures: Measures,
    probabilities: Callable[[Mapping[str, NDArray[np.float64]]], NDArray[np.float64]],
    config: JoinConfig,
    odds: FragmentOdds | None = None,
) -> Iterator[Round]:
    """Yield the rounds of joining by the `probabilities` of features, from single fragments to the final groups.

    What a network says of the groups, its `odds`, is among the features; None: nothing (`odds_features`).
    """
    groups = Groups(len(measures.parts.pixels))
    for i in range(config.rounds + 1):
        numbers, names = groups.numbers()
        pairs, features = pair_features(measures, numbers, len(names))
        features |= odds_features(None if odds is None else odds.of_groups(numbers, len(names)), pairs, len(names))
        yield Round(numbers=numbers, pairs=pairs, features=features)
        # Seen so rarely that trees learn little of it, and certain.
        proven = are_one_behind(
            features["bridged_level"],
            features["bridged_upright"],
            portable.exp(features["small_pixels"]),
            config.hidden,
        )
        chosen = _closest(pairs, np.where(proven, 1.0, probabilities(features)), len(names), config.probability)
        if len(chosen) == 0 or i == config.rounds:
            return
        groups.unite((int(names[a]), int(names[b])) for a, b in chosen)


def _closest(pairs: NDArray[np.int64], probability: NDArray[np.float64], count: int, least: float) -> NDArray[np.int64]:
    """Return the (M, 2) pairs that are likely enough, and for both of which no other pair is likelier."""
    best = np.zeros(count)
    for side in (0, 1):
        np.maximum.at(best, pairs[:, side], probability)
    return pairs[(probability >= least) & (probability >= best[pairs].max(axis=1))]
