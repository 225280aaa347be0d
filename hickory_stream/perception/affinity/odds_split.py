"""Splitting of fragments by the affinity network, where objects are flush, coplanar and of one colour.

The mutex watershed (Wolf et al. 2018) inside each fragment: edges in order of decreasing confidence; an attractive one
joins two neighbouring pixels, a repulsive one between distant pixels forbids joining their groups.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.base.ranges import Ranged, number
from hickory_stream.perception.affinity.pixel_network import DISTANCES_PX, ODDS_UNIT, ODDS_ZERO, OFFSETS, PixelOdds
from hickory_stream.perception.fragments.union_find import find_root

_PER_DISTANCE = len(OFFSETS) // len(DISTANCES_PX)
# Minimum size of a piece in pixels of the network's output: smaller pieces go to the neighbour of the greatest summed
# odds, and smaller fragments are not split.
_MIN_PIXELS = 6


@dataclass(frozen=True, kw_only=True, slots=True)
class SplitConfig(Ranged):
    """When the network divides a fragment."""

    #: Added to the log-odds of being one object: higher values split less, 8 never.
    odds_shift: float = number(8.0, -8, 8, "log-odds")


def divided_by_odds(labels: NDArray[np.int32], odds: PixelOdds, config: SplitConfig) -> NDArray[np.int32]:
    """Return (h, w) fragments 1..n, some of them split; the first piece of a fragment keeps its number."""
    zero = ODDS_ZERO - round(ODDS_UNIT * config.odds_shift)
    if zero <= 0:
        return labels  # no byte is below zero: there is no repulsion
    few = np.ascontiguousarray(labels[::2, ::2])
    pieces = _mutex_watershed(few, odds.odds, np.array(OFFSETS), _PER_DISTANCE, zero)
    pieces = _without_specks(few, pieces, odds.odds, np.array(OFFSETS[:_PER_DISTANCE]), _MIN_PIXELS)
    return np.asarray(_renamed(labels, few, pieces, int(labels.max(initial=0))))


@kernel
def _by_sureness(labels, odds, offsets, num_near, zero):
    # Attractive edges between neighbours and repulsive ones between pixels farther apart, within labels, as pixel and
    # offset index, the most confident first, by counting sort.
    height, width = labels.shape
    starts = np.zeros(258, dtype=np.int64)
    places = np.empty((0, 2), dtype=np.int32)
    for writing in range(2):
        for y in range(height):
            for x in range(width):
                if labels[y, x] == 0:
                    continue
                for i in range(len(offsets)):
                    sure = np.int64(odds[i, y, x]) - zero
                    if (sure <= 0) == (i < num_near):
                        continue
                    yy, xx = y + offsets[i, 0], x + offsets[i, 1]
                    if yy >= height or xx < 0 or xx >= width or labels[yy, xx] != labels[y, x]:
                        continue
                    rank = 256 - abs(sure)
                    if writing:
                        places[starts[rank], 0] = y * width + x
                        places[starts[rank], 1] = i
                        starts[rank] += 1
                    else:
                        starts[rank + 1] += 1
        if not writing:
            starts = np.cumsum(starts)
            places = np.empty((starts[-1], 2), dtype=np.int32)
    return places


@kernel
def _mutex_watershed(labels, odds, offsets, num_near, zero):
    # (h, w) the piece of each pixel, named by the flat index of one of its pixels.
    height, width = labels.shape
    said = _by_sureness(labels, odds, offsets, num_near, zero)
    parent = np.arange(height * width)
    # For each group, the pixels that it must not be joined with: linked lists, concatenated when groups are joined.
    first, last = np.full(height * width, -1), np.full(height * width, -1)
    length = np.zeros(height * width, dtype=np.int64)
    others, following = np.empty(2 * len(said), dtype=np.int32), np.full(2 * len(said), -1)
    count = 0
    for k in range(len(said)):
        a, i = np.int64(said[k, 0]), said[k, 1]
        b = a + offsets[i, 0] * width + offsets[i, 1]
        ra, rb = find_root(parent, a), find_root(parent, b)
        if ra == rb:
            continue
        shorter, longer = (ra, rb) if length[ra] <= length[rb] else (rb, ra)
        is_forbidden = False
        at = first[shorter]
        while at >= 0:
            if find_root(parent, others[at]) == longer:
                is_forbidden = True
                break
            at = following[at]
        if is_forbidden:
            continue
        if i >= num_near:
            for here, there in ((ra, rb), (rb, ra)):
                others[count] = there
                if first[here] < 0:
                    first[here] = count
                else:
                    following[last[here]] = count
                last[here] = count
                length[here] += 1
                count += 1
            continue
        parent[shorter] = longer
        if first[shorter] >= 0:
            if first[longer] < 0:
                first[longer] = first[shorter]
            else:
                following[last[longer]] = first[shorter]
            last[longer] = last[shorter]
            length[longer] += length[shorter]
    return np.array([find_root(parent, i) for i in range(height * width)]).reshape(height, width)


@kernel
def _without_specks(labels, pieces, odds, offsets, min_pixels):
    # Too small pieces are merged with a neighbour of the same label, smallest first.
    height, width = labels.shape
    size = height * width
    area = np.zeros(size, dtype=np.int64)
    for y in range(height):
        for x in range(width):
            if labels[y, x]:
                area[pieces[y, x]] += 1
    parent = np.arange(size)
    for limit in range(1, min_pixels):
        # For each small piece, the neighbour with the greatest sum of odds over their contact.
        names = np.zeros(size, dtype=np.int64)
        count = 0
        for i in range(size):
            if area[i] == limit and parent[i] == i:
                count += 1
                names[i] = count
        if count == 0:
            continue
        best, most = np.full(count + 1, -1), np.zeros(count + 1, dtype=np.int64)
        sums = {(np.int64(0), np.int64(0)): np.int64(0)}
        for y in range(height):
            for x in range(width):
                if labels[y, x] == 0:
                    continue
                a = find_root(parent, pieces[y, x])
                for i in range(len(offsets)):
                    yy, xx = y + offsets[i, 0], x + offsets[i, 1]
                    if yy >= height or xx < 0 or xx >= width or labels[yy, xx] != labels[y, x]:
                        continue
                    b = find_root(parent, pieces[yy, xx])
                    if a == b:
                        continue
                    for here, there in ((a, b), (b, a)):
                        if names[here]:
                            key = (names[here], there)
                            sums[key] = sums.get(key, np.int64(0)) + np.int64(odds[i, y, x]) + 1
                            if sums[key] > most[names[here]]:
                                most[names[here]], best[names[here]] = sums[key], there
        for i in range(size):
            if names[i] and best[names[i]] >= 0:
                a, b = find_root(parent, i), find_root(parent, best[names[i]])
                if a != b:
                    parent[a] = b
                    area[b] += area[a]
    out = np.empty_like(pieces)
    for y in range(height):
        for x in range(width):
            out[y, x] = find_root(parent, pieces[y, x])
    return out


@kernel
def _renamed(labels, few, pieces, count):
    # (h, w) new labels: each pixel takes the piece of the nearest network pixel with the same old label.
    height, width = labels.shape
    names = np.zeros(few.size, dtype=np.int32)
    has_name = np.zeros(count + 1, dtype=np.bool_)
    for y in range(few.shape[0]):
        for x in range(few.shape[1]):
            label = few[y, x]
            if label and names[pieces[y, x]] == 0:
                if has_name[label]:
                    count += 1
                    names[pieces[y, x]] = count
                else:
                    has_name[label] = True
                    names[pieces[y, x]] = label
    out = labels.copy()
    for y in range(height):
        for x in range(width):
            label = labels[y, x]
            if label == 0:
                continue
            nearest = 1 << 30
            for yy in range(max(0, y // 2 - 1), min(few.shape[0], y // 2 + 3)):
                for xx in range(max(0, x // 2 - 1), min(few.shape[1], x // 2 + 3)):
                    away = (2 * yy - y) * (2 * yy - y) + (2 * xx - x) * (2 * xx - x)
                    if few[yy, xx] == label and away < nearest:
                        nearest = away
                        out[y, x] = names[pieces[yy, xx]]
    return out
