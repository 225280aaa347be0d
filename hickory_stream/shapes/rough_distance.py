"""Distances from the cells of a block to the boundary of a solid, exact up to a reach.

The square of a distance is a sum of three squares of whole numbers: the least one is found axis by axis, of the cells
within the reach alone. SciPy's transform looks at all of them, and at the nearest cell itself, which nobody asks for.
"""

from __future__ import annotations

import numpy as np

from hickory_stream.compiled import numba


@numba.njit(cache=True, nogil=True)
def rough_distance(solid, reach):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return the signed distances to the faces between solid and other cells, in cells, negative inside, float32.

    They are those between the middles of cells, less half a cell; what is farther away than `reach` cells, that far.
    """
    outside, inside = _squared_distance(solid, True, reach), _squared_distance(solid, False, reach)
    out = np.empty(solid.shape, np.float32)
    flat, is_solid = out.reshape(-1), solid.reshape(-1)
    to_solid, to_other = outside.reshape(-1), inside.reshape(-1)
    for n in range(len(flat)):
        flat[n] = 0.5 - np.sqrt(np.float64(to_other[n])) if is_solid[n] else np.sqrt(np.float64(to_solid[n])) - 0.5
    return out


@numba.njit(cache=True, nogil=True)
def _squared_distance(solid, to_solid, reach):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return the squared distance of each cell to the nearest that is solid, or the nearest that is not, int32."""
    nx, ny, nz = solid.shape
    most = np.int32(reach * reach)
    along_z = np.empty((nx, ny, nz), np.int32)
    for i in range(nx):
        for j in range(ny):
            since = reach
            for k in range(nz):
                since = 0 if solid[i, j, k] == to_solid else min(since + 1, reach)
                along_z[i, j, k] = since
            since = reach
            for k in range(nz - 1, -1, -1):
                since = 0 if solid[i, j, k] == to_solid else min(since + 1, reach)
                least = min(along_z[i, j, k], since)
                along_z[i, j, k] = least * least
    along_y = np.full((nx, ny, nz), most, np.int32)
    for i in range(nx):
        for j in range(ny):
            for other in range(max(j - reach, 0), min(j + reach + 1, ny)):
                _lower(along_y[i, j], along_z[i, other], np.int32((j - other) ** 2))
    # What it was made of is not needed any more.
    along_z[:] = most
    for i in range(nx):
        for other in range(max(i - reach, 0), min(i + reach + 1, nx)):
            _lower(along_z[i].reshape(-1), along_y[other].reshape(-1), np.int32((i - other) ** 2))
    return along_z


@numba.njit(cache=True, nogil=True)
def _lower(values, others, more):  # type: ignore[no-untyped-def] # pragma: no cover
    for n in range(len(values)):
        values[n] = min(values[n], np.int32(others[n] + more))
