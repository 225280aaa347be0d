"""Acceptance of the best hypothesis: by its expected number of false alarms, rivals, geometry and missing objects."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.alignment.answer import Contradictions, NoAlignment, Refusal
from hickory_stream.alignment.contradiction import contradictions
from hickory_stream.alignment.registration import information
from hickory_stream.alignment.search import searched

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.alignment.align_config import AlignConfig
    from hickory_stream.alignment.hypothesis import Evidence, Hypothesis
    from hickory_stream.alignment.object_map import ObjectMap

# Mirrored hypotheses are not tried if the evidence, in decades, is so many times what is required.
_SURE = 4.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Judged:
    """A hypothesis, the evidence against it, and log10 of its expected number of false alarms with that included."""

    hypothesis: Hypothesis
    contradictions: Contradictions
    log10_chance: float


def confronted(map_a: ObjectMap, map_b: ObjectMap, found: list[Hypothesis], config: AlignConfig) -> tuple[Judged, ...]:
    """Return the hypotheses with missing objects counted against them, fewest expected false alarms first."""
    judged = []
    for hypothesis in found:
        against = Contradictions()
        if hypothesis.log10_chance <= config.acceptance.max_log10_chance:
            against = contradictions(map_a, map_b, hypothesis.a_from_b, config.contradiction)
        price = config.contradiction.price * against.num_missing
        judged.append(
            Judged(hypothesis=hypothesis, contradictions=against, log10_chance=hypothesis.log10_chance + price)
        )
    return tuple(sorted(judged, key=lambda one: one.log10_chance))


def why_refused(
    map_a: ObjectMap,
    judged: tuple[Judged, ...],
    evidence: Evidence,
    notes: tuple[str, ...],
    config: AlignConfig,
) -> NoAlignment | None:
    """Return why the best hypothesis is refused; None if it is accepted."""
    acceptance = config.acceptance

    def refusal(kind: Refusal, reason: str) -> NoAlignment:
        return NoAlignment(
            refusal=kind,
            reason=reason,
            hypotheses=tuple(one.hypothesis for one in judged),
            contradictions=judged[0].contradictions if judged else Contradictions(),
            notes=notes,
        )

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
    points = map_a.centroids[best.pairs[:, 0]]
    spread_m = float(np.sqrt(max(np.linalg.eigvalsh(np.cov(points[:, :2].T))[0], 0.0)))
    if spread_m < acceptance.min_spread_m:
        reason = f"the {len(points)} pairs stand in a line: {spread_m:.2f} m across, {acceptance.min_spread_m} m needed"
        return refusal(Refusal.COLLINEAR, reason)
    turn_deg = np.degrees(np.sqrt(np.trace(centroid_covariance(points, evidence, best, config)[:3, :3])))
    if turn_deg > acceptance.max_turn_deg:
        reason = f"the {len(points)} pairs leave the rotation uncertain by {turn_deg:.1f} degrees"
        return refusal(Refusal.UNCERTAIN, reason)
    if _is_mirrored(best, evidence, config):
        reason = f"the mirror image of one map fits the other better than its {len(best.pairs)} pairs do"
        return refusal(Refusal.MIRRORED, reason)
    if margin_of(judged) < acceptance.min_margin:
        reason = (
            f"a different alignment is nearly as good: only 10^{margin_of(judged):.1f} times the expected false alarms"
        )
        return refusal(Refusal.RIVAL, reason)
    return None


def margin_of(judged: tuple[Judged, ...]) -> float:
    """Return log10 of the ratio of the expected false alarms of the best rival (1 without one) and of the best."""
    rival = min(judged[1].log10_chance, 0.0) if len(judged) > 1 else 0.0
    return rival - judged[0].log10_chance


def _is_mirrored(best: Hypothesis, evidence: Evidence, config: AlignConfig) -> bool:
    """Return whether the mirror image of map b is the better explanation: what lies along the mirror fits both.

    Not looked for where the pairs are too many to lie there by chance.
    """
    if best.log10_chance < _SURE * config.acceptance.max_log10_chance:
        return False
    mirrored = replace(evidence, centroids_b=evidence.centroids_b * (1.0, -1.0, 1.0))
    found = searched(mirrored, config, is_level=best.is_level)
    return bool(found) and found[0].log10_chance < best.log10_chance


def centroid_covariance(
    points_a: NDArray[np.float64], evidence: Evidence, best: Hypothesis, config: AlignConfig
) -> NDArray[np.float64]:
    """Return the covariance (6, 6) that the centroids leave; gravity fixes the tilt of level maps."""
    total = information(points_a, np.full(len(points_a), evidence.sigma_m), points_a.mean(axis=0))
    if best.is_level:
        total[:2, :2] += np.eye(2) / np.radians(config.affinity.level_tilt_deg) ** 2
    return np.asarray(np.linalg.pinv(total))
