"""Pairs of which each member is in one alone, the best first."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Iterable

A = TypeVar("A")
B = TypeVar("B")


def one_to_one(ranked: Iterable[tuple[A, B]], *, of_one_kind: bool) -> list[tuple[A, B]]:
    """Return the pairs, best first, without those that have a member of an earlier one.

    `of_one_kind`: a first and a second member may be the same thing, as where tracks are paired with tracks.
    """
    firsts: set[A | B] = set()
    seconds: set[A | B] = firsts if of_one_kind else set()
    pairs = []
    for a, b in ranked:
        if a not in firsts and b not in seconds:
            firsts.add(a)
            seconds.add(b)
            pairs.append((a, b))
    return pairs
