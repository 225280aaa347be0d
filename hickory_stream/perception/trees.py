"""Boosted trees that estimate whether two regions are one object: read from the package, evaluated with Numba.

`tools/train_segmenter` grows them and writes them with a card that says from what, and how well they do.
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Literal

import numpy as np

from hickory_stream.compiled import numba
from hickory_stream.errors import ModelError
from hickory_stream.geometry import portable

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

Forest = Literal["sizes", "mixed", "odds"]
"""`sizes` knows metres, heights and colours as such; `mixed` is its average with one of ratios, sigmas and angles.

`odds` knows what the network of affinities says of a pair, too, or that it says nothing.
"""
EMBEDDED: dict[Forest, str] = {
    "sizes": "weights/join.npz",
    "mixed": "weights/join_mixed.npz",
    "odds": "weights/join_odds.npz",
}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Trees:
    """A forest whose leaves add up to a log-odds; the nodes of all trees in one row, all arrays (nodes,).

    `features`: the names of the inputs in order; `roots` (trees,) the first node of each tree; `baseline` the log-odds
    without any tree. Node i asks whether input `feature[i]` is at most `threshold[i]` and goes on at `left[i]`, else at
    `right[i]`; a NaN goes left where `nan_left[i]`. A leaf has feature -1 and adds `value[i]`.
    """

    features: tuple[str, ...]
    baseline: float
    roots: NDArray[np.int32]
    feature: NDArray[np.int16]
    threshold: NDArray[np.float64]
    left: NDArray[np.int32]
    right: NDArray[np.int32]
    nan_left: NDArray[np.bool_]
    value: NDArray[np.float32]

    def probabilities(self, inputs: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
        """Return (K,) the probability that each pair is one thing; `inputs` holds (K,) of every feature by name."""
        rows = np.array([inputs[name] for name in self.features]).T.copy()
        odds = self.baseline + _sums_of_leaves(
            rows, self.roots, self.feature, self.threshold, self.left, self.right, self.nan_left, self.value
        )
        return np.asarray(1 / (1 + portable.exp(-odds)))

    def save(self, path: Path) -> None:
        """Write the trees as a NumPy archive."""
        np.savez_compressed(
            path,
            features=np.array(self.features),
            baseline=np.array(self.baseline),
            **{name: getattr(self, name) for name in _ARRAYS},
        )


def averaged(one: Trees, other: Trees) -> Trees:
    """Return the trees whose log-odds are the mean of those of two forests; each may ask for inputs of its own."""
    names = tuple(dict.fromkeys((*one.features, *other.features)))
    forests, shift = [], 0
    for trees in (one, other):
        number = np.array([names.index(name) for name in trees.features], dtype=np.int16)
        is_leaf = trees.feature < 0
        forests.append(
            {
                "roots": trees.roots + np.int32(shift),
                "feature": np.where(is_leaf, np.int16(-1), number[trees.feature]),
                "threshold": trees.threshold,
                "left": trees.left + np.int32(shift),
                "right": trees.right + np.int32(shift),
                "nan_left": trees.nan_left,
                "value": trees.value / np.float32(2),
            }
        )
        shift += len(trees.feature)
    joined = {name: np.concatenate([forest[name] for forest in forests]) for name in _ARRAYS}
    return Trees(features=names, baseline=(one.baseline + other.baseline) / 2, **joined)


_ARRAYS = ("roots", "feature", "threshold", "left", "right", "nan_left", "value")


@cache
def embedded_trees(forest: Forest = "sizes") -> Trees:
    """Return trees that come with the package."""
    with resources.as_file(resources.files("hickory_stream.perception").joinpath(EMBEDDED[forest])) as path:
        return load_trees(path)


def load_trees(path: Path) -> Trees:
    """Return the trees in a file.

    Raises:
        ModelError: the file is not there or holds no such trees.
    """
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
    """Raise if a node has a child out of range or before itself: the descent of a tree must end."""
    count = len(trees.feature)
    inner = trees.feature >= 0
    own = np.arange(count)
    for name in _ARRAYS[1:]:
        if len(getattr(trees, name)) != count:
            raise ModelError(f"{path}: {len(getattr(trees, name))} of {name} for {count} nodes")
    for name in ("left", "right"):
        next_node = getattr(trees, name)
        if ((next_node <= own) | (next_node >= count))[inner].any():
            raise ModelError(f"{path}: a node leads {name} to none that comes after it")
    if (trees.feature >= len(trees.features)).any() or (trees.roots < 0).any() or (trees.roots >= count).any():
        raise ModelError(f"{path}: a node asks for an input, or a tree begins at a node, that is not there")


@numba.njit(cache=True, nogil=True)
def _sums_of_leaves(rows, roots, feature, threshold, left, right, nan_left, value):  # type: ignore[no-untyped-def] # pragma: no cover
    out = np.zeros(len(rows))
    # A tree stays in the cache while all rows go down it; a row's leaves come in the order of the trees all the same.
    for root in roots:
        for i in range(len(rows)):
            node = root
            while feature[node] >= 0:
                x = rows[i, feature[node]]
                goes_left = nan_left[node] if np.isnan(x) else x <= threshold[node]
                node = left[node] if goes_left else right[node]
            out[i] += value[node]
    return out
