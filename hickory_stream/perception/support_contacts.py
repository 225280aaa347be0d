"""Support of regions: which region rests on a horizontal surface of which other one, and which is unsupported.

Gravity is vertical in the world and nearly so in the image, so that the support surface is searched below the lower
outline of a region. Only the lowest part of the outline, the foot, counts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.compiled import numba

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.perception.contacts import Contacts

_FOOT_SHARE = 0.35


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SupportContacts:
    """Pixel counts along the lower outline of each region's foot (row = region).

    `outline` (count,): all pixels, including those on the image border; `free` (count,): those with a farther surface
    below, which are unsupported; `on` (count, count + 1): those that touch a horizontal surface of the column's region
    (last column: room structure). The rest touches a steep surface or is occluded.
    """

    outline: NDArray[np.int64]
    free: NDArray[np.int64]
    on: NDArray[np.int64]


def support_contacts_of(
    contacts: Contacts, pieces: NDArray[np.int64], heights_m: NDArray[np.float32], level: NDArray[np.bool_]
) -> SupportContacts:
    """Return the support contacts of regions; `pieces` (labels,) gives the region of each label.

    The last label is room structure, which has the highest region number. `heights_m` (h, w) count from any origin;
    `level` (h, w): pixels of surfaces that can support something.
    """
    count = int(pieces[-1])
    outline, free, on = _counted(
        (contacts.here, contacts.there, contacts.here_px, contacts.there_px),
        (contacts.is_below, contacts.touches, contacts.nearer),
        (contacts.cut, contacts.cut_px),
        pieces,
        heights_m.ravel(),
        level.ravel(),
        count,
    )
    return SupportContacts(outline=outline, free=free, on=on)


@numba.njit(cache=True, nogil=True)
def _counted(contacts, marks, edge, pieces, heights, level, count):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return the counts of `SupportContacts`: a first pass finds the foot of each region, a second one counts it."""
    here_labels, there_labels, here_px, there_px = contacts
    is_below, touches, nearer = marks
    edge_labels, edge_px = edge
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    for i in range(len(here_labels)):
        here = pieces[here_labels[i]]
        if is_below[i] and here != pieces[there_labels[i]] and here < count:
            z = np.float64(heights[here_px[i]])
            low[here], high[here] = min(low[here], z), max(high[here], z)
    for i in range(len(edge_labels)):
        here = pieces[edge_labels[i]]
        if here < count:
            z = np.float64(heights[edge_px[i]])
            low[here], high[here] = min(low[here], z), max(high[here], z)
    foot = np.zeros(count)
    for k in range(count):
        if np.isfinite(low[k]):
            foot[k] = (1 - _FOOT_SHARE) * low[k] + _FOOT_SHARE * high[k]
    outline, free = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
    on = np.zeros((count, count + 1), dtype=np.int64)
    for i in range(len(here_labels)):
        here, there = pieces[here_labels[i]], pieces[there_labels[i]]
        if not (is_below[i] and here != there and here < count):
            continue
        if np.float64(heights[here_px[i]]) <= foot[here]:
            outline[here] += 1
            if touches[i]:
                on[here, there] += level[there_px[i]]
            elif not nearer[i]:
                free[here] += 1
    for i in range(len(edge_labels)):
        here = pieces[edge_labels[i]]
        if here < count and np.float64(heights[edge_px[i]]) <= foot[here]:
            outline[here] += 1
    return outline, free, on
