"""Shape completion: which of the unobserved voxels belong to the object.

An unknown voxel is solid if seen surface that faces two different ways along the object's axes lies over it: planes
continue to their own edges, and a plate is as thick as its edge. A front alone ends in a closing face behind it.
"""

import numpy as np
import scipy
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.shapes.reconstruct.tsdf import Evidence, gaussian_blurred

UNKNOWN, FREE, SOLID, _FACING = 0, 1, 2, 3
# Two for each axis; `_facing` names them by their index.
_WAYS = np.array([[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]])
_NOWHERE = 6
# Blur of free space for the direction of a surface, and of the space behind it, so that no column decides alone.
_BLUR_VOXELS = 1.0
# Separate pieces smaller than this share of the largest are dropped.
_MIN_PIECE_SHARE = 0.02


def classify(evidence: Evidence, surface_cells: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Return UNKNOWN, FREE or SOLID per voxel; `surface_cells` (N, 3) of layer 1 are solid unless seen free."""
    states = np.full(evidence.near.shape, UNKNOWN, np.uint8)
    is_near = evidence.near > evidence.free
    states[evidence.free > 0] = FREE
    states[is_near & (evidence.distance > 0)] = FREE
    states[is_near & (evidence.distance <= 0)] = SOLID
    i, j, k = surface_cells.T
    unseen = states[i, j, k] == UNKNOWN
    states[i[unseen], j[unseen], k[unseen]] = SOLID
    return states


def solid_of(
    states: NDArray[np.uint8], fillable: tuple[slice, slice, slice], support_index: int | None, max_gap: int
) -> NDArray[np.bool_]:
    """Return the solid, completed within `fillable`.

    `support_index` is the lowest layer above the support surface, `max_gap` is in voxels.
    """
    states = states.copy()
    states[:, :, : support_index or 0] = UNKNOWN
    first = _first_known(states)
    is_behind = (first == _FACING).any(axis=1).astype(np.float32)
    num_axes = sum((gaussian_blurred(one, _BLUR_VOXELS, mode="nearest") > 0.5).astype(np.uint8) for one in is_behind)
    claimed = np.zeros(states.shape, dtype=bool)
    claimed[fillable] = ((states == UNKNOWN) & (num_axes >= 2))[fillable]
    claimed[:, :, : support_index or 0] = False
    solid = _without_hair((states == SOLID) | claimed, states)
    if support_index is not None:
        # A column under an outlier voxel must not become a spike on the floor.
        below = np.where(_is_open(first[:2]), FREE, states)
        solid = _without_hair(_down_to_support(solid, below, support_index, max_gap), states)
    return large_pieces(np.asarray(scipy.ndimage.binary_fill_holes(solid)), _MIN_PIECE_SHARE)


def _first_known(states: NDArray[np.uint8]) -> NDArray[np.uint8]:
    # (3, 2, ...) the first known state along each axis, down and up; _FACING: solid, and its surface faces that way.
    facing = _facing(states)
    first = np.empty((len(_WAYS), *states.shape), np.uint8)
    for way, step in enumerate(_WAYS):
        _fill_first_known(states, facing, way, step, first[way])
    return first.reshape(3, 2, *states.shape)


def _facing(states: NDArray[np.uint8]) -> NDArray[np.uint8]:
    # Per voxel the way that free space lies, _NOWHERE without any near.
    is_free = (states == FREE).astype(np.float32)
    slopes = np.array(np.gradient(gaussian_blurred(is_free, _BLUR_VOXELS, mode="nearest")))
    axis = np.abs(slopes).argmax(axis=0)
    slope = np.take_along_axis(slopes, axis[None], axis=0)[0]
    return np.where(slope == 0, _NOWHERE, 2 * axis + (slope > 0)).astype(np.uint8)


def _is_open(first: NDArray[np.uint8]) -> NDArray[np.bool_]:
    # Seen free from one side, unbounded on the other, and no surface on any: under an edge that ends in the air.
    is_free, is_unknown = first == FREE, first == UNKNOWN
    is_one_sided = (is_free.sum(axis=1) == 1) & (is_unknown.sum(axis=1) == 1)
    return np.asarray(is_one_sided.any(axis=0) & (is_free | is_unknown).all(axis=(0, 1)))


def _without_hair(solid: NDArray[np.bool_], states: NDArray[np.uint8]) -> NDArray[np.bool_]:
    # Completed voxels that a majority filter would not keep; observed voxels stay.
    share = scipy.ndimage.uniform_filter(solid.astype(np.float32), 3, mode="constant")
    return np.asarray((states == SOLID) | ((states == UNKNOWN) & (share > 0.5)))


def _down_to_support(
    solid: NDArray[np.bool_], states: NDArray[np.uint8], support_index: int, max_gap: int
) -> NDArray[np.bool_]:
    # Through unknown voxels only.
    out = solid.copy()
    out[:, :, :support_index] = False
    top = min(support_index + max_gap, solid.shape[2] - 1)
    for k in range(top - 1, support_index - 1, -1):
        out[:, :, k] |= out[:, :, k + 1] & (states[:, :, k] != FREE)
    return out


def large_pieces(solid: NDArray[np.bool_], min_share: float) -> NDArray[np.bool_]:
    """Return the solid without pieces below a share of the largest."""
    labels, count = scipy.ndimage.label(solid)
    if count < 2:
        return solid
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    return np.asarray((sizes >= min_share * sizes.max())[labels] & solid)


@kernel
def _fill_first_known(states, facing, way, step, first):
    # UNKNOWN where the block ends first. A solid voxel without free space near lets the surface beyond it count.
    nx, ny, nz = states.shape
    for a in range(nx):
        i = nx - 1 - a if step[0] > 0 else a
        for b in range(ny):
            j = ny - 1 - b if step[1] > 0 else b
            for c in range(nz):
                k = nz - 1 - c if step[2] > 0 else c
                u, v, w = i + step[0], j + step[1], k + step[2]
                state = np.uint8(UNKNOWN)
                if u >= 0 and v >= 0 and w >= 0 and u < nx and v < ny and w < nz:
                    state = states[u, v, w]
                    if state == UNKNOWN or (
                        state == SOLID and facing[u, v, w] == _NOWHERE and first[u, v, w] == _FACING
                    ):
                        state = first[u, v, w]
                    elif state == SOLID and facing[u, v, w] == way:
                        state = np.uint8(_FACING)
                first[i, j, k] = state
