"""Acceptance of the best hypothesis: by its expected number of false alarms, rivals, geometry and missing objects."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.alignment.answer import Contradictions, NoAlignment, Refusal, Rival
from hickory_stream.alignment.contradiction import contradictions
from hickory_stream.alignment.hypothesis import grown
from hickory_stream.alignment.registration import information
from hickory_stream.alignment.rivalry import alike, separation
from hickory_stream.alignment.search import NOTABLE, distinct, searched
from hickory_stream.alignment.tilt import levelled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.alignment.align_config import AlignConfig
    from hickory_stream.alignment.hypothesis import Evidence, Hypothesis
    from hickory_stream.alignment.object_map import ObjectMap

# Mirrored hypotheses are not tried if the evidence, in decades, is this multiple of the required one.
_SURE = 4.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Judged:
    """A hypothesis, the evidence against it, and log10 of its expected number of false alarms with that included.

    `margins` are the differences in significance, in decades, to each of the others in their order; `margin` is the
    least of them, or its own significance if no other hypothesis is significant.
    """

    hypothesis: Hypothesis
    contradictions: Contradictions
    log10_chance: float
    margins: tuple[float, ...] = ()

    @property
    def margin(self) -> float:
        """The difference in significance to its closest rival, in decades."""
        return min((-self.log10_chance, *self.margins))


def confronted(
    map_a: ObjectMap, map_b: ObjectMap, evidence: Evidence, found: list[Hypothesis], config: AlignConfig
) -> tuple[Judged, ...]:
    """Return the hypotheses, penalised for missing objects: the best first, then by their expected false alarms.

    The best is the one that is separated from all others or, if there is none, the one of fewest expected false alarms.
    """
    judged = []
    if sum(one.log10_chance <= NOTABLE for one in found) > 1:
        found = with_look_alikes(evidence, found, config)
    for hypothesis in found:
        against = Contradictions()
        if hypothesis.log10_chance <= NOTABLE:
            against = contradictions(map_a, map_b, hypothesis.a_from_b, config.contradiction)
        price = config.contradiction.price * against.num_missing
        judged.append(
            Judged(hypothesis=hypothesis, contradictions=against, log10_chance=hypothesis.log10_chance + price)
        )
    return _compared(evidence, sorted(judged, key=lambda one: one.log10_chance))


def with_look_alikes(evidence: Evidence, found: list[Hypothesis], config: AlignConfig) -> list[Hypothesis]:
    """Return the hypotheses grown again by pairs that are as similar as those of the best one, regardless of rank.

    If many objects look the same, ranks among them are noise, and each hypothesis would contain a random few of these
    pairs.
    """
    is_plausible = alike(evidence, found[0])
    is_plausible[evidence.plausible[:, 0], evidence.plausible[:, 1]] = True
    wider = replace(evidence, plausible=np.argwhere(is_plausible))
    grew = [grown(wider, one.pairs, is_level=one.is_level) or one for one in found]
    return distinct(grew, evidence, config)


def _compared(evidence: Evidence, judged: list[Judged]) -> tuple[Judged, ...]:
    """Return the hypotheses, each with its margins to the significant others after it in the result."""
    notable = [one for one in judged if one.log10_chance <= NOTABLE]
    if len(notable) < 2:
        return tuple(judged)
    margins = np.zeros((len(notable), len(notable)))
    for i, j in combinations(range(len(notable)), 2):
        others = [one.hypothesis for k, one in enumerate(notable) if k not in (i, j)]
        one, other = ((notable[k].hypothesis, notable[k].contradictions) for k in (i, j))
        margins[i, j] = separation(evidence, one, other, others)
        margins[j, i] = -margins[i, j]
    np.fill_diagonal(margins, np.inf)
    worst = margins.min(axis=1)
    best = int(np.argmax(worst)) if worst.max() > 0 else 0
    order = [best, *(i for i in range(len(notable)) if i != best)]
    ranked = [replace(notable[i], margins=tuple(float(margins[i, j]) for j in order if j != i)) for i in order]
    return (*ranked, *judged[len(notable) :])


def why_refused(
    map_a: ObjectMap,
    judged: tuple[Judged, ...],
    evidence: Evidence,
    notes: tuple[str, ...],
    config: AlignConfig,
) -> NoAlignment | None:
    """Return why the best hypothesis is not believed; None if it is."""
    acceptance = config.acceptance

    def refusal(kind: Refusal, reason: str, rivals: tuple[Rival, ...] = ()) -> NoAlignment:
        return _refusal(judged, notes, kind, reason, rivals)

    most = len(judged[0].hypothesis.pairs) if judged else 0
    if most < acceptance.min_pairs:
        reason = f"at most {most} pairs of objects agree, {acceptance.min_pairs} are needed"
        return refusal(Refusal.TOO_FEW_PAIRS, reason)
    best, against = judged[0].hypothesis, judged[0].contradictions
    limit = acceptance.max_log10_chance
    expected, missing = against.num_expected, against.num_missing
    is_gap = expected >= config.contradiction.min_expected and missing > config.contradiction.max_missing * expected
    if is_gap or best.log10_chance <= limit < judged[0].log10_chance:
        reason = (
            f"{len(best.pairs)} pairs agree, but of {expected} objects that should be in both maps {missing} are not"
        )
        return refusal(Refusal.CONTRADICTED, reason)
    if best.log10_chance > limit:
        reason = (
            f"{len(best.pairs)} pairs agree, but two unrelated maps of this size have 10^{best.log10_chance:.1f} sets "
            f"of pairs as good; at most 10^{limit:.1f} are allowed"
        )
        return refusal(Refusal.CHANCE, reason)
    if _is_mirrored(best, evidence, config):
        reason = f"the mirror image of one map fits the other better than its {len(best.pairs)} pairs do"
        return refusal(Refusal.MIRRORED, reason)
    if judged[0].margin < acceptance.min_margin:
        reason = (
            f"a different alignment cannot be told from it: what separates the two is worth {judged[0].margin:.1f} "
            f"decades, {acceptance.min_margin:.1f} are needed"
        )
        return refusal(
            Refusal.RIVAL, reason, tuple(rival_of(map_a, one, evidence, config) for one in open_ones(judged, config))
        )
    return None


def why_uncertain(
    map_a: ObjectMap,
    judged: tuple[Judged, ...],
    evidence: Evidence,
    notes: tuple[str, ...],
    config: AlignConfig,
) -> NoAlignment | None:
    """Return why the places of the matched objects leave the rotation open; None if they do not."""
    acceptance, best = config.acceptance, judged[0].hypothesis
    points = map_a.centroids[best.pairs[:, 0]]
    spread_m = float(np.sqrt(max(np.linalg.eigvalsh(np.cov(points[:, :2].T))[0], 0.0)))
    if spread_m < acceptance.min_spread_m:
        reason = f"the {len(points)} pairs stand in a line: {spread_m:.2f} m across, {acceptance.min_spread_m} m needed"
        return _refusal(judged, notes, Refusal.COLLINEAR, reason)
    turn_deg = np.degrees(np.sqrt(np.trace(centroid_covariance(points, evidence, best, config)[:3, :3])))
    if turn_deg > acceptance.max_turn_deg:
        reason = f"the {len(points)} pairs leave the rotation uncertain by {turn_deg:.1f} degrees"
        return _refusal(judged, notes, Refusal.UNCERTAIN, reason)
    return None


def _refusal(
    judged: tuple[Judged, ...], notes: tuple[str, ...], kind: Refusal, reason: str, rivals: tuple[Rival, ...] = ()
) -> NoAlignment:
    return NoAlignment(
        refusal=kind,
        reason=reason,
        hypotheses=tuple(one.hypothesis for one in judged),
        contradictions=judged[0].contradictions if judged else Contradictions(),
        notes=notes,
        rivals=rivals,
    )


def open_ones(judged: tuple[Judged, ...], config: AlignConfig) -> tuple[Judged, ...]:
    """Return the best hypothesis and those that it is not separated from, of which one may be right."""
    best = judged[0]
    others = [
        one for one, margin in zip(judged[1:], best.margins, strict=False) if margin < config.acceptance.min_margin
    ]
    return (best, *others)


def rival_of(map_a: ObjectMap, one: Judged, evidence: Evidence, config: AlignConfig) -> Rival:
    """Return a hypothesis as a `Rival`: its transform, and the covariance of that if it is the right one."""
    points = map_a.centroids[one.hypothesis.pairs[:, 0]]
    return Rival(
        a_from_b=one.hypothesis.a_from_b,
        covariance=centroid_covariance(points, evidence, one.hypothesis, config),
        center_a=points.mean(axis=0),
        num_pairs=len(points),
        log10_chance=one.log10_chance,
        margin=one.margin,
    )


def _is_mirrored(best: Hypothesis, evidence: Evidence, config: AlignConfig) -> bool:
    """Return whether the mirror image of map b fits better, as it may if the matched objects lie in one plane.

    It is not tried if the pairs are too many to lie in one plane by chance.
    """
    if best.log10_chance < _SURE * config.acceptance.max_log10_chance:
        return False
    mirrored = replace(evidence, centroids_b=evidence.centroids_b * (1.0, -1.0, 1.0))
    found = searched(mirrored, config, is_level=best.is_level)
    return bool(found) and found[0].log10_chance < best.log10_chance


def centroid_covariance(
    points_a: NDArray[np.float64], evidence: Evidence, best: Hypothesis, config: AlignConfig
) -> NDArray[np.float64]:
    """Return the covariance (6, 6) that the centroids leave, the tilt being known to be small."""
    center_a = points_a.mean(axis=0)
    own = np.asarray(np.linalg.inv(centroid_information(points_a, evidence.sigma_m, config)), dtype=np.float64)
    return levelled(best.a_from_b, own, center_a, config.acceptance.tilt_sigmas_rad).covariance


def centroid_information(points_a: NDArray[np.float64], sigma_m: float, config: AlignConfig) -> NDArray[np.float64]:
    """Return the information (6, 6) of matched centroids (K, 3); whatever they leave open has the widest prior."""
    total = information(points_a, np.full(len(points_a), sigma_m), points_a.mean(axis=0))
    return total + np.diag([1.0 / np.radians(config.acceptance.max_tilt_deg) ** 2] * 3 + [0.0] * 3)
