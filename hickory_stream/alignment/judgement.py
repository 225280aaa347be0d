"""Acceptance of the best hypothesis: by its expected number of false alarms, rivals, geometry and missing objects.

Where a place repeats itself, transforms that lay its copies on one another explain the most, and hide the true one. It
is found by the objects of which a map has no second: each two of them at one distance in both maps give a transform.
"""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.answer import Contradictions, NoAlignment, Refusal, Rival, count_text
from hickory_stream.alignment.config import AlignConfig
from hickory_stream.alignment.contradiction import contradictions
from hickory_stream.alignment.hypothesis import Evidence, Hypothesis, grown
from hickory_stream.alignment.object_map import ObjectMap
from hickory_stream.alignment.registration import information, levelled
from hickory_stream.alignment.rivalry import alike, separation
from hickory_stream.alignment.search import NOTABLE, distinct, searched

# A thing that is in a map once looks like so many of the other's at most, itself and one by chance.
_MOST_ALIKE = 2
_MOST_PAIRS = 16
# Where more of a map's objects are lone the search finds what there is.
_MOST_LONE = 0.5


def unrepeated_hypotheses(evidence: Evidence, is_alike: NDArray[np.bool_]) -> list[Hypothesis]:
    """Return the hypotheses grown from each two pairs of objects without look-alikes; none if most objects are such.

    `is_alike` (N, M): which objects look alike.
    """
    is_lone_a, is_lone_b = (is_alike.sum(axis=axis) <= _MOST_ALIKE for axis in (1, 0))
    if min(is_lone_a.mean(), is_lone_b.mean()) > _MOST_LONE:
        return []
    pairs = np.argwhere(is_alike & is_lone_a[:, None] & is_lone_b)
    pairs = pairs[np.argsort(evidence.log_ranks[pairs[:, 0], pairs[:, 1]], kind="stable")[:_MOST_PAIRS]]
    found = []
    for i, j in combinations(range(len(pairs)), 2):
        two = pairs[[i, j]]
        if _agree(evidence, two):
            hypothesis = grown(evidence, two, is_level=True)
            if hypothesis is not None:
                found.append(hypothesis)
    return found


def _agree(evidence: Evidence, two: NDArray[np.int64]) -> bool:
    if two[0, 0] == two[1, 0] or two[0, 1] == two[1, 1]:
        return False
    step_a = np.subtract(*evidence.centroids_a[two[:, 0]])
    step_b = np.subtract(*evidence.centroids_b[two[:, 1]])
    level_a, level_b = np.hypot(*step_a[:2]), np.hypot(*step_b[:2])
    # A distance has the noise of two residuals.
    reach_m = evidence.gate * np.sqrt(2.0) * evidence.sigma_m
    return bool(
        min(level_a, level_b) > reach_m and abs(level_a - level_b) < reach_m and abs(step_a[2] - step_b[2]) < reach_m
    )


# Mirrored hypotheses are not tried if the evidence, in decades, is this multiple of the required one.
_SURE = 5.0
# What mirrors the second axis.
_MIRROR = np.array([1.0, -1.0, 1.0, 1.0])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Findings:
    """What is known of two maps when it is decided: the hypotheses, best first, and what they rest on."""

    map_a: ObjectMap
    evidence: Evidence
    judged: "tuple[Judged, ...]"
    notes: tuple[str, ...]

    def refusal(self, kind: Refusal, reason: str, rivals: tuple[Rival, ...] = ()) -> NoAlignment:
        """Return the refusal of all of them."""
        return NoAlignment(
            refusal=kind,
            reason=reason,
            hypotheses=tuple(one.hypothesis for one in self.judged),
            contradictions=self.judged[0].contradictions if self.judged else Contradictions(),
            notes=self.notes,
            rivals=rivals,
        )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Judged:
    """A hypothesis, the evidence against it, and log10 of its expected number of false alarms with that included."""

    hypothesis: Hypothesis
    contradictions: Contradictions
    log10_chance: float
    #: the same where nothing stands in groups; it decides whether this is a rival of others
    log10_uniform: float
    #: differences in significance, in decades, to each of the others in their order
    margins: tuple[float, ...] = ()

    @property
    def margin(self) -> float:
        """The difference in significance to its closest rival, in decades."""
        return min((-self.log10_chance, *self.margins))


def confronted(
    map_a: ObjectMap, map_b: ObjectMap, evidence: Evidence, found: list[Hypothesis], config: AlignConfig
) -> tuple[Judged, ...]:
    """Return the hypotheses, penalised for missing objects: the best first, then by their expected false alarms.

    The best is separated from all others or, if there is none such, has the fewest expected false alarms.
    """
    judged = []
    for hypothesis in _among_look_alikes(evidence, found, config):
        against = Contradictions()
        if hypothesis.log10_uniform <= NOTABLE:
            against = contradictions(map_a, map_b, hypothesis.a_from_b, config.contradiction)
        price = config.contradiction.price * against.missing
        judged.append(
            Judged(
                hypothesis=hypothesis,
                contradictions=against,
                log10_chance=hypothesis.log10_chance + price,
                log10_uniform=hypothesis.log10_uniform + price,
            )
        )
    return _compared(evidence, sorted(judged, key=lambda one: one.log10_chance))


def _among_look_alikes(evidence: Evidence, found: list[Hypothesis], config: AlignConfig) -> list[Hypothesis]:
    # If there are rivals, or most pairs look alike, hypotheses are grown again by all pairs that look alike.
    if not found or found[0].log10_uniform > NOTABLE:
        return found
    is_alike = alike(evidence, found[0])
    is_sure = found[0].log10_uniform <= config.acceptance.max_log10_chance
    are_most = is_sure and bool(is_alike.mean() > config.affinity.candidate_share)
    if not are_most and sum(one.log10_uniform <= NOTABLE for one in found) < 2:
        return found
    wider = _with_all_alike(evidence, is_alike)
    grew = [grown(wider, one.pairs, is_level=one.is_level) or one for one in found]
    return distinct([*grew, *unrepeated_hypotheses(wider, is_alike)], evidence, config)


def _with_all_alike(evidence: Evidence, is_alike: NDArray[np.bool_]) -> Evidence:
    # If many objects look the same, ranks among them are noise: each hypothesis would hold a random few of these pairs.
    is_plausible = is_alike.copy()
    is_plausible[evidence.plausible[:, 0], evidence.plausible[:, 1]] = True
    return replace(evidence, plausible=np.argwhere(is_plausible))


def _compared(evidence: Evidence, judged: list[Judged]) -> tuple[Judged, ...]:
    notable = [one for one in judged if one.log10_uniform <= NOTABLE]
    if len(notable) < 2:
        return tuple(judged)
    others_left = [one for one in judged if one.log10_uniform > NOTABLE]
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
    return (*ranked, *others_left)


def why_refused(findings: Findings, config: AlignConfig) -> NoAlignment | None:
    """Return why the best hypothesis is not believed; None if it is."""
    acceptance, judged, refusal = config.acceptance, findings.judged, findings.refusal
    most = len(judged[0].hypothesis.pairs) if judged else 0
    if most < acceptance.min_pairs:
        reason = f"{most} pairs of objects agree in the likeliest alignment, {acceptance.min_pairs} are needed"
        return refusal(Refusal.TOO_FEW_PAIRS, reason)
    best, against = judged[0].hypothesis, judged[0].contradictions
    limit = acceptance.max_log10_chance
    expected, missing = against.num_expected, against.num_missing
    is_gap = against.missing > config.contradiction.max_missing * against.expected
    is_gap = is_gap and expected >= config.contradiction.min_expected
    if is_gap or best.log10_chance <= limit < judged[0].log10_chance:
        reason = (
            f"{len(best.pairs)} pairs agree, but of {expected} objects that should be in both maps {missing} are not"
        )
        return refusal(Refusal.CONTRADICTED, reason)
    if best.log10_chance > limit:
        reason = (
            f"{len(best.pairs)} pairs agree, but between two unrelated maps of this size "
            f"{count_text(best.log10_chance)} sets of pairs that agree as well are expected; at most "
            f"{count_text(limit)} is accepted"
        )
        return refusal(Refusal.CHANCE, reason)
    if _is_mirrored(findings, config):
        reason = f"the mirror image of one map fits the other better than its {len(best.pairs)} pairs do"
        return refusal(Refusal.MIRRORED, reason)
    if judged[0].margin < acceptance.min_margin:
        reason = (
            f"a different alignment fits nearly as well: {judged[0].margin:.1f} decades of evidence separate the two, "
            f"{acceptance.min_margin:.1f} are needed"
        )
        rivals = tuple(rival_of(findings, one, config) for one in open_ones(judged, config))
        return refusal(Refusal.RIVAL, reason, rivals)
    return None


def why_uncertain(findings: Findings, config: AlignConfig) -> NoAlignment | None:
    """Return why the places of the matched objects leave the rotation open; None if they do not."""
    acceptance, best = config.acceptance, findings.judged[0].hypothesis
    points = findings.map_a.centroids[best.pairs[:, 0]]
    spread_m = float(np.sqrt(max(np.linalg.eigvalsh(np.cov(points[:, :2].T))[0], 0.0)))
    if spread_m < acceptance.min_spread_m:
        reason = f"the {len(points)} pairs stand in a line: {spread_m:.2f} m across, {acceptance.min_spread_m} m needed"
        return findings.refusal(Refusal.COLLINEAR, reason)
    turn_deg = np.degrees(np.sqrt(np.trace(centroid_covariance(points, findings.evidence, best, config)[:3, :3])))
    if turn_deg > acceptance.max_turn_deg:
        reason = f"the {len(points)} pairs leave the rotation uncertain by {turn_deg:.1f} degrees"
        return findings.refusal(Refusal.UNCERTAIN, reason)
    return None


def open_ones(judged: tuple[Judged, ...], config: AlignConfig) -> tuple[Judged, ...]:
    """Return the best hypothesis and the others that are not separated from it."""
    best = judged[0]
    others = [
        one for one, margin in zip(judged[1:], best.margins, strict=False) if margin < config.acceptance.min_margin
    ]
    return (best, *others)


def rival_of(findings: Findings, one: Judged, config: AlignConfig) -> Rival:
    """Return a hypothesis as a `Rival`: its transform, and the covariance of that if it is the right one."""
    points = findings.map_a.centroids[one.hypothesis.pairs[:, 0]]
    return Rival(
        a_from_b=one.hypothesis.a_from_b,
        covariance=centroid_covariance(points, findings.evidence, one.hypothesis, config),
        center_a=points.mean(axis=0),
        num_pairs=len(points),
        log10_chance=one.log10_chance,
        margin=one.margin,
    )


def _is_mirrored(findings: Findings, config: AlignConfig) -> bool:
    # Not tried if the pairs are too many to lie in one plane by chance. A place that repeats itself has a mirror image
    # that does so, too: then it counts as a rival.
    evidence, best = findings.evidence, findings.judged[0].hypothesis
    if best.log10_uniform < _SURE * config.acceptance.max_log10_chance:
        return False
    mirrored = replace(evidence, centroids_b=evidence.centroids_b * _MIRROR[:3])
    found = searched(mirrored, config, is_level=best.is_level)
    if not found or found[0].log10_uniform >= best.log10_uniform:
        return False
    image = replace(found[0], a_from_b=found[0].a_from_b * _MIRROR)
    others = [one.hypothesis for one in findings.judged[1:] if one.log10_uniform <= NOTABLE]
    nothing = Contradictions()
    return separation(evidence, (best, nothing), (image, nothing), others) < config.acceptance.min_margin


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
