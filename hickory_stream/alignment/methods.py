"""The paper's methods and competing methods by name, on the same maps, for comparison only.

`sq`, `bbox` and `semantic` differ in the shape score alone: superquadrics, bounding boxes, none. `sq-paper`,
`roman-one` and `roman-xl` (by pairs of submaps) follow ROMAN (Peterson et al., 2025): its scores, thresholds and
gradient ascent, and any three pairs are an alignment; `sq-paper` has Eq. (sgeo) as the shape score.
"""

from collections.abc import Callable
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.align import align, evidence_of, matched_pairs
from hickory_stream.alignment.answer import Alignment, NoAlignment, Refusal
from hickory_stream.alignment.config import AlignConfig
from hickory_stream.alignment.consensus import ascended_clique
from hickory_stream.alignment.hypothesis import judged
from hickory_stream.alignment.object_map import ObjectMap, taken
from hickory_stream.alignment.registration import information, registered
from hickory_stream.alignment.shape_scores import box_scores, literal_scores, point_scores, superquadric_scores

ShapeScores = Callable[[ObjectMap, ObjectMap], NDArray[np.float64]]

Method = Literal["sq", "sq-paper", "bbox", "roman-one", "roman-xl", "semantic"]
METHODS: tuple[Method, ...] = get_args(Method)

# ROMAN's published parameters.
_COSINE_MIN, _COSINE_MAX = 0.5, 0.7
_SIGMA_M, _EPSILON_M = 0.4, 0.6
_MIN_MATCHES, _MAX_CANDIDATES = 3, 3000
_SUBMAP_RADIUS_M, _SUBMAP_STEP_M, _SUBMAP_OBJECTS = 15.0, 10.0, 40


def align_by(
    method: Method, map_a: ObjectMap, map_b: ObjectMap, config: AlignConfig | None = None
) -> Alignment | NoAlignment:
    """Return the answer of a method; for competing methods `log10_chance` is computed, but not used to refuse."""
    config = AlignConfig() if config is None else config
    match method:
        case "sq":
            return align(map_a, map_b, config, superquadric_scores)
        case "bbox":
            return align(map_a, map_b, config, box_scores)
        case "semantic":
            return align(map_a, map_b, config, None)
        case "sq-paper":
            return _roman(map_a, map_b, config, literal_scores)
        case "roman-one":
            return _roman(map_a, map_b, config, point_scores)
        case "roman-xl":
            return _roman_submaps(map_a, map_b, config)


def _roman(map_a: ObjectMap, map_b: ObjectMap, config: AlignConfig, shape: ShapeScores) -> Alignment | NoAlignment:
    return _answer(map_a, map_b, _roman_pairs(map_a, map_b, config, shape), config)


def _roman_pairs(map_a: ObjectMap, map_b: ObjectMap, config: AlignConfig, shape: ShapeScores) -> NDArray[np.int64]:
    if not len(map_a) or not len(map_b):
        return np.empty((0, 2), dtype=np.int64)
    unary = np.sqrt(_rescaled_cosines(map_a, map_b) * np.nan_to_num(shape(map_a, map_b), nan=1.0))
    order = np.argsort(-unary, axis=None, kind="stable")[:_MAX_CANDIDATES]
    order = np.sort(order[unary.ravel()[order] > 0])
    if not len(order):
        return np.empty((0, 2), dtype=np.int64)
    pairs = np.stack(np.divmod(order, unary.shape[1]), axis=1)
    scores = unary[pairs[:, 0], pairs[:, 1]]
    fused = np.cbrt(
        _gravity_scores(map_a.centroids[pairs[:, 0]], map_b.centroids[pairs[:, 1]]) * np.outer(scores, scores)
    )
    shares = (pairs[:, None] == pairs[None]).any(axis=2)
    clique = ascended_clique(np.where(shares, 0.0, fused), scores, config.consensus)
    return pairs[clique]


def _rescaled_cosines(map_a: ObjectMap, map_b: ObjectMap) -> NDArray[np.float64]:
    a, b = map_a.features, map_b.features
    if a is None or b is None or a.shape[1] != b.shape[1]:
        return np.ones((len(map_a), len(map_b)))
    cosines = np.nan_to_num((a @ b.T).astype(np.float64), nan=_COSINE_MAX)
    return np.clip((cosines - _COSINE_MIN) / (_COSINE_MAX - _COSINE_MIN), 0.0, 1.0)


def _gravity_scores(points_a: NDArray[np.float64], points_b: NDArray[np.float64]) -> NDArray[np.float64]:
    # (C, C): horizontal and vertical distances must agree separately.
    offsets_a, offsets_b = points_a[:, None] - points_a[None], points_b[:, None] - points_b[None]
    level = np.abs(np.hypot(*offsets_a[..., :2].T) - np.hypot(*offsets_b[..., :2].T)).T
    up = np.abs(offsets_a[..., 2] - offsets_b[..., 2])
    exponent = level**2 / (2 / 3 * _SIGMA_M**2) + up**2 / (1 / 3 * _SIGMA_M**2)
    fits = (level <= np.sqrt(2 / 3) * _EPSILON_M) & (up <= np.sqrt(1 / 3) * _EPSILON_M)
    return np.where(fits, np.exp(-exponent / 2), 0.0)


def _roman_submaps(map_a: ObjectMap, map_b: ObjectMap, config: AlignConfig) -> Alignment | NoAlignment:
    best = np.empty((0, 2), dtype=np.int64)
    for members_a in _submaps(map_a):
        for members_b in _submaps(map_b):
            pairs = _roman_pairs(taken(map_a, members_a), taken(map_b, members_b), config, point_scores)
            if len(pairs) > len(best):
                best = np.stack([members_a[pairs[:, 0]], members_b[pairs[:, 1]]], axis=1)
    return _answer(map_a, map_b, best, config)


def _submaps(objects: ObjectMap) -> list[NDArray[np.int64]]:
    centers: list[NDArray[np.float64]] = []
    for place in objects.centroids:
        if all(np.linalg.norm(place - center) >= _SUBMAP_STEP_M for center in centers):
            centers.append(place)
    pieces = []
    for center in centers:
        distances = np.linalg.norm(objects.centroids - center, axis=1)
        nearest = np.argsort(distances, kind="stable")[:_SUBMAP_OBJECTS]
        pieces.append(np.sort(nearest[distances[nearest] <= _SUBMAP_RADIUS_M]))
    return pieces


def _answer(
    map_a: ObjectMap, map_b: ObjectMap, pairs: NDArray[np.int64], config: AlignConfig
) -> Alignment | NoAlignment:
    if len(pairs) < _MIN_MATCHES:
        reason = f"{len(pairs)} pairs of objects agree, {_MIN_MATCHES} are needed"
        return NoAlignment(refusal=Refusal.TOO_FEW_PAIRS, reason=reason)
    points_a, points_b = map_a.centroids[pairs[:, 0]], map_b.centroids[pairs[:, 1]]
    a_from_b = registered(points_a, points_b, np.ones(len(pairs)), is_level=False)
    evidence, _ = evidence_of(map_a, map_b, config, None)
    found = judged(evidence, a_from_b, pairs, is_level=False)
    center_a = points_a.mean(axis=0)
    return Alignment(
        a_from_b=a_from_b,
        pairs=matched_pairs(map_a, map_b, found),
        covariance=np.asarray(
            np.linalg.pinv(information(points_a, np.full(len(pairs), evidence.sigma_m), center_a)), dtype=np.float64
        ),
        center_a=center_a,
        log10_chance=found.log10_chance if np.isfinite(found.log10_chance) else 0.0,
        margin=0.0,
        rival=None,
        is_level=False,
        notes=("a rival's answer: neither chance nor rivals were heeded",),
    )
