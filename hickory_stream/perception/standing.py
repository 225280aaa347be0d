"""What carries a piece: whether it stands on something level, hangs in the air, or hides its foot.

Gravity is vertical in the world and nearly so in the image, so what is below a piece is found below its lower outline.
Only the lowest part of a piece counts: the slats of a chair's back hang free, its posts stand.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

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
    heights = heights_m.ravel()
    here, there = pieces[contacts.here], pieces[contacts.there]
    outer = contacts.is_below & (here != there) & (here < count)
    here, there, touches = here[outer], there[outer], contacts.touches[outer]
    cut = pieces[contacts.cut] < count
    edge, edge_px = pieces[contacts.cut][cut], contacts.cut_px[cut]
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    for names, at in ((here, contacts.here_px[outer]), (edge, edge_px)):
        np.minimum.at(low, names, heights[at])
        np.maximum.at(high, names, heights[at])
    foot = np.where(np.isfinite(low), (1 - _FOOT_SHARE) * np.nan_to_num(low) + _FOOT_SHARE * np.nan_to_num(high), 0.0)
    at_foot = heights[contacts.here_px[outer]] <= foot[here]
    cut_foot = edge[heights[edge_px] <= foot[edge]]
    here, there, touches = here[at_foot], there[at_foot], touches[at_foot]
    on = touches & level.ravel()[contacts.there_px[outer][at_foot]]
    free = ~touches & ~contacts.nearer[outer][at_foot]
    keys = here[on].astype(np.int64) * (count + 1) + there[on]
    return Standing(
        outline=np.bincount(here, minlength=count) + np.bincount(cut_foot, minlength=count),
        free=np.bincount(here[free], minlength=count),
        on=np.bincount(keys, minlength=count * (count + 1)).reshape(count, count + 1),
    )
