"""The root of a set of pixels, for kernels that join pixels by union-find (Tarjan and van Leeuwen 1984)."""

from __future__ import annotations

from hickory_stream.base.compiled import numba


@numba.njit(cache=True, nogil=True)
def find_root(parent, i):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return the root of `i`, with path halving."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i
