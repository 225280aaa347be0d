"""Shape completion: which of the unobserved voxels belong to the object.

An unknown voxel is solid if most rays from it hit the object and hardly any reach free space: the inside of a half-seen
box is filled, the space behind a leg is not, nor that below a wide object whose lower edge was seen in the air.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from hickory_stream.base.compiled import kernel
from hickory_stream.shapes.reconstruct.tsdf import Evidence

UNKNOWN, FREE, SOLID = 0, 1, 2
# The lowest voxels of an object may be merged with its support surface by blur.
_DOWN = 2
# Of the 26 directions around an unknown voxel at least this share must hit the object, and the number that reach free
# space may be at most this ratio of the hits, times the share of the object's box not observed free.
_MIN_HIT_SHARE = 0.08
_MAX_FREE_RATIO = 0.9
# It stands on feet if its surface ends in the air along this share of its outline, at most at this share of its height,
# and in this ratio of places to those that reach the support.
_MIN_EDGE = 0.33
_MAX_CLEAR = 0.35
_EDGE_RATIO = 1.5
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
    states: NDArray[np.uint8],
    fillable: tuple[slice, slice, slice],
    support_index: int | None,
    max_gap: int,
    *,
    is_wide: bool = False,
) -> NDArray[np.bool_]:
    """Return the completed solid, unknown voxels filled within `fillable`; only if `is_wide` may it stand on feet.

    `support_index` is the lowest layer above the support surface, `max_gap` is in voxels.
    """
    states = states.copy()
    states[:, :, : support_index or 0] = UNKNOWN
    enclosed = np.zeros(states.shape, dtype=bool)
    # The more of the box was observed free, the less likely are unknown voxels to be solid.
    share = float((states[fillable] != FREE).mean())
    hits, frees = look_around(states)
    max_free_ratio = _MAX_FREE_RATIO * share
    enclosed[fillable] = ((hits >= _MIN_HIT_SHARE) & (frees <= max_free_ratio * hits))[fillable]
    enclosed[:, :, : support_index or 0] = False
    clear = _under_edge(states, fillable, support_index) if is_wide and support_index is not None else None
    if clear is not None:
        enclosed &= ~clear
    solid = (states == SOLID) | ((states == UNKNOWN) & enclosed)
    solid = _without_hair(solid, states)
    if support_index is not None and clear is None:
        # A column under an outlier voxel must not become a spike on the floor.
        solid = _without_hair(_down_to_support(solid, states, support_index, max_gap), states)
    return large_pieces(np.asarray(ndimage.binary_fill_holes(solid)), _MIN_PIECE_SHARE)


def _under_edge(
    states: NDArray[np.uint8], fillable: tuple[slice, slice, slice], support_index: int
) -> NDArray[np.bool_] | None:
    # None if the object has no feet; without its visible feet.
    observed = states == SOLID
    i, j = np.nonzero(observed.any(axis=2))
    lowest = observed.argmax(axis=2)[i, j]
    above = lowest - support_index
    ends_in_air = states[i, j, np.maximum(lowest - 1, 0)] == FREE
    nx, ny, nz = states.shape
    is_edge = ends_in_air & (above > _DOWN) & (above <= _MAX_CLEAR * (nz - support_index))
    is_down = above <= _DOWN
    outline = 2 * sum(extent.stop - extent.start for extent in fillable[:2])
    if is_edge.sum() < max(_MIN_EDGE * outline, _EDGE_RATIO * is_down.sum()):
        return None
    feet = np.zeros((nx, ny), dtype=bool)
    feet[i[is_down], j[is_down]] = True
    clear = np.zeros(states.shape, dtype=bool)
    top = support_index + int(np.median(above[is_edge]))
    clear[:, :, support_index:top] = ~ndimage.binary_dilation(feet)[:, :, None]
    return clear


def look_around(states: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return per voxel the shares of the 26 directions in which the first known voxel is SOLID, and FREE."""
    hits = np.zeros(states.shape, np.uint8)
    frees = np.zeros(states.shape, np.uint8)
    first = np.empty(states.shape, np.uint8)
    for direction in np.ndindex(3, 3, 3):
        step = np.array(direction) - 1
        if step.any():
            _add_first_known(states, step, first, hits, frees)
    return (hits / 26).astype(np.float32), (frees / 26).astype(np.float32)


def _without_hair(solid: NDArray[np.bool_], states: NDArray[np.uint8]) -> NDArray[np.bool_]:
    # Completed voxels that a majority filter would not keep; observed voxels stay.
    share = ndimage.uniform_filter(solid.astype(np.float32), 3, mode="constant")
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
    labels, count = ndimage.label(solid)
    if count < 2:
        return solid
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    return np.asarray((sizes >= min_share * sizes.max())[labels] & solid)


@kernel
def _add_first_known(states, step, first, hits, frees):
    # `first` is room for the states; they are UNKNOWN where the block ends first.
    nx, ny, nz = states.shape
    for a in range(nx):
        i = nx - 1 - a if step[0] > 0 else a
        for b in range(ny):
            j = ny - 1 - b if step[1] > 0 else b
            for c in range(nz):
                k = nz - 1 - c if step[2] > 0 else c
                u, v, w = i + step[0], j + step[1], k + step[2]
                if u < 0 or v < 0 or w < 0 or u >= nx or v >= ny or w >= nz:
                    state = np.uint8(UNKNOWN)
                elif states[u, v, w] != UNKNOWN:
                    state = states[u, v, w]
                else:
                    state = first[u, v, w]
                first[i, j, k] = state
                hits[i, j, k] += state == SOLID
                frees[i, j, k] += state == FREE
