"""Disjoint sets as a forest of parents (Tarjan and van Leeuwen 1984)."""

from hickory_stream.base.compiled import kernel


@kernel
def root_of(parent, i):
    """Return the root of an element in (N,) parents; the path to it is halved."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i
