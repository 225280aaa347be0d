"""The root of a set of pixels, for union-find in kernels (Tarjan and van Leeuwen 1984)."""

from __future__ import annotations

from hickory_stream.base.compiled import kernel


@kernel
def find_root(parent, i):
    """Return the root of `i`, with path halving."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i
