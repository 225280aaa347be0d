"""Features by name, from rows of numbers."""

import numpy as np
import pytest

from hickory_stream.perception.features import named, of_both


def test_a_row_has_a_number_for_each_name() -> None:
    features = named(("near", "far"), np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]))
    assert {name: column.tolist() for name, column in features.items()} == {"near": [1, 3, 5], "far": [2, 4, 6]}
    with pytest.raises(ValueError, match="argument 2"):
        named(("near",), np.zeros((3, 2)))


def test_features_of_both_are_those_of_the_larger_and_the_smaller_part() -> None:
    both = of_both(("size",), np.array([[0.0], [10.0], [20.0]]), np.array([1, 2]), np.array([0, 1]))
    assert both["large_size"].tolist() == [10, 20]
    assert both["small_size"].tolist() == [0, 10]
