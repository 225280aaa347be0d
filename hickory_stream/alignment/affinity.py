"""The affinity of candidate pairs: how similar the two objects are, and which pairs of pairs are consistent.

Unary scores become ranks among all N M pairs, the share of pairs with at least this score: unlike a cosine, a rank
means the same for every network and map. Look-ups of distances build the graph, without testing all pairs of pairs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.object_map import ObjectMap
from hickory_stream.base.compiled import kernel
from hickory_stream.base.ranges import Ranged, number
from hickory_stream.geometry.arrays import freeze


@dataclass(frozen=True, kw_only=True, slots=True)
class AffinityConfig(Ranged):
    """The choice of candidate pairs of objects, and the test whether two of them agree.

    Attributes:
        centroid_m: standard deviation of an object's centroid on each axis, in each map.
        gate: two pairs disagree beyond this many standard deviations of a distance.
        level_tilt_deg: standard deviation of the tilt between two maps that both know gravity.
        candidate_share: the share of all pairs of objects, the best ones, that are candidates ...
        max_candidates: ... and their maximum number, or one for each object of both maps where that is more.
    """

    centroid_m: float = number(0.05, 0.0001, 10, "m")
    gate: float = number(3.0, 0.1, 100, "standard deviations")
    level_tilt_deg: float = number(0.5, 0, 90, "deg")
    candidate_share: float = number(0.25, 0.0001, 1, "share")
    max_candidates: int = number(2000, 1, 1_000_000, "pairs")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Affinity:
    """C candidate pairs; c agrees with `neighbors[starts[c]:starts[c + 1]]`, ascending (compressed rows)."""

    #: (C, 2) indices into the two maps
    pairs: NDArray[np.int64]
    #: (C,), at most 0
    log_ranks: NDArray[np.float64]
    starts: NDArray[np.int64]
    neighbors: NDArray[np.int32]
    #: in 0..1, of each neighbour
    weights: NDArray[np.float32]

    def __post_init__(self) -> None:
        freeze(self, "pairs", np.int64, (None, 2))
        freeze(self, "log_ranks", np.float64, (len(self.pairs),))
        freeze(self, "starts", np.int64, (len(self.pairs) + 1,))
        freeze(self, "neighbors", np.int32, (None,))
        freeze(self, "weights", np.float32, (len(self.neighbors),))

    def __len__(self) -> int:
        return len(self.pairs)


def semantic_scores(map_a: ObjectMap, map_b: ObjectMap) -> NDArray[np.float64] | None:
    """Return the (N, M) cosines of the features, rescaled so that their median is 0 and a cosine of 1 stays 1.

    NaN where an object has no features; None if the features cannot be compared (`why_no_semantics`).
    """
    if why_no_semantics(map_a, map_b) is not None:
        return None
    assert map_a.features is not None
    assert map_b.features is not None
    cosines = (map_a.features @ map_b.features.T).astype(np.float64)
    known = cosines[np.isfinite(cosines)]
    if not len(known):
        return None
    middle = min(float(np.median(known)), 1.0 - 1e-6)
    return np.clip((cosines - middle) / (1.0 - middle), 0.0, 1.0)


def why_no_semantics(map_a: ObjectMap, map_b: ObjectMap) -> str | None:
    """Return why the features of two maps cannot be compared; None if they can."""
    a, b = map_a.features, map_b.features
    if a is None or b is None:
        return f"map {'a' if a is None else 'b'} has no features: aligned without semantics"
    # An unknown extractor may be the same one: only the number of dimensions can tell that it is not.
    if map_a.extractor and map_b.extractor and map_a.extractor != map_b.extractor:
        return (
            f"features are of two extractors ({map_a.extractor} and {map_b.extractor}), between which cosines mean "
            "nothing: aligned without semantics"
        )
    if a.shape[1] != b.shape[1]:
        return (
            f"features have {a.shape[1]} and {b.shape[1]} dimensions, so they are of two extractors, between which "
            "cosines mean nothing: aligned without semantics"
        )
    return None


def fused_log_ranks(scores: Sequence[NDArray[np.float64] | None], shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return (N, M) log ranks of the geometric mean of the ranks by each score; NaN is an average rank."""
    known = [_log_ranks(score) for score in scores if score is not None]
    if not known:
        return np.zeros(shape)
    return known[0] if len(known) == 1 else _log_ranks(-np.sum(known, axis=0))


def distinctive_log_ranks(log_ranks: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (N, M) log ranks among the pairs of either object alone, if these are better than among all pairs.

    In a map of mostly one kind, a pair of another kind ranks high only among the pairs of either of its objects.
    """
    by_a, by_b = _row_log_ranks(log_ranks), _row_log_ranks(np.ascontiguousarray(log_ranks.T)).T
    return np.asarray(np.minimum(log_ranks, np.maximum(by_a, by_b)))


def _row_log_ranks(log_ranks: NDArray[np.float64]) -> NDArray[np.float64]:
    ascending = np.sort(log_ranks, axis=1)
    counts = [np.searchsorted(row, own + 1e-12, side="right") for row, own in zip(ascending, log_ranks, strict=True)]
    return np.log(np.array(counts).reshape(log_ranks.shape) / max(log_ranks.shape[1], 1))


def _log_ranks(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    # ln of the share of known scores that are at least as high; 0 for the lowest score.
    logs = np.full(scores.shape, -1.0)  # The mean of the logarithm of a uniform number.
    is_known = np.isfinite(scores)
    known = scores[is_known]
    # Not a stable sort, which takes three times as long: equal scores have the same rank in any order.
    order = np.argsort(known)
    ascending = known[order]
    # Slightly below the score: scores that differ by rounding only are ties. In order, a search is near the last one.
    at_least = np.empty(len(known))
    at_least[order] = len(known) - np.searchsorted(ascending, ascending - 1e-12, side="left")
    logs[is_known] = np.log(at_least / max(len(known), 1))
    return logs


def build_affinity(
    centroids_a: NDArray[np.float64],
    centroids_b: NDArray[np.float64],
    ranks: NDArray[np.float64],
    config: AffinityConfig,
    *,
    is_level: bool,
) -> Affinity:
    """Return the graph over the best pairs by rank (N, M) of objects at (N, 3) and (M, 3) places.

    If `is_level`, horizontal and vertical distances must agree separately, the vertical one up to the tilt.
    """
    pairs = _candidates(ranks, config)
    index = np.full(ranks.shape, -1, dtype=np.int32)
    index[pairs[:, 0], pairs[:, 1]] = np.arange(len(pairs))
    along_a, up_a = _distances(centroids_a, is_level)
    along_b, up_b = _distances(centroids_b, is_level)
    order_b = np.argsort(along_b, axis=1, kind="stable")
    sorted_b = np.take_along_axis(along_b, order_b, axis=1)
    sorted_up_b = np.take_along_axis(up_b, order_b, axis=1)
    # A distance has the noise of two centroids in each of two maps.
    sigma_m, tilt_rad = 2.0 * config.centroid_m, np.radians(config.level_tilt_deg)
    bin_m = config.gate * sigma_m
    bins = _bins(sorted_b, max(along_a.max(initial=0.0), along_b.max(initial=0.0)), bin_m)
    first, second, agreement = _edges(
        along_a, up_a, sorted_up_b, order_b, sorted_b, bins, bin_m, pairs, index, sigma_m, tilt_rad, config.gate
    )
    starts, neighbors, weights = _rows(len(pairs), first, second, agreement)
    return Affinity(
        pairs=pairs, log_ranks=ranks[pairs[:, 0], pairs[:, 1]], starts=starts, neighbors=neighbors, weights=weights
    )


def _candidates(ranks: NDArray[np.float64], config: AffinityConfig) -> NDArray[np.int64]:
    most = max(config.max_candidates, sum(ranks.shape))
    wanted = min(max(int(config.candidate_share * ranks.size), min(ranks.size, 400)), most)
    flat = ranks.ravel()
    if wanted < flat.size:
        # The index breaks ties: the same pairs whatever the sort does.
        chosen = np.sort(np.argsort(flat, kind="stable")[:wanted])
    else:
        chosen = np.arange(flat.size)
    return np.stack(np.divmod(chosen, ranks.shape[1]), axis=1)


def _distances(centroids: NDArray[np.float64], is_level: bool) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # Horizontal and signed vertical (N, N), or the whole and zero.
    offsets = centroids[:, None] - centroids[None]
    if is_level:
        return np.hypot(offsets[..., 0], offsets[..., 1]), np.ascontiguousarray(offsets[..., 2])
    return np.linalg.norm(offsets, axis=2), np.zeros(offsets.shape[:2])


@kernel
def _bins(sorted_rows, most, bin_m):
    count = int(most / bin_m) + 2
    bins = np.empty((len(sorted_rows), count), dtype=np.int32)
    for j in range(len(sorted_rows)):
        at = 0
        for b in range(count):
            while at < sorted_rows.shape[1] and sorted_rows[j, at] < b * bin_m:
                at += 1
            bins[j, b] = at
    return bins


@kernel
def _edges(along_a, up_a, sorted_up_b, order_b, sorted_b, bins, bin_m, pairs, index, sigma_m, tilt_rad, gate):
    # Pairs (c, d), c < d, of candidates that agree, and how well: by c, unordered in d.
    room = 1024
    first, second = np.empty(room, dtype=np.int32), np.empty(room, dtype=np.int32)
    agreement = np.empty(room, dtype=np.float32)
    count = 0
    reach_m = gate * sigma_m
    for c in range(len(pairs)):
        i, j = pairs[c, 0], pairs[c, 1]
        row, row_up, row_bins, order = sorted_b[j], sorted_up_b[j], bins[j], order_b[j]
        # Candidates are numbered by their object in map a: the later ones are those of a later object.
        for k in range(i + 1, len(along_a)):
            wanted, wanted_up = along_a[i, k], up_a[i, k]
            sigma_up = np.sqrt(sigma_m**2 + (tilt_rad * wanted) ** 2)
            reach_up = gate * sigma_up
            at = row_bins[max(int(wanted / bin_m) - 1, 0)]
            while at < len(row) and row[at] < wanted - reach_m:
                at += 1
            while at < len(row) and row[at] <= wanted + reach_m:
                if abs(wanted_up - row_up[at]) <= reach_up:
                    m = order[at]
                    other = index[k, m]
                    if other >= 0 and m != j:
                        if count == room:
                            room *= 2
                            first, second = _longer(first, room), _longer(second, room)
                            agreement = _longer(agreement, room)
                        along, up = (row[at] - wanted) / sigma_m, (row_up[at] - wanted_up) / sigma_up
                        first[count], second[count] = c, other
                        agreement[count] = np.exp(-0.5 * (along * along + up * up))
                        count += 1
                at += 1
    return first[:count], second[:count], agreement[:count]


@kernel
def _longer(values, room):
    longer = np.empty(room, dtype=values.dtype)
    longer[: len(values)] = values
    return longer


@kernel
def _rows(count, first, second, agreement):
    # Compressed rows with ascending neighbours, by two passes of counting sort.
    starts = np.zeros(count + 1, dtype=np.int64)
    for e in range(len(first)):
        starts[first[e] + 1] += 1
        starts[second[e] + 1] += 1
    starts = np.cumsum(starts)
    # Edges by their second end: walked in that order, each row receives its neighbours ascending.
    by_second = np.argsort(second, kind="mergesort")
    cursor = starts[:-1].copy()
    neighbors = np.empty(2 * len(first), dtype=np.int32)
    weights = np.empty(2 * len(first), dtype=np.float32)
    # First the smaller neighbours (edges are by their first end already), then the larger ones.
    for e in range(len(first)):
        c = second[e]
        neighbors[cursor[c]], weights[cursor[c]] = first[e], agreement[e]
        cursor[c] += 1
    for e in by_second:
        c = first[e]
        neighbors[cursor[c]], weights[cursor[c]] = second[e], agreement[e]
        cursor[c] += 1
    return starts, neighbors, weights
