"""The evidence of kept views and layer 1 for a placement: where an object's surface is, and where it is not.

Images have a stride that leaves a few thousand pixels a view: a placement reads them ten thousand times.
"""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.camera import backproject
from hickory_stream.geometry.depth_sensor import sigma_at
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.geometry.voxels import keys_of_points
from hickory_stream.ports import Crop, ShapeInputs

_SIDE_PX = 96
_SIDES = (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1])
_SLACK_PX = 1.0
_CELLS = 24
_FAR_SIGMAS = 3.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Evidence:
    """The surface seen, evenly thinned, and K views as stacks."""

    #: (N, 3) in the world
    surface: NDArray[np.float64]
    #: (K, H, W), NaN without a return
    depth: NDArray[np.float32]
    #: (K, H, W) pixels to the nearest one of the mask, 0 in it
    beside: NDArray[np.float32]
    #: (K, 2) rows and columns that are used
    sizes: NDArray[np.int64]
    #: (K, 4) fx, fy, cx, cy
    intrinsics: NDArray[np.float64]
    camera_from_world: NDArray[np.float64]
    #: (K, 4) the mask reaches top, bottom, left, right, beyond which the object may go on
    is_cut: NDArray[np.bool_]
    #: NaN where unknown
    support_z_m: float
    #: sigma of the depth
    noise_m: float
    #: the diagonal of the surface
    size_m: float


def evidence_of(inputs: ShapeInputs) -> Evidence | None:
    """Return the evidence of a job's inputs; None where no surface was measured."""
    measured = [surface_of(crop) for crop in inputs.crops]
    surface = np.concatenate([inputs.points_world.astype(np.float64), *measured])
    if len(surface) == 0:
        return None
    surface = _without_outliers(surface)
    size_m = float(np.sqrt(np.square(np.ptp(surface, axis=0)).sum()))
    if not size_m > 0:
        return None
    small = [_strided(crop) for crop in inputs.crops]
    rows = max((depth.shape[0] for depth, _, _ in small), default=1)
    columns = max((depth.shape[1] for depth, _, _ in small), default=1)
    count = len(small)
    depth_stack = np.full((count, rows, columns), np.nan, np.float32)
    beside_stack = np.zeros((count, rows, columns), np.float32)
    for k, (depth, beside, _) in enumerate(small):
        depth_stack[k, : depth.shape[0], : depth.shape[1]] = depth
        beside_stack[k, : beside.shape[0], : beside.shape[1]] = beside
    masks = [crop.mask for crop in inputs.crops]
    return Evidence(
        surface=_evenly(surface, size_m / _CELLS),
        depth=depth_stack,
        beside=beside_stack,
        sizes=np.array([depth.shape for depth, _, _ in small], dtype=np.int64).reshape(count, 2),
        intrinsics=np.array([intrinsics for _, _, intrinsics in small]).reshape(count, 4),
        camera_from_world=np.array([invert(crop.world_from_camera) for crop in inputs.crops]).reshape(count, 4, 4),
        is_cut=np.array([[m[i].any() for i in _SIDES] for m in masks], dtype=bool).reshape(count, 4),
        support_z_m=np.nan if inputs.support_z_m is None else inputs.support_z_m,
        noise_m=max((noise_of(crop) for crop in inputs.crops), default=0.01 * size_m),
        size_m=size_m,
    )


def surface_of(crop: Crop) -> NDArray[np.float64]:
    """Return the (N, 3) points in the world that a view measured of its object, without those at its edge."""
    return _measured(crop, crop.mask & ~scipy.ndimage.binary_dilation(~crop.mask, iterations=2))


def shown_surface_of(crop: Crop) -> NDArray[np.float64]:
    """Return the (N, 3) points in the world that a view measured of its object, to its edge."""
    return _measured(crop, crop.mask)


def _measured(crop: Crop, mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    points = backproject(crop.depth_m, crop.camera)[mask & np.isfinite(crop.depth_m)]
    return np.asarray(apply(crop.world_from_camera, points.astype(np.float64)))


def _without_outliers(points: NDArray[np.float64]) -> NDArray[np.float64]:
    low, high = np.quantile(points, [0.01, 0.99], axis=0)
    slack = 0.1 * (high - low).max()
    return points[((points >= low - slack) & (points <= high + slack)).all(axis=1)]


def _evenly(points: NDArray[np.float64], cell_m: float) -> NDArray[np.float64]:
    _, which, counts = np.unique(keys_of_points(points, cell_m), return_inverse=True, return_counts=True)
    sums = np.stack([np.bincount(which.reshape(-1), weights=points[:, i]) for i in range(3)], axis=1)
    kept = counts >= min(2, int(counts.max()))
    return np.asarray((sums / counts[:, None])[kept])


def _strided(crop: Crop) -> tuple[NDArray[np.float32], NDArray[np.float32], tuple[float, float, float, float]]:
    stride = -(-max(crop.mask.shape) // _SIDE_PX)
    mask = crop.mask[::stride, ::stride]
    if mask.any():
        beside = np.maximum(scipy.ndimage.distance_transform_edt(~mask) - _SLACK_PX, 0.0).astype(np.float32)
    else:
        beside = np.zeros(mask.shape, np.float32)
    camera = crop.camera
    scaled = (camera.fx / stride, camera.fy / stride, camera.cx / stride, camera.cy / stride)
    return crop.depth_m[::stride, ::stride], beside, scaled


def noise_of(crop: Crop) -> float:
    """Return sigma of the depth of a view's object, in metres."""
    depth = crop.depth_m[crop.mask & np.isfinite(crop.depth_m)]
    return float(sigma_at(float(np.median(depth)), crop.sensor.law)) if len(depth) else 0.0


@kernel
def violation_m(point, depth, beside, size, intrinsics, pose, is_cut, noise):
    """Return by how much a point (3,) of a surface contradicts a view: metres beside the mask, or before its depth."""
    x, y, z = point[0], point[1], point[2]
    depth_z = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
    if depth_z <= 0.05:
        return 0.0
    right = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
    down = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
    u, v = right / depth_z * intrinsics[0] + intrinsics[2], down / depth_z * intrinsics[1] + intrinsics[3]
    if (
        (v < 0 and is_cut[0])
        or (v > size[0] - 1 and is_cut[1])
        or (u < 0 and is_cut[2])
        or (u > size[1] - 1 and is_cut[3])
    ):
        return 0.0
    cu, cv = min(max(u, 0.0), size[1] - 1.0), min(max(v, 0.0), size[0] - 1.0)
    outside = np.sqrt((u - cu) * (u - cu) + (v - cv) * (v - cv))
    column, row = min(int(cu), size[1] - 2), min(int(cv), size[0] - 2)
    if column < 0 or row < 0:
        return 0.0
    fu, fv = cu - column, cv - row
    near = (beside[row, column] * (1 - fu) + beside[row, column + 1] * fu) * (1 - fv) + (
        beside[row + 1, column] * (1 - fu) + beside[row + 1, column + 1] * fu
    ) * fv
    seen = depth[int(cv + 0.5), int(cu + 0.5)]
    beyond = near + outside
    if beyond > 0.0:
        # A nearer surface hides the point.
        if outside == 0.0 and seen < depth_z - _FAR_SIGMAS * noise:
            return 0.0
        return beyond * depth_z / intrinsics[0]
    before = seen - depth_z - noise
    return before if before > 0.0 else 0.0
