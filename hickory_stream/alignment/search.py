"""Search for distinct transforms between two maps, each supported by many pairs of objects."""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.affinity import Affinity, build_affinity
from hickory_stream.alignment.config import AlignConfig
from hickory_stream.alignment.consensus import densest_clique
from hickory_stream.alignment.hypothesis import Evidence, Hypothesis, grown
from hickory_stream.alignment.registration import differs, information, tilt_rad
from hickory_stream.geometry.rigid import apply

# Further searches are skipped if the evidence exceeds the required one by this many decades.
_CLEAR = 4.0
# log10 of expected false alarms from which on hypotheses occur in unrelated maps, and are not counted as rivals.
NOTABLE = -1.0


def hypotheses_of(evidence: Evidence, config: AlignConfig) -> list[Hypothesis]:
    """Return the distinct hypotheses: level ones and, unless level is certain, tilted ones."""
    found = searched(evidence, config, is_level=True)
    if found and _shows_gravity(evidence, found[0], config):
        return found
    return distinct(found + searched(evidence, config, is_level=False), evidence, config)


def searched(evidence: Evidence, config: AlignConfig, *, is_level: bool) -> list[Hypothesis]:
    """Return the distinct hypotheses, those with the fewest expected false alarms first."""
    affinity = build_affinity(
        evidence.centroids_a, evidence.centroids_b, evidence.search_log_ranks, config.affinity, is_level=is_level
    )
    alive = np.ones(len(affinity), dtype=bool)
    found: list[Hypothesis] = []
    for _ in range(config.acceptance.num_rivals):
        if len(found) > 1 and _is_clear(found, config):
            break
        if sum(one.log10_uniform > NOTABLE for one in found) >= config.acceptance.num_insignificant:
            break
        clique = densest_clique(affinity, alive, config.consensus)
        if len(clique) < 3:
            break
        alive[clique] = False
        hypothesis = _better(evidence, affinity.pairs[clique], is_level=is_level)
        if hypothesis is not None:
            found.append(hypothesis)
            alive &= ~_explained(affinity, hypothesis, evidence)
        found = distinct(found, evidence, config)
    return found


def _better(evidence: Evidence, pairs: NDArray[np.int64], *, is_level: bool) -> Hypothesis | None:
    tilted = grown(evidence, pairs, is_level=False)
    if tilted is not None and tilt_rad(tilted.a_from_b) > evidence.chance.max_tilt_rad:
        tilted = None
    level = grown(evidence, pairs, is_level=True) if is_level else None
    if level is None or tilted is None:
        return level or tilted
    return tilted if tilted.log10_uniform < level.log10_uniform else level


def _is_clear(found: list[Hypothesis], config: AlignConfig) -> bool:
    # The next clique has less weight than an insignificant one.
    best, second = found[0].log10_uniform, found[1].log10_uniform
    return best < _CLEAR * config.acceptance.max_log10_chance and second > NOTABLE


def _shows_gravity(evidence: Evidence, best: Hypothesis, config: AlignConfig) -> bool:
    if not best.is_level or best.log10_uniform > _CLEAR * config.acceptance.max_log10_chance:
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


def distinct(found: list[Hypothesis], evidence: Evidence, config: AlignConfig) -> list[Hypothesis]:
    """Return the hypotheses that differ from every better one."""
    acceptance = config.acceptance
    kept: list[Hypothesis] = []
    for hypothesis in sorted(found, key=lambda h: h.log10_uniform):
        center_b = evidence.centroids_b[hypothesis.pairs[:, 1]].mean(axis=0)
        if all(
            differs(
                hypothesis.a_from_b,
                better.a_from_b,
                center_b,
                distance_m=acceptance.distinct_m,
                angle_rad=np.radians(acceptance.distinct_deg),
            )
            for better in kept
        ):
            kept.append(hypothesis)
    return kept
