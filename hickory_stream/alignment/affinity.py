"""How likely two objects are one, and how well two such pairs agree: a sparse graph over candidate pairs.

Unary scores are ranked among all N M pairs of the two maps: the share of pairs that are at least as good. What a cosine
of 0.9 is worth depends on the network that made it and on the maps; what share of all pairs reaches it does not. The
graph is built by looking up distances: never all pairs of pairs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numba
import numpy as np

from hickory_stream.geometry.arrays import freeze

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hickory_stream.alignment.object_map import ObjectMap


@dataclass(frozen=True, kw_only=True, slots=True)
class AffinityConfig:
    """Which pairs of objects are considered, and when two such pairs agree.

    Attributes:
        centroid_m: standard deviation of an object's centroid on each axis, in each map.
        gate: two pairs disagree beyond this many standard deviations of a distance.
        level_tilt_deg: standard deviation of the tilt between two maps that both know gravity.
        candidate_share: this share of all pairs of objects, the best, are candidates,
        max_candidates: and never more than these.
    """

    centroid_m: float = 0.05
    gate: float = 3.0
    level_tilt_deg: float = 0.5
    candidate_share: float = 0.25
    max_candidates: int = 4000

    def __post_init__(self) -> None:
        for name in ("centroid_m", "gate", "candidate_share", "max_candidates"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be above 0, found {getattr(self, name)}")
        if self.level_tilt_deg < 0:
            raise ValueError(f"level_tilt_deg must not be negative, found {self.level_tilt_deg}")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Affinity:
    """C candidate pairs and how they agree.

    `pairs` (C, 2) are indices into the two maps; `log_ranks` (C,) the logarithms of their ranks, at most 0. The graph is
    in compressed rows: the neighbours of c are `neighbors[starts[c]:starts[c + 1]]`, ascending, with `weights` in 0..1;
    whatever is not listed contradicts c.
    """

    pairs: NDArray[np.int64]
    log_ranks: NDArray[np.float64]
    starts: NDArray[np.int64]
    neighbors: NDArray[np.int32]
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
    """Return the (N, M) cosines of the features, rescaled so that the middle one of all is 0 and the same is 1.

    NaN where an object has none; None where a map has none at all, or the features differ in length: cosines of two
    networks mean nothing.
    """
    a, b = map_a.features, map_b.features
    if a is None or b is None or a.shape[1] != b.shape[1]:
        return None
    cosines = (a @ b.T).astype(np.float64)
    known = cosines[np.isfinite(cosines)]
    if not len(known):
        return None
    middle = min(float(np.median(known)), 1.0 - 1e-6)
    return np.clip((cosines - middle) / (1.0 - middle), 0.0, 1.0)


def fused_scores(scores: Sequence[NDArray[np.float64] | None], shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return the geometric mean (N, M) of the scores that are there; what is NaN counts as the median of its kind."""
    logs = [np.log(np.maximum(_filled(score), 1e-6)) for score in scores if score is not None]
    return np.exp(np.mean(logs, axis=0)) if logs else np.ones(shape)


def log_ranks(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (N, M) logarithms of the share of all pairs that score at least as much: 0 for the worst, and for ties."""
    ascending = np.sort(scores, axis=None)
    # A little below: two scores that only rounding tells apart are ties.
    at_least = scores.size - np.searchsorted(ascending, scores - 1e-12, side="left")
    return np.log(np.maximum(at_least, 1) / max(scores.size, 1))


def build_affinity(
    map_a: ObjectMap, map_b: ObjectMap, ranks: NDArray[np.float64], config: AffinityConfig, *, is_level: bool
) -> Affinity:
    """Return the graph over the best pairs by rank (N, M).

    Where both maps know gravity (`is_level`), the horizontal and the vertical part of a distance must agree each on its
    own, the vertical one up to the tilt times the horizontal distance; otherwise the distance as a whole.
    """
    pairs = _candidates(ranks, config)
    index = np.full(ranks.shape, -1, dtype=np.int32)
    index[pairs[:, 0], pairs[:, 1]] = np.arange(len(pairs))
    # A distance has the noise of two centroids in each of two maps.
    sigma_m = 2.0 * config.centroid_m
    tilt_rad = np.radians(config.level_tilt_deg)
    along_b, _ = _distances(map_b.centroids, is_level)
    order_b = np.argsort(along_b, axis=1, kind="stable").astype(np.int32)
    arguments = (
        *_distances(map_a.centroids, is_level),
        *_distances(map_b.centroids, is_level),
        order_b,
        np.take_along_axis(along_b, order_b.astype(np.int64), axis=1),
        pairs,
        index,
        sigma_m,
        tilt_rad,
        config.gate,
    )
    counts = np.zeros(len(pairs) + 1, dtype=np.int64)
    nothing = np.empty(0, dtype=np.int32), np.empty(0, dtype=np.float32)
    _connect(*arguments, counts, *nothing, False)
    starts = np.cumsum(counts)
    neighbors = np.empty(starts[-1], dtype=np.int32)
    weights = np.empty(starts[-1], dtype=np.float32)
    _connect(*arguments, starts.copy(), neighbors, weights, True)
    return Affinity(
        pairs=pairs,
        log_ranks=ranks[pairs[:, 0], pairs[:, 1]],
        starts=starts,
        neighbors=neighbors,
        weights=weights,
    )


def _candidates(ranks: NDArray[np.float64], config: AffinityConfig) -> NDArray[np.int64]:
    """Return the (C, 2) best pairs by rank, in the order of their indices."""
    wanted = min(max(int(config.candidate_share * ranks.size), min(ranks.size, 400)), config.max_candidates)
    flat = ranks.ravel()
    if wanted < flat.size:
        # The index breaks ties: the same pairs whatever the sort does.
        chosen = np.sort(np.argsort(flat, kind="stable")[:wanted])
    else:
        chosen = np.arange(flat.size)
    return np.stack(np.divmod(chosen, ranks.shape[1]), axis=1)


def _distances(centroids: NDArray[np.float64], is_level: bool) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (N, N) distances: horizontal and signed vertical, or the whole and zero."""
    offsets = centroids[:, None] - centroids[None]
    if is_level:
        return np.hypot(offsets[..., 0], offsets[..., 1]), np.ascontiguousarray(offsets[..., 2])
    return np.linalg.norm(offsets, axis=2), np.zeros(offsets.shape[:2])


def _filled(score: NDArray[np.float64]) -> NDArray[np.float64]:
    is_known = np.isfinite(score)
    return np.where(is_known, score, np.median(score[is_known]) if is_known.any() else 1.0)


@numba.njit(cache=True, nogil=True)
def _connect(  # type: ignore[no-untyped-def] # pragma: no cover
    along_a,
    up_a,
    along_b,
    up_b,
    order_b,
    sorted_b,
    pairs,
    index,
    sigma_m,
    tilt_rad,
    gate,
    cursor,
    neighbors,
    weights,
    writes,
):
    """Count the neighbours of each candidate into cursor[c + 1], or write them from cursor[c] on."""
    for c in range(len(pairs)):
        i, j = pairs[c, 0], pairs[c, 1]
        row, order = sorted_b[j], order_b[j]
        count = 0
        for k in range(len(along_a)):
            if k == i:
                continue
            wanted = along_a[i, k]
            at = np.searchsorted(row, wanted - gate * sigma_m)
            found = 0
            first = cursor[c] + count
            while at < len(row) and row[at] <= wanted + gate * sigma_m:
                m = order[at]
                other = index[k, m]
                if other >= 0 and m != j:
                    sigma_up = np.sqrt(sigma_m**2 + (tilt_rad * wanted) ** 2)
                    up = (up_a[i, k] - up_b[j, m]) / sigma_up
                    if abs(up) <= gate:
                        if writes:
                            along = (row[at] - wanted) / sigma_m
                            # Kept ascending: few are found for one k, and the k ascend.
                            slot = first + found
                            while slot > first and neighbors[slot - 1] > other:
                                neighbors[slot] = neighbors[slot - 1]
                                weights[slot] = weights[slot - 1]
                                slot -= 1
                            neighbors[slot] = other
                            weights[slot] = np.exp(-0.5 * (along * along + up * up))
                        found += 1
                at += 1
            count += found
        if writes:
            cursor[c] += count
        else:
            cursor[c + 1] = count
