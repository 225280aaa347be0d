import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hickory_stream.geometry.display import main_components


def test_the_main_component_is_the_direction_that_features_vary_most_in():
    rng = np.random.default_rng(0)
    features = rng.normal(0, 0.01, (20, 30, 8)).astype(np.float32)
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
def test_any_features_have_colors_also_where_they_span_less_than_three_dimensions(height, width, dim):
    features = np.ones((height, width, dim), np.float32)
    assert main_components(features).colors(features).shape == (height, width, 3)
