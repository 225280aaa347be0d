"""A keyframe's depth and structure at low resolution, kept in the journal for loops and explanations.

About 160 cells across for any camera, at a twentieth of the size of a keyframe in the journal.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.camera import Camera
from hickory_stream.records import CoarseFrame

_CELLS_ACROSS = 160
_MOST_MM = 65535.0


def coarse_frame(depth_m: NDArray[np.float32], structure: NDArray[np.bool_], camera: Camera) -> CoarseFrame:
    """Return the low-resolution copy of (H, W) depth and structure; depth beyond 65 m is no return."""
    stride = _stride_of(depth_m.shape[1])
    kept = structure[sampled_pixels(depth_m.shape, stride)].copy()
    return CoarseFrame(stride_px=stride, depth_mm=coarse_depth(depth_m), structure=kept, camera=camera)


def coarse_depth(depth_m: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Return the low-resolution copy of depth (H, W) alone, in millimetres; 0 = no return."""
    sampled = depth_m[sampled_pixels(depth_m.shape, _stride_of(depth_m.shape[1]))]
    millimetres = np.nan_to_num(sampled * np.float32(1000.0), nan=0.0, posinf=0.0, neginf=0.0)
    millimetres = np.where((millimetres < 0) | (millimetres > _MOST_MM), np.float32(0.0), millimetres)
    return np.rint(millimetres).astype(np.uint16)


def coarse_camera(camera: Camera) -> Camera:
    """Return the camera whose pixels are the cells."""
    return sampled_camera(camera, _stride_of(camera.width))


def sampled_camera(camera: Camera, stride: int) -> Camera:
    """Return the camera of the `sampled_pixels` of its images."""
    rows, columns = sampled_pixels((camera.height, camera.width), stride)
    return Camera(
        width=len(range(camera.width)[columns]),
        height=len(range(camera.height)[rows]),
        fx=camera.fx / stride,
        fy=camera.fy / stride,
        cx=(camera.cx - columns.start) / stride,
        cy=(camera.cy - rows.start) / stride,
    )


def _stride_of(width_px: int) -> int:
    return max(1, -(-width_px // _CELLS_ACROSS))


def sampled_pixels(shape: tuple[int, ...], stride: int) -> tuple[slice, slice]:
    """Return the middle pixel of every cell of an image (H, W); one that is smaller than a cell still has one."""
    top, left = min(stride // 2, shape[0] - 1), min(stride // 2, shape[1] - 1)
    return slice(top, None, stride), slice(left, None, stride)


def cells_of(coarse: CoarseFrame, pixels: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return (N,) depth in metres, NaN = no return, and (N,) whether it is structure, at the cells of (N, 2) pixels."""
    height, width = coarse.depth_mm.shape
    columns, rows = (np.asarray(pixels) // coarse.stride_px).astype(np.int64).T
    at = np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)
    depth_m = coarse.depth_mm[at] / 1000.0
    return np.where(depth_m > 0, depth_m, np.nan), coarse.structure[at]


def enlarged_cells(cells: NDArray[Any], stride_px: int, size: tuple[int, int]) -> NDArray[Any]:
    """Return cells (h, w) at the size of the frame (width, height), by nearest neighbour."""
    rows = np.minimum(np.arange(size[1]) // stride_px, cells.shape[0] - 1)
    columns = np.minimum(np.arange(size[0]) // stride_px, cells.shape[1] - 1)
    return np.asarray(cells[rows][:, columns])
