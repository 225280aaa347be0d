"""Boxes around the residuals of a fit: surface outside all primitives, such as a plant's leaves or a chair's arms.

Greedily, the group is split by the plane that saves the most volume, until no split saves enough. Planes and boxes
follow the axes of the object or the principal axes of the group, whichever gives less volume.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable

# A split must save at least this share of the volume of all boxes.
_LEAST_GAIN = 0.03


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Box:
    """A box: the indices (N,) of its triangles, (3,) its centre and half extents, (3, 3) its axes as columns."""

    held: NDArray[np.int64]
    center: NDArray[np.float64]
    half_extents: NDArray[np.float64]
    axes: NDArray[np.float64]


def boxes_around(corners: NDArray[np.float64], axes: NDArray[np.float64], *, margin: float, most: int) -> list[Box]:
    """Return up to `most` boxes that contain (N, 3, 3) triangles, each entirely in one box; their volume is kept small.

    Volumes include the margin. The columns of `axes` (3, 3) are tried besides the principal axes.
    """
    groups = [_Group.of(np.arange(len(corners)), corners, axes, margin)]
    while len(groups) < most:
        gains = [group.volume - group.volume_cut for group in groups]
        cut = int(np.argmax(gains))
        if gains[cut] <= _LEAST_GAIN * sum(group.volume for group in groups):
            break
        group = groups.pop(cut)
        sides = (group.items[group.is_before], group.items[~group.is_before])
        groups += [_Group.of(side, corners, axes, margin) for side in sides]
    return [group.box for group in groups]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Group:
    items: NDArray[np.int64]
    box: Box
    volume: float
    is_before: NDArray[np.bool_]
    volume_cut: float

    @classmethod
    def of(
        cls, items: NDArray[np.int64], corners: NDArray[np.float64], axes: NDArray[np.float64], margin: float
    ) -> "_Group":
        points = corners[items].reshape(-1, 3)
        frames = (axes, _principal_axes(points))
        triangles = np.stack([portable.matmul(points, frame).reshape(-1, 3, 3) for frame in frames])
        lows, highs = (_of_corners(reduced, triangles) for reduced in (np.minimum, np.maximum))
        volumes = (highs.max(axis=1) - lows.min(axis=1) + 2 * margin).prod(axis=1)
        best = int(np.argmin(volumes))
        low, high = lows[best].min(axis=0), highs[best].max(axis=0)
        is_before, volume_cut = _best_cut(lows, highs, margin)
        return cls(
            items=items,
            box=Box(
                held=items,
                center=portable.matmul(frames[best], (low + high) / 2),
                half_extents=(high - low) / 2,
                axes=frames[best],
            ),
            volume=float(volumes[best]),
            is_before=is_before,
            volume_cut=float(volume_cut),
        )


def _of_corners(reduced: np.ufunc, triangles: NDArray[np.float64]) -> NDArray[np.float64]:
    # NumPy's own reduction of so short an axis is slow.
    return np.asarray(reduced(reduced(triangles[:, :, 0], triangles[:, :, 1]), triangles[:, :, 2]))


def _best_cut(lows: NDArray[np.float64], highs: NDArray[np.float64], margin: float) -> tuple[NDArray[np.bool_], float]:
    # (N,) triangles on the first side of the best plane, and the volume of both boxes; planes normal to the axes of F
    # frames.
    side, least = np.zeros(lows.shape[1], np.bool_), np.inf
    before, after = np.empty((2, len(side)))
    for middles in (lows + highs).transpose(0, 2, 1).reshape(-1, len(side)) if len(side) > 1 else ():
        order = np.argsort(middles, kind="stable")
        _fill_volumes(lows, highs, order, margin, before)
        _fill_volumes(lows, highs, order[::-1].copy(), margin, after)
        volumes = before[:-1] + after[-2::-1]
        at = int(volumes.argmin())
        if volumes[at] < least:
            least = float(volumes[at])
            side[:] = False
            side[order[: at + 1]] = True
    return side, least


@kernel
def _fill_volumes(lows, highs, order, margin, out):
    # Of the boxes around the first of the triangles, in the better frame.
    for frame in range(len(lows)):
        a, b, c, x, y, z = np.inf, np.inf, np.inf, -np.inf, -np.inf, -np.inf
        for n in range(len(order)):
            i = order[n]
            a, b, c = min(a, lows[frame, i, 0]), min(b, lows[frame, i, 1]), min(c, lows[frame, i, 2])
            x, y, z = max(x, highs[frame, i, 0]), max(y, highs[frame, i, 1]), max(z, highs[frame, i, 2])
            volume = (x - a + 2.0 * margin) * (y - b + 2.0 * margin) * (z - c + 2.0 * margin)
            out[n] = volume if frame == 0 else min(out[n], volume)


def _principal_axes(points: NDArray[np.float64]) -> NDArray[np.float64]:
    off = points - points.mean(axis=0)
    _, axes = portable.eigh(portable.matmul(off.T, off))
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    return np.asarray(axes)
