import numpy as np
import pytest
from hickory_stream.perception.regions.features import Features, joined, of_both


def test_columns_have_names_and_may_be_taken_in_any_order():
    features = joined(
        Features(("near", "far"), np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])),
        Features(("apart",), np.array([[7.0], [8.0], [9.0]])),
    )
    assert {name: column.tolist() for name, column in features.items()} == {
        "near": [1, 3, 5],
        "far": [2, 4, 6],
        "apart": [7, 8, 9],
    }
    assert features.rows_of(("apart", "near")).tolist() == [[7, 1], [8, 3], [9, 5]]
    with pytest.raises(KeyError):
        features.rows_of(("near", "nowhere"))


def test_features_of_a_pair_are_those_of_larger_and_smaller_part():
    both = of_both(("size",), np.array([[0.0], [10.0], [20.0]]), np.array([1, 2]), np.array([0, 1]))
    assert both["large_size"].tolist() == [10, 20]
    assert both["small_size"].tolist() == [0, 10]
