import numpy as np
from hickory_stream.graph.gtsam_solver import sharper, smoothest, weights_of

LIMIT = 16.0
CHI2 = np.array([0.0, 1.0, 15.0, 17.0, 400.0, 1e5])


def test_weights_go_from_all_a_little_to_those_of_the_limit():
    weights = weights_of(CHI2, LIMIT, smoothest(CHI2, LIMIT))
    assert (weights > 0).all()
    assert (np.diff(weights) <= 0).all()
    assert weights[-1] < 1e-3
    sharpness = smoothest(CHI2, LIMIT)
    for _ in range(60):
        sharpness = sharper(sharpness)
    assert weights_of(CHI2, LIMIT, sharpness).tolist() == [1, 1, 1, 0, 0, 0]


def test_residuals_within_half_the_limit_count_fully():
    chi2 = np.array([0.0, 3.0, 7.9])
    assert weights_of(chi2, LIMIT, smoothest(chi2, LIMIT)).tolist() == [1, 1, 1]
    assert weights_of(np.empty(0), LIMIT, smoothest(np.empty(0), LIMIT)).tolist() == []
