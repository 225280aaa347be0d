"""Hypotheses from what a place has but once.

Where a place repeats itself, transforms that lay its copies on one another explain the most, and there are dozens of
them: the true one is not among the few that are searched for. It is found by the objects of which a map has no second:
each two of them whose distance both maps have give a transform.
"""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.alignment.hypothesis import grown

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.alignment.hypothesis import Evidence, Hypothesis

# A thing that is in a map once looks like so many of the other's at most, itself and one by chance.
_MOST_ALIKE = 2
_MOST_PAIRS = 16
# Where more of a map's objects are lone the search finds what there is.
_MOST_LONE = 0.5


def unrepeated_hypotheses(evidence: Evidence, is_alike: NDArray[np.bool_]) -> list[Hypothesis]:
    """Return the hypotheses grown from each two pairs of objects that no others look like; none if most are such.

    Args:
        evidence: about the two maps; what it holds plausible can be matched.
        is_alike: (N, M) which objects look alike.
    """
    is_lone_a, is_lone_b = (is_alike.sum(axis=axis) <= _MOST_ALIKE for axis in (1, 0))
    if min(is_lone_a.mean(), is_lone_b.mean()) > _MOST_LONE:
        return []
    pairs = np.argwhere(is_alike & is_lone_a[:, None] & is_lone_b)
    pairs = pairs[np.argsort(evidence.log_ranks[pairs[:, 0], pairs[:, 1]], kind="stable")[:_MOST_PAIRS]]
    found = []
    for i, j in combinations(range(len(pairs)), 2):
        two = pairs[[i, j]]
        if _agree(evidence, two):
            hypothesis = grown(evidence, two, is_level=True)
            if hypothesis is not None:
                found.append(hypothesis)
    return found


def _agree(evidence: Evidence, two: NDArray[np.int64]) -> bool:
    """Return whether two pairs (2, 2) are of four objects that are as far apart in both maps, and not in one place."""
    if two[0, 0] == two[1, 0] or two[0, 1] == two[1, 1]:
        return False
    step_a = np.subtract(*evidence.centroids_a[two[:, 0]])
    step_b = np.subtract(*evidence.centroids_b[two[:, 1]])
    level_a, level_b = np.hypot(*step_a[:2]), np.hypot(*step_b[:2])
    # A distance has the noise of two residuals.
    reach_m = evidence.gate * np.sqrt(2.0) * evidence.sigma_m
    return bool(
        min(level_a, level_b) > reach_m and abs(level_a - level_b) < reach_m and abs(step_a[2] - step_b[2]) < reach_m
    )
