"""Features by name, made when they are asked for."""

import numpy as np
import pytest

from hickory_stream.perception.features import Features, of_both


def test_a_feature_is_made_once_and_only_when_it_is_asked_for() -> None:
    made = []

    def counting(name: str) -> np.ndarray:
        made.append(name)
        return np.ones(3)

    features = Features({"near": lambda: counting("near"), "far": lambda: counting("far")})
    assert list(features) == ["near", "far"] and made == []
    assert features["near"] is features["near"]
    more = features | {"odds": np.zeros(3)}
    assert list(more) == ["near", "far", "odds"]
    assert more["near"] is features["near"] and more["odds"].tolist() == [0, 0, 0]
    assert made == ["near"]
    with pytest.raises(KeyError, match="wide"):
        features["wide"]


def test_features_of_both_are_those_of_the_larger_and_the_smaller_part() -> None:
    both = Features(of_both({"size": lambda: np.array([0.0, 10.0, 20.0])}, np.array([1, 2]), np.array([0, 1])))
    assert both["large_size"].tolist() == [10, 20]
    assert both["small_size"].tolist() == [0, 10]
