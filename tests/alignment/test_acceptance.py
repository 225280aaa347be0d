import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2
from hickory_stream.alignment.acceptance import Chance, effective_volume_m3, log_expected_sets
from hickory_stream.alignment.align import align
from hickory_stream.alignment.config import AlignConfig
from hickory_stream.alignment.grouping import grouped_probability, log_densities_of, log_prices
from tests.strategies import seeds
from tools.evaluation.simulated_maps.simulate import SimulatedWorld, random_pose

CHANCE = Chance(num_a=40, num_b=40, volume_m3=150.0, max_tilt_rad=0.4)


def scatters(points):
    return np.array([(p := points[: k + 1] - points[: k + 1].mean(axis=0)).T @ p for k in range(len(points))])


def logs(seed, residual_m, log_rank, *, is_level=True, num=8):
    points = np.random.default_rng(seed).uniform(-4, 4, (num, 3))
    squares = np.cumsum(np.full(num, residual_m**2))
    return log_expected_sets(CHANCE, np.full(num, log_rank), squares, scatters(points), is_level=is_level)


@given(seed=seeds, residual_m=st.floats(0.01, 0.3), log_rank=st.floats(-6, 0))
def test_closer_and_likelier_pairs_are_less_easily_chance(seed, residual_m, log_rank):
    given_ = logs(seed, residual_m, log_rank)[3:]
    assert (logs(seed, residual_m / 2, log_rank)[3:] <= given_ + 1e-9).all()
    assert (logs(seed, residual_m, log_rank - 1)[3:] <= given_ + 1e-9).all()


def test_two_pairs_prove_nothing_four_do_where_few_look_alike():
    assert np.isinf(logs(0, 0.001, -7.0)[:2]).all()
    assert np.isinf(logs(0, 0.001, -7.0, is_level=False)[:3]).all()
    easy, hard = np.log(5 / 1600), np.log(270 / 1600)
    assert logs(1, 0.1, easy)[3] < np.log(1e-3)
    assert logs(1, 0.1, hard)[3] > np.log(1e-2)


def test_the_formula_bounds_chance_agreement_of_three_pairs():
    rng = np.random.default_rng(5)
    size = np.array([6.0, 6.0, 2.0])
    a, b = rng.uniform(0, 1, (2, 200_000, 3, 3)) * size
    a, b = a - a.mean(axis=1, keepdims=True), b - b.mean(axis=1, keepdims=True)
    # The best turn about the vertical, in closed form; the sum of squares that it leaves.
    sine = (a[..., 1] * b[..., 0] - a[..., 0] * b[..., 1]).sum(axis=1)
    cosine = (a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]).sum(axis=1)
    squares = (a**2 + b**2).sum(axis=(1, 2)) - 2 * (np.hypot(sine, cosine) + (a[..., 2] * b[..., 2]).sum(axis=1))
    chance = Chance(num_a=3, num_b=3, volume_m3=float(size.prod()), max_tilt_rad=0.4)
    predicted, found = [], []
    for radius_m in (0.6, 0.9):
        found.append(float((squares < radius_m**2).mean()))
        expected = [
            log_expected_sets(chance, np.zeros(3), np.full(3, radius_m**2), scatters(places), is_level=True)[2]
            for places in a[:300]
        ]
        # Of the 3! ways to pair three objects with three, one was tried; three prefixes were tested.
        predicted.append(float(np.mean(np.exp(expected))) / (6 * 3))
    # Objects at the walls leave less room than the formula has: it errs on the side of caution.
    assert found[0] > 1e-4
    assert all(1 < p / f < 30 for p, f in zip(predicted, found, strict=True))
    assert np.isclose(predicted[1] / predicted[0], found[1] / found[0], rtol=0.3)


def test_ranks_are_combined_as_fisher_does():
    ranks = np.log([0.1, 0.02, 0.3, 0.005])
    points = np.random.default_rng(0).uniform(-4, 4, (4, 3))
    squares = np.cumsum(np.full(4, 0.01))
    given_ = log_expected_sets(CHANCE, ranks, squares, scatters(points), is_level=True)[3]
    certain = log_expected_sets(CHANCE, np.zeros(4), squares, scatters(points), is_level=True)[3]
    assert np.isclose(given_ - certain, chi2(8).logsf(-2 * ranks.sum()))


def test_the_volume_shrinks_where_objects_crowd():
    rng = np.random.default_rng(0)
    even = rng.uniform(0, 1, (400, 3)) * (20, 20, 2)
    assert 600 < effective_volume_m3(even) < 1100
    crowded = np.concatenate([even[:200], rng.uniform(0, 1, (200, 3)) * (3, 3, 0.2)])
    assert effective_volume_m3(crowded) < 0.2 * effective_volume_m3(even)


ALIKE, V = np.log(0.005), 110.0
EVEN = np.full(5, -np.log(V))


def test_a_pair_beside_another_says_little_and_a_far_one_all():
    points = np.array([[0.0, 0, 0], [0.4, 0, 0], [6.0, 0, 0], [6.5, 0, 1.0]])
    prices = np.diff(log_prices(points, np.full(4, ALIKE), EVEN[:4], 1.0, V), prepend=0.0)
    assert prices[0] == 0
    assert np.isclose(prices[1], np.log(120), atol=0.1)
    assert prices[2] < 0.2
    assert np.isclose(prices[3], np.log(0.84 * V))


def test_a_group_costs_less_where_objects_are_less_alike():
    points = np.random.default_rng(0).uniform(-0.4, 0.4, (5, 3))
    whole = log_prices(points, np.full(5, ALIKE), EVEN, 1.0, V)
    assert (np.diff(whole) > 0).all()
    assert (log_prices(points, np.full(5, np.log(0.2)), EVEN, 1.0, V)[1:] < whole[1:]).all()
    assert (log_prices(points, np.full(5, ALIKE), EVEN, 0.1, V)[1:] < whole[1:]).all()
    # In a place no larger than the group nothing is gained by it.
    assert not log_prices(points, np.full(5, ALIKE), EVEN, 1.0, 1.0 / 1.8).any()
    assert not log_prices(points, np.full(5, ALIKE), EVEN, 0.0, V).any()


def test_what_crowds_on_a_table_says_little_though_it_is_unlike():
    rng = np.random.default_rng(3)
    table = rng.uniform((0, 0, 0.7), (1.0, 0.6, 0.8), (6, 3))
    densities = log_densities_of(np.concatenate([table, rng.uniform((0, 0, 0), (5, 5, 2), (9, 3))]), 50.0)
    assert densities[:6].min() > np.log(0.1) > densities[6:].max()
    prices = np.diff(log_prices(table, np.zeros(6), densities[:6], 1.0, 50.0))
    np.testing.assert_allclose(prices, densities[1:6] + np.log(50.0))


def test_where_objects_stand_evenly_density_costs_next_to_nothing():
    even = np.random.default_rng(2).uniform(0, (5, 5, 2), (60, 3))
    assert np.maximum(log_densities_of(even, 50.0) + np.log(50.0), 0.0).mean() < 0.1


def groups(rng, count):
    """Return objects in groups of five, half a metre about a middle."""
    middles = rng.uniform(-4, 4, (count, 1, 2))
    return np.concatenate([(middles + rng.normal(0, 0.3, (count, 5, 2))).reshape(-1, 2), np.zeros((5 * count, 1))], 1)


def test_whether_things_stand_in_groups_is_seen_in_the_maps():
    rng = np.random.default_rng(1)
    even = tuple(rng.uniform(-4, 4, (40, 3)) for _ in range(2))
    assert grouped_probability(even) < 0.05
    assert grouped_probability((groups(rng, 7), groups(rng, 7))) > 0.95
    # Where there is too little to see, it is left open.
    assert grouped_probability((even[0][:2], even[1][:2])) == pytest.approx(0.5, abs=0.3)


def room(world, rng, group):
    """Return a group that every home has, and things of this home, in groups of their own."""
    own = [world.new_object(np.array([*place, rng.uniform(0, 1)])) for place in groups(rng, 4)[:, :2] + (5.0, 0.0)]
    return [*group, *own]


def test_one_group_that_two_homes_have_does_not_join_them():
    """The table with its chairs stands in both: enough pairs by the uniform model, and one observation by this."""
    best = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        world = SimulatedWorld("easy", rng)
        places = [(0.0, 0.0, 0.4), (0.5, 0.3, 0.2), (-0.5, 0.3, 0.2), (0.5, -0.3, 0.2), (0.1, 0.1, 0.8)]
        group = [world.new_object(np.array(place)) for place in places]
        maps = [world.observe(room(world, rng, group), random_pose(0.0, 4.0, rng)) for _ in range(2)]
        answer = align(*maps)
        best.append(answer.hypotheses[0])
    limit = AlignConfig().acceptance.max_log10_chance
    assert all(one.log10_chance > limit for one in best)
    assert sum(one.log10_uniform < limit - 1 for one in best) >= 3
