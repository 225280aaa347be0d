from itertools import combinations
import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hickory_stream.alignment.affinity import Affinity
from hickory_stream.alignment.consensus import ConsensusConfig, ascended_clique, densest_clique
from tests.strategies import seeds


def graph(linked, log_ranks):
    rows, columns = np.nonzero(linked)
    count = len(linked)
    return Affinity(
        pairs=np.column_stack([np.arange(count), np.arange(count)]),
        log_ranks=log_ranks,
        starts=np.searchsorted(rows, np.arange(count + 1)).astype(np.int64),
        neighbors=columns.astype(np.int32),
        weights=np.ones(len(rows), dtype=np.float32),
    )


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
        sum(gains[i] for i in members)
        for size in range(1, count + 1)
        for members in combinations(range(count), size)
        if is_clique(linked, np.array(members))
    )
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
