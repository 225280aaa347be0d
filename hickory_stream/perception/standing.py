"""What carries a piece: whether it stands on something level, hangs in the air, or hides its foot.

Gravity is vertical in the world and nearly so in the image, so what is below a piece is found below its lower outline.
Only the lowest part of a piece counts: the slats of a chair's back hang free, its posts stand.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.compiled import numba

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.perception.seams import Contacts

_FOOT_SHARE = 0.35


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Standing:
    """The lower outline of every piece's foot (index = label), counted in pixels.

    `outline` (count,): all of it, with what the image's border cuts; `free` (count,): farther surface below;
    `on` (count, count + 1): level surface of another piece that it touches, the last column for structure. The rest
    touches something steep or is hidden.
    """

    outline: NDArray[np.int64]
    free: NDArray[np.int64]
    on: NDArray[np.int64]


def standing_of(
    contacts: Contacts, pieces: NDArray[np.int64], heights_m: NDArray[np.float32], level: NDArray[np.bool_]
) -> Standing:
    """Return how the pieces stand; `pieces` names the piece of each label, the last label and highest name structure.

    `heights_m` (h, w) above any level; `level` (h, w): pixels on which something can stand.
    """
    count = int(pieces[-1])
    outline, free, on = _counted(
        (pieces[contacts.here], pieces[contacts.there], contacts.here_px, contacts.there_px),
        (contacts.is_below, contacts.touches, contacts.nearer),
        pieces[contacts.cut],
        contacts.cut_px,
        heights_m.ravel(),
        level.ravel(),
        count,
    )
    return Standing(outline=outline, free=free, on=on)


@numba.njit(cache=True, nogil=True)
def _counted(contacts, marks, edge, edge_px, heights, level, count):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return the three counts of `Standing`: first between which heights a piece's lower outline is, then its foot."""
    here, there, here_px, there_px = contacts
    is_below, touches, nearer = marks
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    for i in range(len(here)):
        if is_below[i] and here[i] != there[i] and here[i] < count:
            z = np.float64(heights[here_px[i]])
            low[here[i]], high[here[i]] = min(low[here[i]], z), max(high[here[i]], z)
    for i in range(len(edge)):
        if edge[i] < count:
            z = np.float64(heights[edge_px[i]])
            low[edge[i]], high[edge[i]] = min(low[edge[i]], z), max(high[edge[i]], z)
    foot = np.zeros(count)
    for k in range(count):
        if np.isfinite(low[k]):
            foot[k] = (1 - _FOOT_SHARE) * low[k] + _FOOT_SHARE * high[k]
    outline, free = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
    on = np.zeros((count, count + 1), dtype=np.int64)
    for i in range(len(here)):
        if not (is_below[i] and here[i] != there[i] and here[i] < count):
            continue
        if np.float64(heights[here_px[i]]) <= foot[here[i]]:
            outline[here[i]] += 1
            if touches[i]:
                on[here[i], there[i]] += level[there_px[i]]
            elif not nearer[i]:
                free[here[i]] += 1
    for i in range(len(edge)):
        if edge[i] < count and np.float64(heights[edge_px[i]]) <= foot[edge[i]]:
            outline[edge[i]] += 1
    return outline, free, on
