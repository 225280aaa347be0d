from dataclasses import replace
from itertools import combinations
import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hickory_stream.alignment.affinity import (
    Affinity,
    AffinityConfig,
    build_affinity,
    fused_log_ranks,
    semantic_scores,
    why_no_semantics,
)
from hickory_stream.alignment.consensus import ConsensusConfig, ascended_clique, densest_clique
from hickory_stream.alignment.object_map import ObjectMap, shape_box
from hickory_stream.alignment.shape_scores import box_scores, literal_scores, point_scores, superquadric_scores
from hickory_stream.geometry.superquadric import Superquadrics, implicit_value, taken
from tests.alignment.map_fixtures import box_at, frame
from tests.strategies import seeds
from tools.evaluation.simulated_maps.simulate import SimulationConfig, real_fits, simulate_pair
from tools.evaluation.simulated_maps.variants import moved_map


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


def graph(linked, log_ranks):
    rows, columns = np.nonzero(linked)
    count = len(linked)
    return Affinity(
        pairs=np.column_stack([np.arange(count), np.arange(count)]), log_ranks=log_ranks,
        starts=np.searchsorted(rows, np.arange(count + 1)).astype(np.int64), neighbors=columns.astype(np.int32),
        weights=np.ones(len(rows), dtype=np.float32),
    )  # fmt: skip


def is_clique(linked, members):
    return all(linked[i, j] for i, j in combinations(members, 2))


def random_graph(seed, count, share):
    upper = np.triu(np.random.default_rng(seed).random((count, count)) < share, 1)
    return upper | upper.T


@settings(max_examples=60)
@given(seed=seeds, count=st.integers(1, 11), share=st.floats(0, 1))
@example(seed=6, count=6, share=0.0625)  # the heaviest is one vertex without a neighbour
def test_no_clique_is_heavier_than_the_one_found(seed, count, share):
    linked = random_graph(seed, count, share)
    ranks = -np.random.default_rng(seed + 1).exponential(2.0, count)
    found = densest_clique(graph(linked, ranks), np.ones(count, dtype=bool), ConsensusConfig())
    assert is_clique(linked, found)
    gains = ConsensusConfig().pair_gain - ranks
    every = (
        sum(gains[i] for i in members) for size in range(1, count + 1) for members in combinations(range(count), size)
        if is_clique(linked, np.array(members))
    )  # fmt: skip
    assert np.isclose(gains[found].sum(), max(every))


@given(seed=seeds)
@settings(max_examples=20)
def test_ascent_gives_a_maximal_clique(seed):
    linked = random_graph(seed, 40, 0.3)
    found = ascended_clique(linked.astype(float), np.ones(40), ConsensusConfig())
    assert is_clique(linked, found)
    assert not any(linked[v, found].all() for v in np.setdiff1d(np.arange(40), found))


def test_a_planted_clique_is_found_without_the_exact_search():
    linked = random_graph(3, 200, 0.05)
    planted = np.arange(0, 200, 16)
    linked[np.ix_(planted, planted)] = True
    np.fill_diagonal(linked, False)
    assert set(planted) <= set(ascended_clique(linked.astype(float), np.ones(200), ConsensusConfig()).tolist())


def test_dead_nodes_take_no_part_and_no_nodes_give_no_clique():
    linked = ~np.eye(6, dtype=bool)
    affinity = graph(linked, np.zeros(6))
    alive = np.array([True, True, False, True, False, False])
    assert densest_clique(affinity, alive, ConsensusConfig()).tolist() == [0, 1, 3]
    assert densest_clique(affinity, np.zeros(6, dtype=bool), ConsensusConfig()).tolist() == []


def map_of(shapes):
    count = len(shapes)
    return ObjectMap(
        ids=np.arange(count), centroids=np.zeros((count, 3)), features=None, shapes=tuple(shapes),
        boxes=tuple(box_at(np.zeros(3)) for _ in shapes), points=(None,) * count,
    )  # fmt: skip


@settings(max_examples=15)
@given(seed=seeds)
def test_a_shape_equals_itself_in_any_order_and_heading(seed):
    rng = np.random.default_rng(seed)
    shapes = [real_fits()[i] for i in rng.choice(len(real_fits()), 4, replace=False)]
    shuffled = [taken(shape, rng.permutation(len(shape))) for shape in shapes]
    turned = moved_map(map_of(list(shuffled)), frame(rng.uniform(0, 360), 3.0, -1.0))
    scores = superquadric_scores(map_of(list(shapes)), turned)
    assert np.allclose(np.diag(scores), 1.0)
    assert scores.max() <= 1 + 1e-9
    assert scores.min() >= 0
    assert np.allclose(scores, superquadric_scores(turned, map_of(list(shapes))).T)


def test_losing_a_small_part_costs_little():
    for shape in real_fits()[:10]:
        if len(shape) > 4:
            rest = taken(shape, np.arange(len(shape) - 1))
            assert superquadric_scores(map_of([shape]), map_of([rest]))[0, 0] > 0.8


def test_an_object_without_shape_has_no_score():
    scores = superquadric_scores(map_of([None, real_fits()[0]]), map_of([real_fits()[0], None]))
    assert np.isnan(scores[0]).all()
    assert scores[1, 0] > 0.999
    assert np.isnan(scores[1, 1])
    assert np.isnan(superquadric_scores(map_of([None]), map_of([None]))).all()


def test_the_literal_score_is_the_papers_formula():
    def two(e, large):
        return Superquadrics(
            exponents=np.array([[e, 1.0], [1.0, 1.0]]),
            semi_axes_m=np.array([[large, large, large], [0.5, 0.5, 0.5]]),
            world_from_local=np.tile(np.eye(4), (2, 1, 1)),
        )

    # Two unit balls' shares: 8/9 and 1/9 each; exponents 0.2 apart, axes 1 : 0.8; sigma 1.
    one = two(1.0, 1.0)
    other = replace(two(1.2, 0.8), semi_axes_m=np.array([[0.8] * 3, [0.5] * 3]))
    volume = [1.0, 0.5**3]
    share_a = volume[0] / sum(volume)
    score = literal_scores(map_of([one]), map_of([one]))[0, 0]
    assert np.isclose(score, 1.0)
    found = literal_scores(map_of([one]), map_of([other]))[0, 0]
    assert share_a * np.exp(-0.2) * 0.8 * 0.9 < found < np.exp(-0.2) * 0.8 + 0.25


def test_the_box_of_a_shape_holds_it_and_touches_it():
    rng = np.random.default_rng(0)
    for shape in real_fits()[:6]:
        box = shape_box(shape)
        points = box.center + rng.uniform(-2, 2, (4000, 3)) * box.half_extents_m
        inside = np.any([implicit_value(shape, i, points) <= 1 for i in range(len(shape))], axis=0)
        assert box.contains(points[inside], 0.02).all()


def test_boxes_and_clouds_of_one_object_score_one():
    cloud = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32) * np.float32([1, 0.5, 0.1])
    plain = replace(map_of([None]), points=(cloud,))
    assert np.isclose(box_scores(plain, plain), 1.0).all()
    assert np.isclose(point_scores(plain, moved_map(plain, frame(70, 1, 2))), 1.0, atol=1e-3).all()
    assert np.isnan(point_scores(map_of([None]), plain)).all()
