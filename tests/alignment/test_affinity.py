from dataclasses import replace
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hickory_stream.alignment.affinity import (
    AffinityConfig,
    build_affinity,
    fused_log_ranks,
    semantic_scores,
    why_no_semantics,
)
from tests.strategies import seeds
from tools.evaluation.simulated_maps.simulate import SimulationConfig, simulate_pair


def test_a_rank_is_the_share_of_pairs_that_are_at_least_as_good():
    ranks = np.exp(fused_log_ranks((np.array([[0.9, 0.1], [0.5, 0.5]]),), (2, 2)))
    assert np.allclose(ranks, [[0.25, 1.0], [0.75, 0.75]])


def test_unknown_scores_neither_help_nor_hurt():
    assert (fused_log_ranks((None, None), (3, 4)) == np.zeros((3, 4))).all()
    assert np.argmin(fused_log_ranks((np.array([[0.9, 0.2, 0.1, 0.3]]), np.full((1, 4), np.nan)), (1, 4))) == 0


@settings(max_examples=25)
@given(seed=seeds, count=st.integers(2, 12), is_level=st.booleans())
def test_the_graph_holds_exactly_the_pairs_whose_distances_agree(seed, count, is_level):
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(0, 4, (count, 3)), rng.uniform(0, 4, (count + 1, 3))
    config = AffinityConfig(level_tilt_deg=1.0)
    found = build_affinity(a, b, np.zeros((count, count + 1)), config, is_level=is_level)
    assert len(found) == count * (count + 1)
    sigma, tilt = 2 * config.centroid_m, np.radians(1.0)
    for c, (i, j) in enumerate(found.pairs):
        expected = []
        for d, (k, m) in enumerate(found.pairs):
            if i == k or j == m:
                continue
            da, db = a[i] - a[k], b[j] - b[m]
            if is_level:
                along = np.hypot(*da[:2])
                up = abs(da[2] - db[2]) / np.hypot(sigma, tilt * along)
                agrees = abs(along - np.hypot(*db[:2])) <= 3 * sigma and up <= 3
            else:
                agrees = abs(np.linalg.norm(da) - np.linalg.norm(db)) <= 3 * sigma
            if agrees:
                expected.append(d)
        assert found.neighbors[found.starts[c] : found.starts[c + 1]].tolist() == expected
    assert ((found.weights > 0) & (found.weights <= 1)).all()


def test_only_the_best_pairs_are_candidates():
    rng = np.random.default_rng(0)
    scores = rng.random((50, 60))
    ranks = fused_log_ranks((scores,), scores.shape)
    config = AffinityConfig(max_candidates=500)
    found = build_affinity(rng.random((50, 3)), rng.random((60, 3)), ranks, config, is_level=True)
    assert len(found) == 500
    assert scores[found.pairs[:, 0], found.pairs[:, 1]].min() >= np.sort(scores, axis=None)[-500]


def test_cosines_of_two_extractors_are_not_compared():
    pair = simulate_pair(SimulationConfig(num_objects=8), 0)
    a, b = pair.map_a, replace(pair.map_b, extractor="color")
    assert why_no_semantics(a, b) is None
    assert why_no_semantics(replace(a, extractor="color"), b) is None
    for other, word in (
        (replace(a, features=None), "no features"),
        (replace(a, features=a.features[:, :5]), "dimensions"),
        (replace(a, extractor="dinov2"), "dinov2"),
    ):
        assert word in (why_no_semantics(other, b) or "")
        assert semantic_scores(other, b) is None


def test_a_wrong_tolerance_is_refused():
    with pytest.raises(ValueError, match="centroid_m"):
        AffinityConfig(centroid_m=0.0)
