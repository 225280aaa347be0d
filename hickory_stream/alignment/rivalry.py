"""Whether what separates two hypotheses is significant itself: pairs that only one explains, and space it violates.

What both explain says nothing about which is right, and how well it happens to fit is noise: in a symmetric room the
expected false alarms of two hypotheses differ by many decades by chance. Three kinds of evidence are left, each tested
against the supposition that the rival is right:

- Decisive pairs: objects that the hypothesis pairs and the rival leaves alone in both maps. Under the rival they stand
  together by chance, which the a-contrario bound for a known transform prices. A pair one of whose objects the rival
  pairs with something else is no evidence: that a map shows the same thing twice, at places that a motion takes to one
  another, is what a repetition looks like, and a third copy would look the same. This goes for any other significant
  hypothesis: of a grid or of like rooms nothing is left but what is not repeated.
- The objects that both explain, with different partners: a paired t-test on the differences of their costs, by which
  noise measures itself (Student 1908).
- Objects that the rival puts where the other map saw free space: as many are rarely missing (binomial).

The clearest of the three counts.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial import Delaunay, QhullError, cKDTree

from hickory_stream.alignment.acceptance import log_expected_coincidences
from hickory_stream.alignment.answer import Contradictions
from hickory_stream.alignment.hypothesis import Evidence, Hypothesis
from hickory_stream.geometry.rigid import apply

_MIN_COMPARED = 3
# A transform that is right leaves so many of the expected objects missing: things move, and are overlooked.
_MISSING_SHARE = 0.05
# No more is believed to be overlooked, however many objects have no partner.
_MOST_MISSING = 0.5
_QUANTILES = (np.arange(200) + 0.5) / 200
# The copies of a thing in a repeated layout stand off by about so much, and look as unlike as one thing seen twice.
_COPY_M = 0.1
_ALIKE_SIGMAS = 2.0
_NO_PARTNER, _FAR = -1, 1e6


def separation(
    evidence: Evidence,
    one: tuple[Hypothesis, Contradictions],
    other: tuple[Hypothesis, Contradictions],
    others: Sequence[Hypothesis],
) -> float:
    """Return by how many decades the evidence for `one` against `other` is more significant than that for the other.

    `others` are further significant hypotheses: objects that they explain with other partners are repeated.
    """
    is_alike = alike(evidence, one[0])
    explained = [_explained(evidence, hypothesis, is_alike) for hypothesis in (one[0], other[0], *others)]
    own, rival, *repeated = explained
    found = _significance(evidence, (one, own), (other, rival), repeated) - _significance(
        evidence, (other, rival), (one, own), repeated
    )
    # Robots measure gravity: a tilt that explains a pair more, and is likelier chance, is not preferred unpaid.
    is_dearer = (one[0].log10_uniform > other[0].log10_uniform) == other[0].is_level
    most = float(np.log10(evidence.chance.tilt_price)) * (other[0].is_level - one[0].is_level) * is_dearer
    return found - float(np.clip(found, min(most, 0.0), max(most, 0.0)))


def alike(evidence: Evidence, hypothesis: Hypothesis) -> NDArray[np.bool_]:
    """Return which pairs (N, M) look as much alike as the pairs of a hypothesis, by each known score."""
    is_alike = np.ones(evidence.log_ranks.shape, dtype=bool)
    for looks in evidence.looks:
        own = looks[hypothesis.pairs[:, 0], hypothesis.pairs[:, 1]]
        own = own[np.isfinite(own)]
        if len(own):
            is_alike &= ~(looks < own.mean() - _ALIKE_SIGMAS * own.std())
    return is_alike


_Told = tuple[tuple["Hypothesis", "Contradictions"], "_Explained"]


def _significance(evidence: Evidence, one: _Told, other: _Told, others: "Sequence[_Explained]") -> float:
    # -log10 of the probability of the evidence for `one` if `other` is right.
    ((hypothesis, space), own), ((rival, rival_space), rivals_own) = one, other
    logs = [
        _log_decisive(evidence, hypothesis, own, rivals_own, others),
        _log_compared(evidence, hypothesis, rival),
        _log_missing(space, rival_space),
    ]
    known = [min(log, 0.0) for log in logs if log is not None]
    if not known:
        return 0.0
    # The least probability of several, counted as often as was tried (Tippett 1931): one that is mute hides none.
    return float(-min(min(known) + np.log(len(known)), 0.0) / np.log(10.0))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Explained:
    # Partners (-1: none). `amid`: objects that lie among those explained in the other map, so should have partners,
    # too; `near`: among or beside them.
    of_a: NDArray[np.int64]
    of_b: NDArray[np.int64]
    amid_a: NDArray[np.bool_]
    amid_b: NDArray[np.bool_]
    near_a: NDArray[np.bool_]
    near_b: NDArray[np.bool_]

    def missing_shares(self) -> NDArray[np.float64]:
        """Return how often what should have a partner has none: quantiles of what is to be believed of it."""
        from scipy.stats import beta  # loaded here: no run needs it, and it takes a third of a second

        amid = np.concatenate([self.amid_a, self.amid_b])
        missing = np.count_nonzero(amid & (np.concatenate([self.of_a, self.of_b]) == _NO_PARTNER))
        shares = beta.ppf(_QUANTILES, missing + 1, np.count_nonzero(amid) - missing + 1)
        return np.asarray(np.minimum(shares, _MOST_MISSING))


def _explained(evidence: Evidence, hypothesis: Hypothesis, is_alike: NDArray[np.bool_]) -> _Explained:
    moved = apply(hypothesis.a_from_b, evidence.centroids_b)
    of_a = np.full(len(evidence.centroids_a), _NO_PARTNER, dtype=np.int64)
    of_b = np.full(len(evidence.centroids_b), _NO_PARTNER, dtype=np.int64)
    of_a[hypothesis.pairs[:, 0]] = hypothesis.pairs[:, 1]
    of_b[hypothesis.pairs[:, 1]] = hypothesis.pairs[:, 0]
    left_a, left_b = np.flatnonzero(of_a == _NO_PARTNER), np.flatnonzero(of_b == _NO_PARTNER)
    offsets = evidence.centroids_a[left_a][:, None] - moved[left_b][None]
    level = np.hypot(offsets[..., 0], offsets[..., 1]) / np.hypot(evidence.sigma_m, _COPY_M)
    distances = np.hypot(level, offsets[..., 2] / evidence.sigma_m)
    fits = is_alike[np.ix_(left_a, left_b)] & (distances < evidence.gate)
    rows, columns = linear_sum_assignment(np.where(fits, distances - _FAR, 0.0))
    is_pair = fits[rows, columns]
    of_a[left_a[rows[is_pair]]] = left_b[columns[is_pair]]
    of_b[left_b[columns[is_pair]]] = left_a[rows[is_pair]]
    places_a, places_b = evidence.centroids_a[:, :2], moved[:, :2]
    outline = np.concatenate([places_a[of_a != _NO_PARTNER], places_b[of_b != _NO_PARTNER]])
    amid_a, amid_b = _amid(outline, places_a), _amid(outline, places_b)
    return _Explained(
        of_a=of_a,
        of_b=of_b,
        amid_a=amid_a,
        amid_b=amid_b,
        near_a=amid_a | _beside(places_a[of_a != _NO_PARTNER], places_a),
        near_b=amid_b | _beside(places_b[of_b != _NO_PARTNER], places_b),
    )


def _amid(outline: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.bool_]:
    try:
        return np.asarray(Delaunay(outline).find_simplex(places, tol=1e-9) >= 0)
    except QhullError:
        return np.zeros(len(places), dtype=bool)


def _beside(known: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.bool_]:
    # No further from a known place than two of the usual steps between known places.
    tree = cKDTree(known)
    spacing_m = np.median(tree.query(known, k=2)[0][:, 1])
    return np.asarray(tree.query(places)[0] <= 2 * spacing_m)


def _log_decisive(
    evidence: Evidence, one: Hypothesis, own: _Explained, rival: _Explained, others: Sequence[_Explained]
) -> float | None:
    # ln of the probability that `one` alone explains as much if it is wrong; None without such pairs.
    i, j = one.pairs[:, 0], one.pairs[:, 1]
    is_lone, num_missed = np.ones(len(one.pairs), dtype=bool), np.zeros(len(one.pairs), dtype=np.int64)
    for copies in (rival, *others):
        is_same = copies.of_a[i] == j
        is_left = (copies.of_a[i] == _NO_PARTNER) & (copies.of_b[j] == _NO_PARTNER)
        is_lone &= is_left if copies is rival else is_left | is_same
        num_missed += np.where(is_same, 0, copies.near_a[i].astype(np.int64) + copies.near_b[j])
    if not is_lone.any():
        return None
    is_copied = is_lone & (num_missed > 0)
    free = int((rival.of_a == _NO_PARTNER).sum()), int((rival.of_b == _NO_PARTNER).sum())
    log_new = _log_coincident(evidence, one, is_lone & ~is_copied, free)
    log_copied = _log_coincident(evidence, one, is_copied, free)
    if is_copied.any():
        num_repeated = int(np.count_nonzero(~is_lone))
        log_copied = max(log_copied, _log_overlooked(num_missed[is_copied], num_repeated, own.missing_shares()))
    return log_new + log_copied


def _log_overlooked(num_missed: NDArray[np.int64], num_repeated: int, missing_shares: NDArray[np.float64]) -> float:
    # ln of the probability that repeated things were overlooked at all but one of their places: `num_missed` (K,) times
    # each, by quantiles (Q,) of how often something is overlooked.
    from scipy.stats import nbinom

    levels = np.unique(num_missed)
    chances = [
        nbinom.sf(np.count_nonzero(num_missed >= level) - 1, num_repeated + 1, 1 - missing_shares**level).mean()
        for level in levels
    ]
    return min(float(np.log(max(min(chances), 1e-300) * len(levels))), 0.0)


def _log_coincident(evidence: Evidence, one: Hypothesis, chosen: NDArray[np.bool_], free: tuple[int, int]) -> float:
    if not chosen.any():
        return 0.0
    logs = log_expected_coincidences(
        evidence.chance, free, one.log_ranks[chosen], np.cumsum(one.residuals_m[chosen] ** 2)
    )
    return min(float(logs.min()), 0.0)


def _log_compared(evidence: Evidence, one: Hypothesis, other: Hypothesis) -> float | None:
    # ln of the probability that objects with two partners favour those of `one` by chance (paired t-test).
    from scipy.stats import t

    logs = []
    for side in (0, 1):
        _, in_one, in_other = np.intersect1d(one.pairs[:, side], other.pairs[:, side], return_indices=True)
        differs = one.pairs[in_one, 1 - side] != other.pairs[in_other, 1 - side]
        if np.count_nonzero(differs) < _MIN_COMPARED:
            continue
        gains = _costs(evidence, other)[in_other[differs]] - _costs(evidence, one)[in_one[differs]]
        spread = float(gains.std(ddof=1))
        if spread < 1e-9:
            continue
        score = float(gains.mean()) / (spread / np.sqrt(len(gains)))
        logs.append(float(t.logsf(score, len(gains) - 1)))
    # The same pairs seen from both maps: the weaker word counts.
    return max(logs) if logs else None


def _costs(evidence: Evidence, hypothesis: Hypothesis) -> NDArray[np.float64]:
    return np.asarray(hypothesis.residuals_m**2 / (2 * evidence.sigma_m**2) + hypothesis.log_ranks)


def _log_missing(one: Contradictions, other: Contradictions) -> float | None:
    # ln of the probability that as many are missing under `other`, beyond those that `one` misses (binomial).
    from scipy.stats import binom

    more = other.num_missing - one.num_missing
    if other.num_expected == 0 or more <= 0:
        return None
    return float(binom.logsf(more - 1, other.num_expected, _MISSING_SHARE))
