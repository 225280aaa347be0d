import numpy as np
import pytest
from hickory_stream.geometry.depth_sensor import DepthSensor
from hickory_stream.geometry.flush import flush_heights, plane_beside

LAW = DepthSensor(noise_per_m=0.002).law
WALL = (0.0, 0.0, 1.0, 0.0)


def seen(heights, sigma_m, seed=0):
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 0.5, (2, len(heights)))
    noisy = heights + sigma_m * rng.standard_normal(len(heights))
    return np.stack([x, y, noisy], axis=1), np.full(len(heights), 1 / sigma_m**2, np.float32)


@pytest.mark.parametrize("thick_m", [0.01, 0.03, 0.05])
def test_a_front_thinner_than_its_noise_is_at_its_mean_height(thick_m):
    points, weights = seen(np.full(3000, thick_m), 0.04)
    heights_m = flush_heights(points, weights, 1 / weights, WALL, 0.5)
    assert heights_m.max() - heights_m.min() < 0.015
    assert heights_m.mean() == pytest.approx(thick_m, abs=0.004)


def test_relief_that_exceeds_the_noise_stays():
    points, weights = seen(np.repeat([0.02, 0.03], 1500), 0.002)
    heights_m = flush_heights(points, weights, 1 / weights, WALL, 0.5)
    assert heights_m[:1500].mean() == pytest.approx(0.02, abs=0.001)
    assert heights_m[1500:].mean() == pytest.approx(0.03, abs=0.001)


def test_near_views_decide_where_far_ones_err_more():
    near, near_weights = seen(np.full(500, 0.02), 0.003)
    far, far_weights = seen(np.full(3000, 0.02), 0.06)
    points, weights = np.concatenate([near, far]), np.concatenate([near_weights, far_weights])
    assert flush_heights(points, weights, 1 / weights, WALL, 0.5).max() < 0.03


@pytest.mark.parametrize(
    ("low_m", "high_m", "width_m"), [(0.0, 0.2, 0.5), (0.6, 0.61, 0.5), (-0.2, -0.19, 0.5)],
    ids=["a body that rises evenly", "farther than it is wide", "recessed"],
)  # fmt: skip
def test_what_is_not_thin_and_close_is_not_flush(low_m, high_m, width_m):
    points, weights = seen(np.linspace(low_m, high_m, 2000), 0.01)
    assert flush_heights(points, weights, 1 / weights, WALL, width_m) is None


def test_the_plane_beside_is_that_of_most_returns():
    rng = np.random.default_rng(3)
    v, u = np.mgrid[-0.4:0.4:40j, -0.5:0.5:50j].astype(np.float32)
    inverse = 0.1 * u - 0.05 * v + 0.25
    inverse = inverse + 0.002 * rng.standard_normal(u.shape)
    inverse[:, :10] = 0.6
    depth, beside = (1 / inverse).astype(np.float32), np.ones(u.shape, bool)
    beside[15:25, 30:40] = False
    assert plane_beside(depth, beside, u[0], v[:, 0], LAW) == pytest.approx([0.1, -0.05, 0.25], abs=0.003)


def test_without_a_surface_of_most_returns_there_is_no_plane():
    depth = np.random.default_rng(4).uniform(1, 4, (30, 30)).astype(np.float32)
    u = np.linspace(-0.4, 0.4, 30).astype(np.float32)
    assert not plane_beside(depth, np.ones(depth.shape, bool), u, u, LAW).any()
    assert not plane_beside(depth[:4, :4], np.ones((4, 4), bool), u[:4], u[:4], LAW).any()
