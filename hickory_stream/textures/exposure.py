"""The exposure of views evened: a gain for each view and colour, by what two views show of the same places."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.textures.sightings import Sightings

_MOST_PLACES = 4000
_LEAST_SHARED = 20
_LEAST_TRUST = 0.3
# Black and white say nothing of the gain.
_DARK, _BRIGHT = 12.0, 245.0
_MOST_GAIN = 2.5
# What holds the gains near 1, in shared places.
_HOLD = 10.0


def gains_of(seen: Sightings) -> NDArray[np.float64]:
    """Return (V, 3) what the colours of each view are to be multiplied by, least squares of the logarithms.

    The ratio of two views is the median over the places that both show; a view that shares none keeps its colours.
    """
    count, places = seen.trust.shape
    some = slice(None, None, max(places // _MOST_PLACES, 1))
    colors = seen.colors[:, some]
    useful = (seen.trust[:, some] >= _LEAST_TRUST)[..., None] & (colors > _DARK) & (colors < _BRIGHT)
    logs = np.log(np.maximum(colors, 1.0)).astype(np.float64)
    normal = np.tile(np.eye(count)[..., None] * _HOLD, (1, 1, 3))
    wanted = np.zeros((count, 3))
    for i in range(count):
        for j in range(i + 1, count):
            for channel in range(3):
                both = useful[i, :, channel] & useful[j, :, channel]
                shared = float(both.sum())
                if shared < _LEAST_SHARED:
                    continue
                ratio = float(np.median(logs[j, both, channel] - logs[i, both, channel]))
                normal[i, i, channel] += shared
                normal[j, j, channel] += shared
                normal[i, j, channel] -= shared
                normal[j, i, channel] -= shared
                wanted[i, channel] += shared * ratio
                wanted[j, channel] -= shared * ratio
    logs_of_gains = np.stack([np.linalg.solve(normal[..., k], wanted[:, k]) for k in range(3)], axis=1)
    return np.exp(np.clip(logs_of_gains, -np.log(_MOST_GAIN), np.log(_MOST_GAIN)))
