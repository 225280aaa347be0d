import numpy as np
import pytest
from hickory_stream.shapes.inflate.cover import undominated


def by_definition(points):
    """Return (N,) which points have no other one beyond them in all three coordinates."""
    beyond = (points[None] >= points[:, None]).all(axis=2) & (points[None] > points[:, None]).any(axis=2)
    return np.asarray(~beyond.any(axis=1))


@pytest.mark.parametrize("steps", [4, 1000])
def test_a_point_is_left_out_exactly_if_another_lies_beyond(steps):
    points = np.floor(np.random.default_rng(7).random((400, 3)) * steps) / steps
    # On steps so coarse many points share a coordinate: whatever is left out still has one that stands for it.
    kept = undominated(points)
    expected = by_definition(points)
    assert {tuple(point) for point in points[expected]} <= {tuple(point) for point in points[kept]}
    if steps == 1000:
        np.testing.assert_array_equal(kept, expected)


def test_few_points_of_a_box_decide_and_all_of_a_ball_do():
    rng = np.random.default_rng(8)
    ball = np.abs(rng.normal(size=(500, 3)))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    box = rng.random((500, 3))
    box[np.arange(500), rng.integers(3, size=500)] = 1.0
    assert undominated(ball).all()
    assert undominated(np.concatenate([box, np.full((1, 3), 1.001)])).sum() == 1
