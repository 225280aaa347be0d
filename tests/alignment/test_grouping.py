import numpy as np
import pytest
from hickory_stream.alignment.align import align
from hickory_stream.alignment.answer import NoAlignment
from hickory_stream.alignment.config import AlignConfig
from hickory_stream.alignment.grouping import grouped_probability, log_densities_of, log_prices
from tools.evaluation.simulated_maps.simulate import SimulatedWorld, random_pose

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
        assert isinstance(answer, NoAlignment)
        best.append(answer.hypotheses[0])
    limit = AlignConfig().acceptance.max_log10_chance
    assert all(one.log10_chance > limit for one in best)
    assert sum(one.log10_uniform < limit - 1 for one in best) >= 3
