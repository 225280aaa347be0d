import dataclasses
import numpy as np
import pytest
from hickory_stream.errors import ModelError
from hickory_stream.perception.regions.trees import EMBEDDED, Trees, embedded_trees, load_trees

# One tree: width <= 2 (or unknown) gives -1; else gap <= 0.1 gives 2, else 0.5. Another is a single leaf of 0.25.
TREES = Trees(
    features=("gap", "width"), baseline=0.5, roots=np.array([0, 5], np.int32),
    feature=np.array([1, -1, 0, -1, -1, -1], np.int16), threshold=np.array([2.0, 0, 0.1, 0, 0, 0]),
    left=np.array([1, 0, 3, 0, 0, 0], np.int32), right=np.array([2, 0, 4, 0, 0, 0], np.int32),
    nan_left=np.array([True, False, False, False, False, False]),
    value=np.array([0, -1.0, 0, 2.0, 0.5, 0.25], np.float32),
)  # fmt: skip
INPUTS = {
    "width": np.array([1.0, 2.0, 3.0, 3.0, np.nan, 3.0]),
    "unused": np.zeros(6),
    "gap": np.array([0.0, 0.0, 0.1, 0.2, 0.0, np.nan]),
}


def test_leaves_add_up_to_log_odds_and_unknown_inputs_are_routed():
    odds = 0.5 + 0.25 + np.array([-1.0, -1.0, 2.0, 0.5, -1.0, 0.5])
    assert TREES.probabilities(INPUTS) == pytest.approx(1 / (1 + np.exp(-odds)))


def test_no_pairs_have_no_probabilities():
    assert TREES.probabilities({name: values[:0] for name, values in INPUTS.items()}).shape == (0,)


def test_saved_trees_are_loaded_as_they_were(tmp_path):
    path = tmp_path / "trees.npz"
    TREES.save(path)
    loaded = load_trees(path)
    assert loaded.features == TREES.features
    np.testing.assert_array_equal(loaded.probabilities(INPUTS), TREES.probabilities(INPUTS))


def test_the_trees_of_the_package_are_whole_and_small(request):
    assert len(embedded_trees().roots) >= 50
    path = request.config.rootpath / "hickory_stream" / "perception" / EMBEDDED
    assert path.stat().st_size < 8e6


@pytest.mark.parametrize(("change", "complaint"), [
    ({"left": np.array([0, 0, 3, 0, 0, 0], np.int32)}, "left child"),
    ({"right": np.array([6, 0, 4, 0, 0, 0], np.int32)}, "right child"),
    ({"feature": np.array([2, -1, 0, -1, -1, -1], np.int16)}, "asks for an input"),
    ({"roots": np.array([0, 6], np.int32)}, "begins at a node"),
    ({"value": np.zeros(5, np.float32)}, "5 of value for 6 nodes"),
])  # fmt: skip
def test_trees_that_lead_nowhere_are_refused(tmp_path, change, complaint):
    path = tmp_path / "trees.npz"
    dataclasses.replace(TREES, **change).save(path)
    with pytest.raises(ModelError, match=complaint):
        load_trees(path)


@pytest.mark.parametrize("damage", ["absent", "cut short", "of something else"])
def test_a_file_without_trees_says_what_it_should_hold(tmp_path, damage):
    path = tmp_path / "trees.npz"
    if damage == "cut short":
        TREES.save(path)
        path.write_bytes(path.read_bytes()[:300])
    elif damage == "of something else":
        np.savez(path, weights=np.zeros(3))
    with pytest.raises(ModelError, match="holds no trees of a segmenter"):
        load_trees(path)
