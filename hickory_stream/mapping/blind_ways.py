"""How far a camera went, and turned, along directions in which nothing was seen that could tell: in a corridor, say.

The lengths of a way add up to a matrix (6, 6), turns (rad) first, then shifts (m), along the axes of the map: for each
step that of its unit directions, times how far it went. Its product with a direction is the length along that.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import rotation_angle_rad

if TYPE_CHECKING:
    from numpy.typing import NDArray


def longer(
    lengths: NDArray[np.float64] | None,
    directions: NDArray[np.float64],
    before: NDArray[np.float64] | None,
    now: NDArray[np.float64],
) -> NDArray[np.float64] | None:
    """Return the lengths after a step from one pose of the camera (4, 4) to the next, blind along (K, 6) directions.

    None is a way of no length; so is a step from no pose, and one that was seen in every direction.
    """
    if before is None or not len(directions):
        return lengths
    way_m = portable.norm(now[:3, 3] - before[:3, 3])
    turn_rad = rotation_angle_rad(portable.matmul(before[:3, :3].T, now[:3, :3]))
    root = np.sqrt([turn_rad] * 3 + [way_m] * 3) * directions
    step = portable.matmul(root.T, root)
    return step if lengths is None else lengths + step
