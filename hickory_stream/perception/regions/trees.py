"""Boosted trees that estimate whether two regions are one object; `tools/train_segmenter` trains them."""

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.errors import ModelError
from hickory_stream.geometry import portable
from hickory_stream.perception.regions.features import Features

EMBEDDED = "weights/join.npz"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Trees:
    """A forest whose leaf values add up to log-odds; the nodes of all trees are concatenated, all arrays (nodes,).

    The descent from node i continues at `left[i]` if input `feature[i]` is at most `threshold[i]`, else at `right[i]`;
    for NaN at `left[i]` if `nan_left[i]`. A leaf has feature -1 and a `value[i]`.
    """

    #: names of the inputs in order
    features: tuple[str, ...]
    #: log-odds to which leaf values are added
    baseline: float
    #: (trees,) the first node of each tree
    roots: NDArray[np.int32]
    feature: NDArray[np.int16]
    threshold: NDArray[np.float64]
    left: NDArray[np.int32]
    right: NDArray[np.int32]
    nan_left: NDArray[np.bool_]
    value: NDArray[np.float32]

    def probabilities(self, inputs: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
        """Return (K,) the probability that each pair is one object; `inputs` has every feature (K,) by name."""
        if isinstance(inputs, Features):
            rows = inputs.rows_of(self.features)
        else:
            rows = np.array([inputs[name] for name in self.features]).T.copy()
        odds = self.baseline + _sums_of_leaves(rows, *(getattr(self, name) for name in _ARRAYS))
        return np.asarray(1 / (1 + portable.exp(-odds)))

    def save(self, path: Path) -> None:
        """Write the trees as a NumPy archive."""
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        np.savez_compressed(path, features=np.array(self.features), baseline=np.array(self.baseline), **arrays)


_ARRAYS = ("roots", "feature", "threshold", "left", "right", "nan_left", "value")


@cache
def embedded_trees() -> Trees:
    """Return the trees that come with the package; features of the affinity network may be NaN."""
    with resources.as_file(resources.files("hickory_stream.perception").joinpath(EMBEDDED)) as path:
        return load_trees(path)


def load_trees(path: Path) -> Trees:
    """Return the trees in a file; raises `ModelError`."""
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            trees = Trees(
                features=tuple(str(name) for name in file["features"]),
                baseline=float(file["baseline"]),
                **{name: file[name] for name in _ARRAYS},
            )
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise ModelError(f"{path} holds no trees of a segmenter: {error}") from error
    _check(trees, path)
    return trees


def _check(trees: Trees, path: Path) -> None:
    # A child after its node ensures that the descent of a tree ends.
    count, inner = len(trees.feature), trees.feature >= 0
    own = np.arange(count)
    for name in _ARRAYS[1:]:
        if len(getattr(trees, name)) != count:
            raise ModelError(f"{path}: {len(getattr(trees, name))} of {name} for {count} nodes")
    for name, child in (("left", trees.left), ("right", trees.right)):
        if ((child <= own) | (child >= count))[inner].any():
            raise ModelError(f"{path}: the {name} child of a node does not come after it")
    if (trees.feature >= len(trees.features)).any() or (trees.roots < 0).any() or (trees.roots >= count).any():
        raise ModelError(f"{path}: a node asks for an input, or a tree begins at a node, that is not there")


@kernel
def _sums_of_leaves(rows, roots, feature, threshold, left, right, nan_left, value):
    out = np.zeros(len(rows))
    # A tree stays in the cache while all rows descend it; each row still adds its leaves in the order of the trees.
    for root in roots:
        for i in range(len(rows)):
            node = root
            while feature[node] >= 0:
                x = rows[i, feature[node]]
                goes_left = nan_left[node] if np.isnan(x) else x <= threshold[node]
                node = left[node] if goes_left else right[node]
            out[i] += value[node]
    return out
