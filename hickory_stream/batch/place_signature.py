"""Pairs of many maps that may show the same place, from the arrangement of their objects, without alignment.

A word of a map's signature describes two near objects: their looks, sizes, distance and difference of heights; it is
the same in any frame with a vertical z axis. Each common word of two maps votes for one transform between them; the
score of two maps is the largest number of agreeing votes. An index of all words makes the cost grow with common words;
pairs with a score are then aligned, at a thousand times the cost.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from hickory_stream.geometry.arrays import freeze, freeze_all

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hickory_stream.alignment.object_map import ObjectMap

# Two objects farther apart than this make no word: robots see rooms, and odometry bends longer distances.
_REACH_M = 5.0
_DISTANCE_BIN_M, _HEIGHT_BIN_M = 0.3, 0.3
_SIZE_BIN = 1.0
"""In natural logarithms of the diagonal of an object's box."""
_BITS = 4
_YAW_BIN_RAD, _PLACE_BIN_M = np.pi / 9, 1.2
# A word that is more frequent than this in all maps says nothing of a place.
_MOST_ENTRIES = 400
_LEAST_SCORE = 4
_CHANCE = 1e-4
"""Two maps are aligned where fewer such agreements than this are expected of any two maps."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PlaceSignature:
    """P pairs of objects: `words` (P,), `yaw_rad` (P,) of the direction between them, `places` (P, 3) of the first.

    `bins` (P, 2) are distance and difference of heights in bins, with fractions: noise may change the bin.
    """

    words: NDArray[np.int64]
    bins: NDArray[np.float32]
    yaw_rad: NDArray[np.float32]
    places: NDArray[np.float32]

    def __post_init__(self) -> None:
        freeze(self, "words", np.int64, (None,))
        count = len(self.words)
        freeze_all(self, np.float32, bins=(count, 2), yaw_rad=(count,), places=(count, 3))

    @property
    def num_bytes(self) -> int:
        """Size of the signature."""
        return self.words.nbytes + self.bins.nbytes + self.yaw_rad.nbytes + self.places.nbytes


def place_signatures(maps: Sequence[ObjectMap]) -> tuple[PlaceSignature, ...]:
    """Return comparable signatures of maps, each in its own frame."""
    looks = _looks(maps)
    return tuple(_signature(one, look) for one, look in zip(maps, looks, strict=True))


def candidate_pairs(signatures: Sequence[PlaceSignature], chance: float = _CHANCE) -> dict[tuple[int, int], int]:
    """Return the pairs (a, b), a < b, that may overlap, with their scores."""
    from scipy.stats import poisson  # loaded here, for it takes a third of a second

    if len(signatures) < 2:
        return {}
    index = _Index(signatures)
    found: dict[tuple[int, int], int] = {}
    for a, signature in enumerate(signatures):
        for b, score, num_matches in index.scores(a, signature):
            ways = _num_ways(signature, signatures[b])
            if score >= _LEAST_SCORE and ways * poisson.sf(score - 1, num_matches / ways) < chance:
                found[a, b] = score
    return dict(sorted(found.items()))


def _num_ways(a: PlaceSignature, b: PlaceSignature) -> float:
    reach = sum(float(np.ptp(one.places[:, :2], axis=0).max()) if len(one.places) else 0.0 for one in (a, b))
    height = sum(float(np.ptp(one.places[:, 2])) if len(one.places) else 0.0 for one in (a, b))
    turns = 2 * np.pi / _YAW_BIN_RAD
    return turns * max(1.0, reach / _PLACE_BIN_M) ** 2 * max(1.0, height / _PLACE_BIN_M)


# ---- words ----------------------------------------------------------------------------------------------------------


def _looks(maps: Sequence[ObjectMap]) -> list[NDArray[np.int64]]:
    # For each map the looks (N,) of its objects: signs along the main directions of all features; all equal without
    # features, or with different extractors.
    sizes = {0 if one.features is None else one.features.shape[1] for one in maps if len(one)}
    if len(sizes) != 1 or 0 in sizes or len({one.extractor for one in maps}) > 1:
        return [np.zeros(len(one), dtype=np.int64) for one in maps]
    rows = [np.empty((0, max(sizes))) if one.features is None else one.features.astype(np.float64) for one in maps]
    known = np.concatenate(rows)
    known = known[np.isfinite(known).all(axis=1)]
    if len(known) <= _BITS:
        return [np.zeros(len(one), dtype=np.int64) for one in maps]
    middle = known.mean(axis=0)
    _, directions = np.linalg.eigh((known - middle).T @ (known - middle))
    main = directions[:, ::-1][:, :_BITS]
    cuts = np.median((known - middle) @ main, axis=0)
    weights = 1 << np.arange(main.shape[1])
    # An object without a feature looks like none that has one.
    return [
        np.where(np.isfinite(row).all(axis=1), (np.nan_to_num(row - middle) @ main > cuts) @ weights, 1 << _BITS)
        for row in rows
    ]


def _signature(objects: ObjectMap, looks: NDArray[np.int64]) -> PlaceSignature:
    places = objects.centroids
    diagonals = np.array([2 * np.linalg.norm(box.half_extents_m) for box in objects.boxes]).reshape(-1)
    sizes = np.floor(np.log(np.maximum(diagonals, 0.01)) / _SIZE_BIN).astype(np.int64) + 16
    kinds = looks * 64 + np.clip(sizes, 0, 63)
    pairs = (
        cKDTree(places[:, :2]).query_pairs(_REACH_M, output_type="ndarray") if len(places) else np.empty((0, 2), int)
    )
    # From the lesser kind to the greater one; between equals, either way.
    forth = pairs[kinds[pairs[:, 0]] <= kinds[pairs[:, 1]]]
    back = pairs[kinds[pairs[:, 0]] >= kinds[pairs[:, 1]]][:, ::-1]
    first, second = np.concatenate([forth, back]).T
    ways = places[second] - places[first]
    bins = np.column_stack([np.hypot(ways[:, 0], ways[:, 1]) / _DISTANCE_BIN_M, ways[:, 2] / _HEIGHT_BIN_M])
    return PlaceSignature(
        words=_words(kinds[first] * 4096 + kinds[second], np.floor(bins).astype(np.int64)),
        bins=bins,
        yaw_rad=np.arctan2(ways[:, 1], ways[:, 0]),
        places=places[first],
    )


def _words(kinds: NDArray[np.int64], bins: NDArray[np.int64]) -> NDArray[np.int64]:
    return (kinds * 64 + bins[:, 0]) * 256 + np.clip(bins[:, 1] + 128, 0, 255)


# ---- how many agree -------------------------------------------------------------------------------------------------


class _Index:
    def __init__(self, signatures: Sequence[PlaceSignature]) -> None:
        owners = np.repeat(np.arange(len(signatures)), [len(one.words) for one in signatures])
        words = np.concatenate([one.words for one in signatures])
        order = np.argsort(words, kind="stable")
        self._words, self._owners = words[order], owners[order]
        self._yaw = np.concatenate([one.yaw_rad for one in signatures])[order].astype(np.float64)
        self._places = np.concatenate([one.places for one in signatures])[order].astype(np.float64)

    def scores(self, a: int, signature: PlaceSignature) -> list[tuple[int, int, int]]:
        # (b, score, number of common words) of map `a` and each later map with a common word.
        mine, theirs = self._matches(a, signature)
        yaw = np.mod(signature.yaw_rad[mine] - self._yaw[theirs], 2 * np.pi)
        c, s = np.cos(yaw), np.sin(yaw)
        x, y, z = self._places[theirs].T
        shift = signature.places[mine] - np.column_stack([c * x - s * y, s * x + c * y, z])
        best: dict[int, int] = {}
        # What agrees may be parted by the border of a bin, but not by those of both grids.
        for offset in (0.0, 0.5):
            turn = np.mod(np.floor(yaw / _YAW_BIN_RAD + offset), round(2 * np.pi / _YAW_BIN_RAD))
            cells = np.floor(shift / _PLACE_BIN_M + offset)
            keys = np.column_stack([self._owners[theirs], turn, cells]).astype(np.int64)
            ways, counts = np.unique(keys, axis=0, return_counts=True)
            for b, count in zip(ways[:, 0].tolist(), counts.tolist(), strict=True):
                best[b] = max(best.get(b, 0), count)
        owners, totals = np.unique(self._owners[theirs], return_counts=True)
        return [(b, best[b], total) for b, total in zip(owners.tolist(), totals.tolist(), strict=True)]

    def _matches(self, a: int, signature: PlaceSignature) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        mine, theirs = [], []
        near = np.floor(signature.bins - 0.5).astype(np.int64)
        kinds = signature.words // (64 * 256)
        for step in ((0, 0), (0, 1), (1, 0), (1, 1)):
            words = _words(kinds, np.maximum(near + step, (0, -128)))
            first, last = np.searchsorted(self._words, words, "left"), np.searchsorted(self._words, words, "right")
            counts = np.where(last - first <= _MOST_ENTRIES, last - first, 0)
            rows = np.repeat(np.arange(len(words)), counts)
            entries = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) + first[rows]
            is_later = self._owners[entries] > a
            mine.append(rows[is_later])
            theirs.append(entries[is_later])
        return np.concatenate(mine), np.concatenate(theirs)
