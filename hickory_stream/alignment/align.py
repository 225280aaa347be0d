"""Find where two maps overlap, say how sure, and refuse when they do not."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.alignment.acceptance import Chance, effective_volume_m3
from hickory_stream.alignment.affinity import (
    AffinityConfig,
    build_affinity,
    fused_log_ranks,
    semantic_scores,
    why_no_semantics,
)
from hickory_stream.alignment.answer import Alignment, Contradictions, MatchedPair, NoAlignment, Refusal
from hickory_stream.alignment.consensus import ConsensusConfig, densest_clique
from hickory_stream.alignment.contradiction import ContradictionConfig, contradictions
from hickory_stream.alignment.hypothesis import Evidence, Hypothesis, grown
from hickory_stream.alignment.refinement import RefinementConfig, refined
from hickory_stream.alignment.registration import differs, information, tilt_rad
from hickory_stream.alignment.shape_scores import superquadric_scores
from hickory_stream.geometry.rigid import apply

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from hickory_stream.alignment.affinity import Affinity
    from hickory_stream.alignment.object_map import ObjectMap

    ShapeScores = Callable[[ObjectMap, ObjectMap], NDArray[np.float64]]


# Some tests are spared where the evidence is so many times what is asked for, in decades.
_CLEAR, _SURE = 3.0, 4.0


@dataclass(frozen=True, kw_only=True, slots=True)
class AcceptanceConfig:
    """What an alignment must show.

    Attributes:
        max_log10_chance: as good a set of pairs is expected in fewer than one in 10^x pairs of unrelated maps.
        min_margin: the best distinct rival is 10^x times as easily chance.
        min_pairs: fewer pairs are never enough.
        min_spread_m: the pairs' standard deviation across their main level direction, at least.
        max_turn_deg: the standard deviation of the rotation, at most.
        tilt_price: a tilt between the maps counts as 10^x times more easily chance: robots know gravity.
        max_tilt_deg: no more than this between the verticals of two maps.
        distinct_m, distinct_deg: transforms closer than this are one.
        num_rivals: how many distinct transforms are looked for.
    """

    max_log10_chance: float = -2.5
    min_margin: float = 2.0
    min_pairs: int = 4
    min_spread_m: float = 0.3
    max_turn_deg: float = 2.0
    tilt_price: float = 4.0
    max_tilt_deg: float = 25.0
    distinct_m: float = 0.5
    distinct_deg: float = 5.0
    num_rivals: int = 5


@dataclass(frozen=True, kw_only=True, slots=True)
class AlignConfig:
    """Everything that alignment is configured by."""

    affinity: AffinityConfig = field(default_factory=AffinityConfig)
    consensus: ConsensusConfig = field(default_factory=ConsensusConfig)
    acceptance: AcceptanceConfig = field(default_factory=AcceptanceConfig)
    contradiction: ContradictionConfig = field(default_factory=ContradictionConfig)
    refinement: RefinementConfig = field(default_factory=RefinementConfig)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PairScores:
    """The unary scores of all pairs, (N, M) each, None where a map lacks what it takes, and what that was."""

    semantic: NDArray[np.float64] | None
    geometric: NDArray[np.float64] | None
    log_ranks: NDArray[np.float64]
    notes: tuple[str, ...]


def align(
    map_a: ObjectMap,
    map_b: ObjectMap,
    config: AlignConfig | None = None,
    shape_scores: ShapeScores | None = superquadric_scores,
) -> Alignment | NoAlignment:
    """Return where map b lies in map a; `NoAlignment` with the reason when that cannot be told.

    Args:
        map_a: N objects; its frame is the one of the answer.
        map_b: M objects.
        config: the defaults where it is None.
        shape_scores: how shapes are compared; None for not at all.
    """
    config = AlignConfig() if config is None else config
    refusal = _too_small(map_a, map_b, config)
    if refusal is not None:
        return refusal
    evidence, scores = evidence_of(map_a, map_b, config, shape_scores)
    found = _searched(evidence, config, is_level=True)
    if not found or not _shows_gravity(evidence, found[0], config):
        # The maps may be tilted against one another after all.
        found = _ordered(found + _searched(evidence, config, is_level=False), evidence, config)
    judged = _confronted(map_a, map_b, found, config)
    refusal = _refused(map_a, judged, evidence, scores.notes, config)
    return _answered(map_a, map_b, scores, evidence, judged, config) if refusal is None else refusal


def evidence_of(
    map_a: ObjectMap, map_b: ObjectMap, config: AlignConfig, shape_scores: ShapeScores | None
) -> tuple[Evidence, PairScores]:
    """Return what hypotheses about two maps are judged by, and the scores of all pairs of objects."""
    scores = _scored(map_a, map_b, shape_scores)
    return _evidence(map_a, map_b, scores, config), scores


# ---- the steps ------------------------------------------------------------------------------------------------------


def _scored(map_a: ObjectMap, map_b: ObjectMap, shape_scores: ShapeScores | None) -> PairScores:
    semantic = semantic_scores(map_a, map_b)
    geometric = None if shape_scores is None else shape_scores(map_a, map_b)
    if geometric is not None and not np.isfinite(geometric).any():
        geometric = None
    notes = [why_no_semantics(map_a, map_b)]
    if geometric is None and shape_scores is not None:
        notes.append("no two objects have shapes that can be compared: aligned without shapes")
    ranks = fused_log_ranks((semantic, geometric), (len(map_a), len(map_b)))
    return PairScores(
        semantic=semantic,
        geometric=geometric,
        log_ranks=ranks,
        notes=tuple(note for note in notes if note is not None),
    )


def _evidence(map_a: ObjectMap, map_b: ObjectMap, scores: PairScores, config: AlignConfig) -> Evidence:
    ranks = scores.log_ranks
    share = min(max(int(config.affinity.candidate_share * ranks.size), 1), ranks.size) - 1
    volume_m3 = np.sqrt(effective_volume_m3(map_a.centroids) * effective_volume_m3(map_b.centroids))
    return Evidence(
        centroids_a=map_a.centroids,
        centroids_b=map_b.centroids,
        log_ranks=ranks,
        plausible=np.argwhere(ranks <= np.partition(ranks, share, axis=None)[share]),
        sigma_m=float(np.sqrt(2.0) * config.affinity.centroid_m),
        gate=config.affinity.gate + 0.5,
        chance=Chance(
            num_a=len(map_a),
            num_b=len(map_b),
            volume_m3=float(volume_m3),
            max_tilt_rad=float(np.radians(config.acceptance.max_tilt_deg)),
            tilt_price=10.0**config.acceptance.tilt_price,
        ),
    )


def _searched(evidence: Evidence, config: AlignConfig, *, is_level: bool) -> list[Hypothesis]:
    """Return the distinct hypotheses, the least easily chance first."""
    affinity = build_affinity(
        evidence.centroids_a, evidence.centroids_b, evidence.log_ranks, config.affinity, is_level=is_level
    )
    alive = np.ones(len(affinity), dtype=bool)
    found: list[Hypothesis] = []
    for _ in range(config.acceptance.num_rivals):
        if len(found) > 1 and _is_clear(found, config):
            break
        clique = densest_clique(affinity, alive, config.consensus)
        if len(clique) < 3:
            break
        alive[clique] = False
        hypothesis = _better(evidence, affinity.pairs[clique], is_level=is_level)
        if hypothesis is not None:
            found.append(hypothesis)
            alive &= ~_explained(affinity, hypothesis, evidence)
        found = _ordered(found, evidence, config)
    return found


def _better(evidence: Evidence, pairs: NDArray[np.int64], *, is_level: bool) -> Hypothesis | None:
    """Return the level hypothesis of some pairs, or the tilted one where it is better; None if neither fits."""
    tilted = grown(evidence, pairs, is_level=False)
    if tilted is not None and tilt_rad(tilted.a_from_b) > evidence.chance.max_tilt_rad:
        tilted = None
    level = grown(evidence, pairs, is_level=True) if is_level else None
    if level is None or tilted is None:
        return level or tilted
    return tilted if tilted.log10_chance < level.log10_chance else level


def _is_clear(found: list[Hypothesis], config: AlignConfig) -> bool:
    """Return whether no further rival can matter: the next clique is lighter than those that were found."""
    acceptance = config.acceptance
    best, second = found[0].log10_chance, found[1].log10_chance
    return best < _CLEAR * acceptance.max_log10_chance and second - best > _CLEAR * acceptance.min_margin


def _shows_gravity(evidence: Evidence, best: Hypothesis, config: AlignConfig) -> bool:
    """Return whether a level hypothesis would not hold if the maps were tilted: many pairs, spread to all sides."""
    if not best.is_level or best.log10_chance > _CLEAR * config.acceptance.max_log10_chance:
        return False
    points = evidence.centroids_a[best.pairs[:, 0]]
    total = information(points, np.full(len(points), evidence.sigma_m), points.mean(axis=0))
    tilts = np.linalg.pinv(total)[:2, :2]
    is_fixed = np.linalg.matrix_rank(total) == 6
    return bool(is_fixed and np.degrees(np.sqrt(np.linalg.eigvalsh(tilts)[1])) < config.acceptance.max_turn_deg)


def _explained(affinity: Affinity, hypothesis: Hypothesis, evidence: Evidence) -> NDArray[np.bool_]:
    moved = apply(hypothesis.a_from_b, evidence.centroids_b)
    offsets = evidence.centroids_a[affinity.pairs[:, 0]] - moved[affinity.pairs[:, 1]]
    return np.asarray((offsets**2).sum(axis=1) < (evidence.gate * evidence.sigma_m) ** 2)


def _ordered(found: list[Hypothesis], evidence: Evidence, config: AlignConfig) -> list[Hypothesis]:
    """Return the hypotheses that differ from every better one."""
    acceptance = config.acceptance
    distinct: list[Hypothesis] = []
    for hypothesis in sorted(found, key=lambda h: h.log10_chance):
        center_b = evidence.centroids_b[hypothesis.pairs[:, 1]].mean(axis=0)
        if all(
            differs(
                hypothesis.a_from_b,
                better.a_from_b,
                center_b,
                distance_m=acceptance.distinct_m,
                angle_rad=np.radians(acceptance.distinct_deg),
            )
            for better in distinct
        ):
            distinct.append(hypothesis)
    return distinct


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Judged:
    """A hypothesis, what speaks against it, and how easily it is chance with that taken into account."""

    hypothesis: Hypothesis
    contradictions: Contradictions
    log10_chance: float


def _confronted(
    map_a: ObjectMap, map_b: ObjectMap, found: list[Hypothesis], config: AlignConfig
) -> tuple[_Judged, ...]:
    """Return the hypotheses with what was not seen counted against them, the least easily chance first."""
    judged = []
    for hypothesis in found:
        against = Contradictions()
        if hypothesis.log10_chance <= config.acceptance.max_log10_chance:
            against = contradictions(map_a, map_b, hypothesis.a_from_b, config.contradiction)
        price = config.contradiction.price * against.num_missing
        judged.append(
            _Judged(hypothesis=hypothesis, contradictions=against, log10_chance=hypothesis.log10_chance + price)
        )
    return tuple(sorted(judged, key=lambda one: one.log10_chance))


def _refused(
    map_a: ObjectMap,
    judged: tuple[_Judged, ...],
    evidence: Evidence,
    notes: tuple[str, ...],
    config: AlignConfig,
) -> NoAlignment | None:
    """Return why the best hypothesis is not enough; None when it is."""
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
    turn_deg = np.degrees(np.sqrt(np.trace(_covariance(points, evidence, best, config)[:3, :3])))
    if turn_deg > acceptance.max_turn_deg:
        reason = f"the {len(points)} pairs leave the rotation uncertain by {turn_deg:.1f} degrees"
        return refusal(Refusal.UNCERTAIN, reason)
    if _is_mirrored(best, evidence, config):
        reason = f"the mirror image of one map fits the other better than its {len(best.pairs)} pairs do"
        return refusal(Refusal.MIRRORED, reason)
    if _margin(judged) < acceptance.min_margin:
        reason = f"a different alignment is nearly as good: only 10^{_margin(judged):.1f} times as easily chance"
        return refusal(Refusal.RIVAL, reason)
    return None


def _answered(
    map_a: ObjectMap,
    map_b: ObjectMap,
    scores: PairScores,
    evidence: Evidence,
    judged: tuple[_Judged, ...],
    config: AlignConfig,
) -> Alignment:
    best = judged[0].hypothesis
    points = map_a.centroids[best.pairs[:, 0]]
    finer = refined(
        map_a,
        map_b,
        best.pairs,
        best.a_from_b,
        sigma_m=evidence.sigma_m,
        tilt_sigma_rad=float(np.radians(config.affinity.level_tilt_deg)) if best.is_level else None,
        config=config.refinement,
    )
    return Alignment(
        a_from_b=best.a_from_b if finer is None else finer.a_from_b,
        pairs=_matched_pairs(map_a, map_b, scores, best),
        covariance=_covariance(points, evidence, best, config) if finer is None else finer.covariance,
        center_a=points.mean(axis=0),
        log10_chance=judged[0].log10_chance,
        margin=_margin(judged),
        rival=judged[1].hypothesis if len(judged) > 1 else None,
        contradictions=judged[0].contradictions,
        is_level=best.is_level,
        is_refined=finer is not None,
        notes=scores.notes,
    )


def _is_mirrored(best: Hypothesis, evidence: Evidence, config: AlignConfig) -> bool:
    """Return whether the mirror image of map b is the better explanation: what lies along the mirror fits both.

    Not looked for where the pairs are too many to lie there by chance.
    """
    if best.log10_chance < _SURE * config.acceptance.max_log10_chance:
        return False
    mirrored = replace(evidence, centroids_b=evidence.centroids_b * (1.0, -1.0, 1.0))
    found = _searched(mirrored, config, is_level=best.is_level)
    return bool(found) and found[0].log10_chance < best.log10_chance


def _margin(judged: tuple[_Judged, ...]) -> float:
    """Return by how much less easily chance the best is than its rival; than nothing special, where there is none."""
    rival = min(judged[1].log10_chance, 0.0) if len(judged) > 1 else 0.0
    return rival - judged[0].log10_chance


def _covariance(
    points_a: NDArray[np.float64], evidence: Evidence, best: Hypothesis, config: AlignConfig
) -> NDArray[np.float64]:
    """Return the covariance (6, 6) that the centroids leave; gravity fixes the tilt of level maps."""
    total = information(points_a, np.full(len(points_a), evidence.sigma_m), points_a.mean(axis=0))
    if best.is_level:
        total[:2, :2] += np.eye(2) / np.radians(config.affinity.level_tilt_deg) ** 2
    return np.asarray(np.linalg.pinv(total))


def _matched_pairs(
    map_a: ObjectMap, map_b: ObjectMap, scores: PairScores, hypothesis: Hypothesis
) -> tuple[MatchedPair, ...]:
    def known(values: NDArray[np.float64] | None, i: int, j: int) -> float | None:
        return None if values is None or not np.isfinite(values[i, j]) else float(values[i, j])

    return tuple(
        MatchedPair(
            id_a=int(map_a.ids[i]),
            id_b=int(map_b.ids[j]),
            semantic=known(scores.semantic, i, j),
            geometric=known(scores.geometric, i, j),
            rank=float(np.exp(rank)),
            residual_m=float(residual),
        )
        for (i, j), rank, residual in zip(hypothesis.pairs, hypothesis.log_ranks, hypothesis.residuals_m, strict=True)
    )


def _too_small(map_a: ObjectMap, map_b: ObjectMap, config: AlignConfig) -> NoAlignment | None:
    for name, objects in (("a", map_a), ("b", map_b)):
        if not len(objects):
            return NoAlignment(refusal=Refusal.EMPTY, reason=f"map {name} holds no object")
        if len(objects) < config.acceptance.min_pairs:
            reason = f"map {name} holds {len(objects)} objects, {config.acceptance.min_pairs} pairs are needed"
            return NoAlignment(refusal=Refusal.TOO_FEW_OBJECTS, reason=reason)
    return None
