import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.geometry.display import looking, main_components, nearest_eye, rises

coordinate = st.floats(-5, 5)


@given(
    points=st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=1, max_size=20),
    azimuth=st.floats(-3.2, 3.2),
    elevation=st.floats(0.1, 1.4),
)
def test_the_nearest_eye_has_a_point_on_its_rim(points, azimuth, elevation):
    rotation = looking(azimuth, elevation)
    assert np.allclose(rotation.T @ rotation, np.eye(3))
    assert np.linalg.det(rotation) > 0
    local = (np.array(points) - nearest_eye(np.array(points), rotation, (0.6, 0.4))) @ rotation
    shares = np.abs(local[:, :2] / local[:, 2:]) / (0.6, 0.4)
    assert (local[:, 2] >= 0.5 - 1e-9).all()
    assert (shares <= 1 + 1e-6).all()
    assert shares.max() > 1 - 1e-6 or np.isclose(local[:, 2].min(), 0.5)


label = st.tuples(st.floats(0, 1), st.floats(0, 1), st.floats(0.01, 0.2), st.floats(0.01, 0.1))


@given(st.lists(label, max_size=25))
def test_separated_labels_do_not_overlap_and_never_move_down(labels):
    numbers = np.array(labels).reshape(-1, 4)
    centers, sizes = numbers[:, :2], numbers[:, 2:]
    up = rises(centers, sizes)
    assert (up >= 0).all()
    low, high = centers - sizes / 2, centers + sizes / 2
    low[:, 1] -= up
    high[:, 1] -= up
    for i in range(len(labels)):
        for j in range(i):
            within = np.minimum(high[i], high[j]) - np.maximum(low[i], low[j])
            assert within.min() < 1e-9


def test_a_free_label_stays_and_a_hidden_one_moves_just_past():
    centers = np.array([[0.5, 0.50], [0.52, 0.49], [0.9, 0.5]])
    assert np.allclose(rises(centers, np.full((3, 2), 0.1)), [0.0, 0.09, 0.0])


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
