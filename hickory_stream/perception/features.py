"""Features by name, computed lazily: a forest uses only some of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Makers = Mapping[str, "Callable[[], NDArray[np.float64]]"]
"""The function that computes each feature (K,), by the feature's name."""


class Features(Mapping[str, "NDArray[np.float64]"]):
    """The features (K,) of K pairs by name, each computed at most once, on first access."""

    def __init__(self, makers: Makers) -> None:
        self._makers = dict(makers)
        self._made: dict[str, NDArray[np.float64]] = {}

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """Return the feature with this name; raises `KeyError` if there is none."""
        made = self._made.get(name)
        if made is None:
            made = self._made[name] = self._makers[name]()
        return made

    def __iter__(self) -> Iterator[str]:
        """Yield the names of all features, computed or not."""
        return iter(self._makers)

    def __len__(self) -> int:
        """Return the number of features."""
        return len(self._makers)

    def __or__(self, more: Mapping[str, NDArray[np.float64]]) -> Features:
        """Return the union of these features and others; computed ones are not computed again."""
        out = Features({**self._makers, **{name: partial(more.__getitem__, name) for name in more}})
        out._made = {name: made for name, made in self._made.items() if name not in more}
        return out


def of_both(makers: Makers, large: NDArray[np.int64], small: NDArray[np.int64]) -> Makers:
    """Return makers of the features of both regions, `large` and `small` (K,), of pairs, from those of (n,) regions."""
    regions = Features(makers)
    out: dict[str, Callable[[], NDArray[np.float64]]] = {}
    for name in makers:
        out[f"large_{name}"] = partial(_at, regions, name, large)
        out[f"small_{name}"] = partial(_at, regions, name, small)
    return out


def _at(features: Features, name: str, indices: NDArray[np.int64]) -> NDArray[np.float64]:
    return features[name][indices]
