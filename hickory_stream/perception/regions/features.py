"""Features of pairs of regions by name, as columns of one table."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Features(Mapping[str, "NDArray[np.float64]"]):
    """The features (K,) of K pairs by name: the columns of `rows` (K, len(names))."""

    names: tuple[str, ...]
    rows: NDArray[np.float64]

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        return self.rows[:, _places(self.names)[name]]

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __len__(self) -> int:
        return len(self.names)

    def rows_of(self, names: tuple[str, ...]) -> NDArray[np.float64]:
        """Return (K, len(names)) some of the columns; raises `KeyError`."""
        return self.rows.take(_columns(self.names, names), axis=1)


def joined(*parts: Features) -> Features:
    """Return the columns of all parts, which have the same pairs and different names."""
    return Features(_all_names(*(part.names for part in parts)), np.concatenate([part.rows for part in parts], axis=1))


def table(*columns: NDArray[Any]) -> NDArray[np.float64]:
    """Return (K, M) the columns, some (K,) and some (n, K) several."""
    return np.concatenate([own[None] if own.ndim == 1 else own for own in columns]).T


def of_both(
    names: tuple[str, ...], rows: NDArray[np.float64], large: NDArray[np.int64], small: NDArray[np.int64]
) -> Features:
    """Return the features of both regions, `large` and `small` (K,), of pairs, from rows (n, len(names)) of regions."""
    both = np.empty((len(large), 2 * len(names)))
    both[:, ::2], both[:, 1::2] = rows[large], rows[small]
    return Features(_names_of_both(names), both)


# Cached: the names are the same in every round of every frame.
@lru_cache(maxsize=64)
def _all_names(*parts: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(name for part in parts for name in part)


@lru_cache(maxsize=64)
def _names_of_both(names: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{side}_{name}" for name in names for side in ("large", "small"))


@lru_cache(maxsize=64)
def _places(names: tuple[str, ...]) -> dict[str, int]:
    return {name: i for i, name in enumerate(names)}


@lru_cache(maxsize=64)
def _columns(names: tuple[str, ...], wanted: tuple[str, ...]) -> NDArray[np.int64]:
    places = _places(names)
    return np.array([places[name] for name in wanted], dtype=np.int64)
