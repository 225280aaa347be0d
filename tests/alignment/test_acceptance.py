import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2
from hickory_stream.alignment.acceptance import Chance, effective_volume_m3, log_expected_sets
from tests.strategies import seeds

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
