"""A keyframe's depth and structure at low resolution, kept in the journal: for loops, and to explain decisions later.

About 160 cells across for any camera: enough to tell where a pixel was in 3D and whether it was structure, at a
twentieth of the size of a keyframe in the journal.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.records import CoarseFrame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.geometry.camera import Camera

_CELLS_ACROSS = 160
_MOST_MM = 65535.0


def coarse_frame(depth_m: NDArray[np.float32], structure: NDArray[np.bool_], camera: Camera) -> CoarseFrame:
    """Return the low-resolution copy of (H, W) depth and structure; depth beyond 65 m is stored as no return."""
    height, width = depth_m.shape
    stride = max(1, -(-width // _CELLS_ACROSS))
    top, left = min(stride // 2, height - 1), min(stride // 2, width - 1)
    sampled = (slice(top, None, stride), slice(left, None, stride))
    millimetres = np.nan_to_num(depth_m[sampled] * np.float32(1000.0), nan=0.0, posinf=0.0, neginf=0.0)
    millimetres = np.where((millimetres < 0) | (millimetres > _MOST_MM), np.float32(0.0), millimetres)
    return CoarseFrame(
        stride_px=stride,
        depth_mm=np.rint(millimetres).astype(np.uint16),
        structure=structure[sampled].copy(),
        camera=camera,
    )


def cells_of(coarse: CoarseFrame, pixels: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return (N,) depth in metres, NaN = no return, and (N,) whether it is structure, at the cells of (N, 2) pixels."""
    height, width = coarse.depth_mm.shape
    columns, rows = (np.asarray(pixels) // coarse.stride_px).astype(np.int64).T
    at = np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)
    depth_m = coarse.depth_mm[at] / 1000.0
    return np.where(depth_m > 0, depth_m, np.nan), coarse.structure[at]


def enlarged_cells(cells: NDArray[Any], stride_px: int, size: tuple[int, int]) -> NDArray[Any]:
    """Return cells (h, w) at the size of the frame (width, height), by nearest neighbour; the last cells extend."""
    rows = np.minimum(np.arange(size[1]) // stride_px, cells.shape[0] - 1)
    columns = np.minimum(np.arange(size[0]) // stride_px, cells.shape[1] - 1)
    return np.asarray(cells[rows][:, columns])
