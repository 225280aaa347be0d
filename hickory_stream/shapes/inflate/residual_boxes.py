"""Boxes around the residuals of a fit: surface outside all primitives, such as a plant's leaves or a chair's arms.

Greedily, the group is split by the plane that saves the most volume, until no split saves enough. Planes and boxes
follow the axes of the object or the principal axes of the group, whichever gives less volume.
"""

from __future__ import annotations

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
    ) -> _Group:
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


@kernel
def _best_cut(lows, highs, margin):
    # (N,) triangles on the first side of the best plane, and the volume of both boxes; planes normal to the axes of F
    # frames.
    num_frames, count = lows.shape[0], lows.shape[1]
    before = np.empty(count)
    after = np.empty(count)
    least, first_side = np.inf, np.empty(0, np.int64)
    for frame in range(num_frames):
        for axis in range(3):
            order = np.argsort(lows[frame, :, axis] + highs[frame, :, axis], kind="mergesort")
            _volumes_from_first(lows, highs, order, margin, before)
            _volumes_from_first(lows, highs, order[::-1], margin, after)
            at = -1
            for n in range(count - 1):
                if before[n] + after[count - 2 - n] < least:
                    least, at = before[n] + after[count - 2 - n], n
            if at >= 0:
                first_side = order[: at + 1]
    side = np.zeros(count, np.bool_)
    side[first_side] = True
    return side, least


@kernel
def _volumes_from_first(lows, highs, order, margin, out):
    out[:] = np.inf
    for frame in range(len(lows)):
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for n in range(len(order)):
            volume = 1.0
            for i in range(3):
                low[i] = min(low[i], lows[frame, order[n], i])
                high[i] = max(high[i], highs[frame, order[n], i])
                volume *= high[i] - low[i] + 2.0 * margin
            out[n] = min(out[n], volume)


def _principal_axes(points: NDArray[np.float64]) -> NDArray[np.float64]:
    off = points - points.mean(axis=0)
    _, axes = portable.eigh(portable.matmul(off.T, off))
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    return np.asarray(axes)
