"""Alignment of two overlapping maps, with its uncertainty; a refusal if there is no significant alignment."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.acceptance import Chance, effective_volume_m3
from hickory_stream.alignment.affinity import distinctive_log_ranks, fused_log_ranks, semantic_scores, why_no_semantics
from hickory_stream.alignment.answer import Alignment, MatchedPair, NoAlignment, Refusal
from hickory_stream.alignment.config import AlignConfig
from hickory_stream.alignment.grouping import grouped_probability, log_densities_of
from hickory_stream.alignment.hypothesis import Evidence, Hypothesis, matched
from hickory_stream.alignment.hypothesis import judged as judged_as
from hickory_stream.alignment.judgement import (
    Findings,
    centroid_information,
    confronted,
    rival_of,
    why_refused,
    why_uncertain,
)
from hickory_stream.alignment.object_map import ObjectMap
from hickory_stream.alignment.refinement import refined
from hickory_stream.alignment.registration import Levelled, common_covariance, levelled, registered
from hickory_stream.alignment.search import hypotheses_of
from hickory_stream.alignment.shape_scores import superquadric_scores

ShapeScores = Callable[[ObjectMap, ObjectMap], NDArray[np.float64]]


_ROUNDS = 4
# Surfaces say how objects in a line are turned where the evidence, in decades, is this multiple of the required one.
_SURE = 3.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PairScores:
    """The unary scores of all pairs, (N, M) each, None if a map lacks the data for them, and notes on missing data."""

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
    """Return the pose of map b in map a, or `NoAlignment` with the reason; without `shape_scores`, by semantics."""
    config = AlignConfig() if config is None else config
    refusal = _too_small(map_a, map_b, config)
    if refusal is not None:
        return refusal
    evidence, scores = evidence_of(map_a, map_b, config, shape_scores)
    judged = confronted(map_a, map_b, evidence, hypotheses_of(evidence, config), config)
    findings = Findings(map_a=map_a, evidence=evidence, judged=judged, notes=scores.notes)
    refusal = why_refused(findings, config)
    if refusal is not None:
        return refusal
    uncertain = why_uncertain(findings, config)
    if uncertain is not None and judged[0].log10_chance > _SURE * config.acceptance.max_log10_chance:
        return uncertain
    placed = _placed(map_a, map_b, evidence, judged[0].hypothesis, config)
    if uncertain is not None and not placed.is_certain(config):
        return uncertain
    return _answered(map_b, scores, findings, placed, config)


def evidence_of(
    map_a: ObjectMap, map_b: ObjectMap, config: AlignConfig, shape_scores: ShapeScores | None
) -> tuple[Evidence, PairScores]:
    """Return the evidence for judging hypotheses about two maps, and the scores of all pairs of objects."""
    scores = _scored(map_a, map_b, shape_scores)
    ranks = distinctive_log_ranks(scores.log_ranks)
    share = min(max(int(config.affinity.candidate_share * ranks.size), 1), ranks.size) - 1
    both = map_a.centroids, map_b.centroids
    volume_m3 = np.sqrt(effective_volume_m3(both[0]) * effective_volume_m3(both[1]))
    evidence = Evidence(
        centroids_a=map_a.centroids,
        centroids_b=map_b.centroids,
        log_ranks=scores.log_ranks,
        search_log_ranks=ranks,
        plausible=np.argwhere(ranks <= np.partition(ranks, share, axis=None)[share]),
        sigma_m=float(np.sqrt(2.0) * config.affinity.centroid_m),
        gate=config.affinity.gate + 0.5,
        chance=Chance(
            num_a=len(map_a),
            num_b=len(map_b),
            volume_m3=float(volume_m3),
            max_tilt_rad=float(np.radians(config.acceptance.max_tilt_deg)),
            tilt_price=10.0**config.acceptance.tilt_price,
            grouped=grouped_probability(both),
        ),
        log_densities=(log_densities_of(both[0], volume_m3), log_densities_of(both[1], volume_m3)),
        looks=tuple(score for score in (scores.semantic, scores.geometric) if score is not None),
    )
    return evidence, scores


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
        semantic=semantic, geometric=geometric, log_ranks=ranks, notes=tuple(note for note in notes if note is not None)
    )


def _answered(
    map_b: ObjectMap, scores: PairScores, findings: Findings, placed: "_Placed", config: AlignConfig
) -> Alignment:
    best, settled = placed.best, placed.settled
    map_a, judged = findings.map_a, findings.judged
    points = map_a.centroids[best.pairs[:, 0]]
    center_a = points.mean(axis=0)
    common_m = config.refinement.common_m, config.refinement.common_up_m
    max_turn_rad = float(np.radians(config.acceptance.most_tilt_deg))
    common = common_covariance(points, center_a, common_m, max_turn_rad)
    return Alignment(
        a_from_b=settled.a_from_b,
        pairs=matched_pairs(map_a, map_b, best, scores.semantic, scores.geometric),
        covariance=settled.covariance + common,
        center_a=center_a,
        log10_chance=judged[0].log10_chance,
        margin=judged[0].margin,
        rival=judged[1].hypothesis if len(judged) > 1 else None,
        contradictions=judged[0].contradictions,
        is_level=settled.is_level,
        is_refined=placed.is_refined,
        notes=scores.notes,
        rivals=tuple(rival_of(findings, one, config) for one in judged[1 : 1 + len(judged[0].margins)]),
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Placed:
    # Where map b lies: by the surfaces of the pairs where those were refined, else by their centroids.
    best: Hypothesis
    settled: Levelled
    is_refined: bool

    def is_certain(self, config: AlignConfig) -> bool:
        """Return whether surfaces say how the maps are turned, so that objects may stand in a line."""
        turn_deg = np.degrees(np.sqrt(np.trace(self.settled.covariance[:3, :3])))
        return self.is_refined and bool(turn_deg <= config.acceptance.max_turn_deg)


def _placed(map_a: ObjectMap, map_b: ObjectMap, evidence: Evidence, found: Hypothesis, config: AlignConfig) -> _Placed:
    best, settled = _settled(evidence, found, config)
    points = map_a.centroids[best.pairs[:, 0]]
    finer = refined(
        map_a,
        map_b,
        best.pairs,
        settled.a_from_b,
        mean=best.a_from_b,
        prior=centroid_information(points, evidence.sigma_m, config),
        config=config.refinement,
    )
    if finer is not None:
        settled = levelled(finer.a_from_b, finer.covariance, points.mean(axis=0), config.acceptance.tilt_sigmas_rad)
    return _Placed(best=best, settled=settled, is_refined=finer is not None)


def _settled(evidence: Evidence, best: Hypothesis, config: AlignConfig) -> tuple[Hypothesis, Levelled]:
    pairs = best.pairs
    for _ in range(_ROUNDS):
        points_a, points_b = evidence.centroids_a[pairs[:, 0]], evidence.centroids_b[pairs[:, 1]]
        own = registered(points_a, points_b, np.ones(len(pairs)), is_level=False)
        total = centroid_information(points_a, evidence.sigma_m, config)
        covariance = np.asarray(np.linalg.inv(total), dtype=np.float64)
        settled = levelled(own, covariance, points_a.mean(axis=0), config.acceptance.tilt_sigmas_rad)
        explained = matched(evidence, settled.a_from_b)
        if len(explained) < len(best.pairs) or np.array_equal(explained, pairs):
            break
        pairs = explained
    return judged_as(evidence, own, pairs, is_level=False), settled


def matched_pairs(
    map_a: ObjectMap,
    map_b: ObjectMap,
    hypothesis: Hypothesis,
    semantic: NDArray[np.float64] | None = None,
    geometric: NDArray[np.float64] | None = None,
) -> tuple[MatchedPair, ...]:
    """Return the pairs of a hypothesis with their scores (N, M), if known."""

    def known(values: NDArray[np.float64] | None, i: int, j: int) -> float | None:
        return None if values is None or not np.isfinite(values[i, j]) else float(values[i, j])

    return tuple(
        MatchedPair(
            id_a=int(map_a.ids[i]),
            id_b=int(map_b.ids[j]),
            semantic=known(semantic, i, j),
            geometric=known(geometric, i, j),
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
            count = f"{len(objects)} object{'' if len(objects) == 1 else 's'}"
            reason = f"map {name} holds {count}, at least {config.acceptance.min_pairs} are needed"
            return NoAlignment(refusal=Refusal.TOO_FEW_OBJECTS, reason=reason)
    return None
