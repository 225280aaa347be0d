"""Fusion of depth images into a truncated signed distance field: near a surface, free, or unobserved.

Signed distances near a surface and free space stay separate until the end. Voxels behind a surface by more than a short
band stay unknown, so that the front of a thin plate never overrules its far side.
"""

from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.depth_sensor import Law, sigma_at
from hickory_stream.geometry.rigid import apply, compose


def gaussian_blurred(
    values: NDArray[np.float32], sigma_voxels: float, mode: Literal["reflect", "nearest"] = "reflect"
) -> NDArray[np.float32]:
    """Return `scipy.ndimage.gaussian_filter` at four standard deviations, with weights of the same bits everywhere."""
    radius = int(4 * sigma_voxels + 0.5)
    weights = portable.gaussian_weights(sigma_voxels, radius)
    for axis in range(values.ndim):
        values = scipy.ndimage.correlate1d(values, weights, axis=axis, mode=mode)
    return values


# Behind a surface the evidence decreases to 0 over this many voxels, so that a plate of that thickness keeps both
# sides.
BAND_BEHIND_VOXELS = 1.5
BAND_BEFORE_VOXELS = 3.0
SMOOTHING_VOXELS = 0.6


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class VoxelGrid:
    """A block of cubic voxels; the origin of its frame is the centre of voxel (0, 0, 0), in units of metres."""

    world_from_grid: NDArray[np.float64]
    voxel_m: float
    shape: tuple[int, int, int]

    def cells(self, points_world: NDArray[Any]) -> NDArray[np.int64]:
        """Return the (N, 3) cells of (N, 3) points, also outside the block."""
        rotation, origin = self.world_from_grid[:3, :3], self.world_from_grid[:3, 3]
        return np.round(portable.matmul(points_world.astype(np.float64) - origin, rotation) / self.voxel_m).astype(
            np.int64
        )

    def points_world(self, cells: NDArray[Any]) -> NDArray[np.float64]:
        """Return the (N, 3) world points of (N, 3) cell coordinates, fractional ones included."""
        return apply(self.world_from_grid, cells.astype(np.float64) * self.voxel_m)

    def contains(self, cells: NDArray[Any]) -> NDArray[np.bool_]:
        """Return for each of (N, 3) cells whether it lies in the block."""
        return np.asarray(((cells >= 0) & (cells < np.array(self.shape))).all(axis=1))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class DepthView:
    """A depth image as the integration uses it."""

    depth_m: NDArray[np.float32]
    mask: NDArray[np.bool_]
    camera: Camera
    #: may contain a reflection (a mirrored view)
    camera_from_world: NDArray[np.float64]
    #: the depth noise between views, a multiple of the sensor's
    law: Law
    #: scales the view's weight
    trust: float = 1.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Evidence:
    """The evidence of the views for every voxel of a grid, three float32 arrays of its shape."""

    #: the weighted mean signed distance in voxels
    distance: NDArray[np.float32]
    #: the weight of `distance`
    near: NDArray[np.float32]
    #: the weight of the views that saw through the voxel
    free: NDArray[np.float32]


def integrate(grid: VoxelGrid, views: list[DepthView]) -> Evidence:
    """Return the evidence of `views` for the voxels of `grid`."""
    total = np.zeros(grid.shape, np.float32)
    near = np.zeros(grid.shape, np.float32)
    free = np.zeros(grid.shape, np.float32)
    for view in views:
        camera_from_grid = compose(view.camera_from_world, grid.world_from_grid)
        depth = smoothed_depth(view.depth_m, view.mask, view.law)
        camera = view.camera
        intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        # Up to the nearest depth among 3 x 3 pixels space is certainly free, even beside an edge.
        nearest = cv2.erode(
            np.where(np.isnan(view.depth_m), np.float32(np.inf), view.depth_m), np.ones((3, 3), np.uint8)
        )
        carve = np.where(view.depth_m > 0, nearest, np.float32(np.nan))
        # Pixels at the border of the mask may have a depth from behind the object.
        cross = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)
        inner = cv2.erode(view.mask.view(np.uint8), cross, borderType=cv2.BORDER_CONSTANT, borderValue=0).view(np.bool_)
        cosine = np.ones_like(depth)
        _fill_cosine(depth, float(camera.fx), float(camera.fy), cosine)
        _integrate(
            total, near, free, camera_from_grid, grid.voxel_m,
            depth, cosine, carve, view.mask, inner, intrinsics, view.law, view.trust,
        )  # fmt: skip
    # Averaging over a voxel's neighbours reduces the noise of few views, without moving planes or the middle of plates.
    spread = gaussian_blurred(near, SMOOTHING_VOXELS)
    distance = gaussian_blurred(total, SMOOTHING_VOXELS) / np.maximum(spread, np.float32(1e-9))
    return Evidence(distance=distance.astype(np.float32), near=near, free=free)


def smoothed_depth(depth_m: NDArray[np.float32], mask: NDArray[np.bool_], law: Law) -> NDArray[np.float32]:
    """Return the depth averaged within the mask over 5 x 5 pixels that lie within four sigma; holes stay holes."""
    out = np.full_like(depth_m, np.nan)
    _smooth(depth_m, mask, law, out)
    return out


@kernel
def _smooth(depth, mask, law, out):
    height, width = depth.shape
    for row in range(height):
        for column in range(width):
            middle = depth[row, column]
            if not mask[row, column] or not middle > 0.0:
                continue
            gate = 4.0 * sigma_at(np.float64(middle), law)
            total, count = 0.0, 0.0
            for r in range(max(row - 2, 0), min(row + 3, height)):
                for c in range(max(column - 2, 0), min(column + 3, width)):
                    if mask[r, c] and abs(depth[r, c] - middle) <= gate:
                        total += depth[r, c]
                        count += 1.0
            out[row, column] = total / max(count, 1.0)


@kernel
def _fill_cosine(depth, fx, fy, out):
    # In 0.25..1; it converts depths to true distances.
    height, width = depth.shape
    for row in range(height):
        for column in range(width):
            z = depth[row, column]
            if not z > 0.0:
                continue
            left, right = depth[row, max(column - 2, 0)], depth[row, min(column + 2, width - 1)]
            above, below = depth[max(row - 2, 0), column], depth[min(row + 2, height - 1), column]
            # A one-sided difference if the other side is a hole; 0 if both are.
            dx = 0.25 * (right - left)
            if not abs(dx) < 1e9:
                dx = 0.5 * (right - z) if right > 0.0 else (0.5 * (z - left) if left > 0.0 else 0.0)
            dy = 0.25 * (below - above)
            if not abs(dy) < 1e9:
                dy = 0.5 * (below - z) if below > 0.0 else (0.5 * (z - above) if above > 0.0 else 0.0)
            a, b = dx * fx / z, dy * fy / z
            out[row, column] = max(0.25, 1.0 / np.sqrt(1.0 + a * a + b * b))


@kernel
def _integrate(total, near, free, camera_from_grid, voxel, depth, cosine, carve, mask, inner, intrinsics, law, trust):
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    m = camera_from_grid
    for i in range(total.shape[0]):
        for j in range(total.shape[1]):
            for k in range(total.shape[2]):
                gx, gy, gz = i * voxel, j * voxel, k * voxel
                z = m[2, 0] * gx + m[2, 1] * gy + m[2, 2] * gz + m[2, 3]
                if z <= 0.05:
                    continue
                x = m[0, 0] * gx + m[0, 1] * gy + m[0, 2] * gz + m[0, 3]
                y = m[1, 0] * gx + m[1, 1] * gy + m[1, 2] * gz + m[1, 3]
                column = int(np.floor(x / z * fx + cx + 0.5))
                row = int(np.floor(y / z * fy + cy + 0.5))
                if column < 0 or row < 0 or column >= width or row >= height:
                    continue
                sigma = sigma_at(z, law)
                before = max(BAND_BEFORE_VOXELS * voxel, 3.0 * sigma)
                weight = trust / (1.0 + z * z)
                if not mask[row, column]:
                    # A nearer surface occludes the voxel; one at its depth is another object's: neither is evidence.
                    if carve[row, column] - z > max(voxel, 2.0 * sigma):
                        free[i, j, k] += weight
                    continue
                along = depth[row, column] - z
                if not abs(along) < 1e9:
                    continue
                slope = cosine[row, column]
                distance = along * slope
                behind = max(BAND_BEHIND_VOXELS * voxel, sigma * slope)
                if along > before and distance > voxel:
                    if inner[row, column] and carve[row, column] - z > before:
                        free[i, j, k] += weight
                elif distance > -behind:
                    # The band is symmetric: otherwise averaging would move the surface inwards.
                    fade = max(1.0 - abs(distance) / behind, 0.02)
                    total[i, j, k] += weight * fade * min(distance / voxel, 3.0)
                    near[i, j, k] += weight * fade
