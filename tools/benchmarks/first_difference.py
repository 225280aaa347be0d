"""Where two runs of one log diverge: the first step whose events differ, and what in them differs.

`python -m tools.benchmarks.first_difference MAP MAP` prints it, for whoever looks for the cause of two digests.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.journal.reader import Journal

if TYPE_CHECKING:
    from collections.abc import Iterator

# What was measured of the machine is not the same twice, and decides nothing.
_MEASURED = ("metrics", "shape_counts", "counts", "timings")


def first_difference(a: Path, b: Path) -> list[str]:
    """Return what differs in the first step of two journals that do; empty where none does."""
    with Journal(a) as journal_a, Journal(b) as journal_b:
        for index, (entry_a, entry_b) in enumerate(zip(journal_a.entries(), journal_b.entries(), strict=False)):
            found = list(differences(entry_a, entry_b, f"step {index}"))
            if found:
                return found
        if len(journal_a) != len(journal_b):
            return [f"{len(journal_a)} steps, {len(journal_b)} steps"]
    return []


def differences(a: Any, b: Any, name: str) -> Iterator[str]:
    """Yield a line for everything in which two records differ, floats to the last bit."""
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
            yield f"{name}: {_how_far(a, b)}"
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


def _how_far(a: np.ndarray, b: np.ndarray) -> str:
    unequal = (a != b) & ~((a != a) & (b != b))
    if not np.issubdtype(a.dtype, np.floating):
        return f"{int(unequal.sum())} of {a.size} differ"
    return f"{int(unequal.sum())} of {a.size} differ, by {float(np.nanmax(np.abs(a - b))):.3g} at most"


def main() -> None:
    """Compare the maps that the command line names."""
    found = first_difference(Path(sys.argv[1]), Path(sys.argv[2]))
    print("\n".join(found[:40]) if found else "no step differs")


if __name__ == "__main__":
    main()
