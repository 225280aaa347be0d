import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.geometry.display import main_components


def test_the_main_component_has_the_largest_variance():
    features = np.random.default_rng(0).normal(0, 0.01, (20, 30, 8)).astype(np.float32)
    features[..., 5] += np.linspace(-1, 1, 30)
    components = main_components(features)
    assert abs(components.axes[5, 0]) > 0.99
    colors = components.colors(features)
    assert colors.shape == (20, 30, 3)
    red = colors[..., 0].astype(int)
    assert (np.diff(red.mean(axis=0)) > 0).mean() > 0.9
    assert (red[:, 0] < 10).all()
    assert (red[:, -1] > 245).all()


@given(st.integers(1, 5), st.integers(1, 4), st.integers(1, 6))
def test_features_of_any_rank_have_colors(height, width, dim):
    features = np.ones((height, width, dim), np.float32)
    assert main_components(features).colors(features).shape == (height, width, 3)
