"""The first step in which the journals of two runs of one log differ: `python -m ...first_difference MAP MAP`."""

import dataclasses
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hickory_stream.journal.reader import Journal

# Measurements of the machine differ from run to run, and decide nothing.
_MEASURED = ("metrics", "shape_counts", "counts", "timings")


def first_difference(a: Path, b: Path) -> list[str]:
    """Return the differences in the first step of two journals that has any; empty where none does."""
    with Journal(a) as journal_a, Journal(b) as journal_b:
        for index, (entry_a, entry_b) in enumerate(zip(journal_a.entries(), journal_b.entries(), strict=False)):
            if found := list(differences(entry_a, entry_b, f"step {index}")):
                return found
        same = len(journal_a) == len(journal_b)
        return [] if same else [f"{len(journal_a)} steps, {len(journal_b)} steps"]


def differences(a: Any, b: Any, name: str) -> Iterator[str]:
    """Yield a line for every difference of two records, floats to the last bit."""
    if type(a) is not type(b):
        yield f"{name}: {a!r:.60} is {b!r:.60}"
    elif dataclasses.is_dataclass(a):
        for field in dataclasses.fields(a):
            if field.name not in _MEASURED:
                yield from differences(getattr(a, field.name), getattr(b, field.name), f"{name}.{field.name}")
    elif isinstance(a, np.ndarray):
        if a.shape != b.shape:
            yield f"{name}: shape {a.shape} is {b.shape}"
        elif a.tobytes() != b.tobytes():
            unequal = int(((a != b) & ~((a != a) & (b != b))).sum())
            most = f", by at most {np.nanmax(np.abs(a - b)):.3g}" if np.issubdtype(a.dtype, np.floating) else ""
            yield f"{name}: {unequal} of {a.size} differ{most}"
    elif isinstance(a, tuple | list):
        if len(a) != len(b):
            yield f"{name}: {len(a)} are {len(b)}"
        for i, (one, other) in enumerate(zip(a, b, strict=False)):
            yield from differences(one, other, f"{name}[{i}]")
    elif isinstance(a, Mapping):
        for key in sorted({*a, *b}, key=str):
            yield from differences(a.get(key), b.get(key), f"{name}[{key}]")
    elif a != b and not (a != a and b != b):
        yield f"{name}: {a!r:.60} is {b!r:.60}"


if __name__ == "__main__":
    print("\n".join(first_difference(Path(sys.argv[1]), Path(sys.argv[2]))[:40]) or "no step differs")
