"""Disjoint sets as a forest of parents (Tarjan and van Leeuwen 1984)."""

import numpy as np

from hickory_stream.base.compiled import kernel


@kernel
def root_of(parent, i):
    """Return the root of an element in (N,) parents; the path to it is halved."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@kernel
def parts_of(count, one, other):
    """Return the least element of the part of each of `count` elements, of which pairs (`one`, `other`) are joined."""
    parent = np.arange(count)
    for i in range(len(one)):
        a, b = root_of(parent, one[i]), root_of(parent, other[i])
        parent[max(a, b)] = min(a, b)
    for i in range(count):
        parent[i] = root_of(parent, i)
    return parent
