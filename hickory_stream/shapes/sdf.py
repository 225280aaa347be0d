"""The signed distance field of a mesh on a grid, exact within a narrow band of the surface and truncated beyond.

The sign comes from winding numbers, the oriented crossings along the six grid directions, averaged: a mesh with holes
still has an inside, and overlapping parts count as one solid. A mesh whose faces point inwards is reversed first.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.portable_kernels import cbrt


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class DistanceGrid:
    """Signed distances; the centre of cell (i, j, k) is `origin` + `step_m` * (i, j, k) in the frame of the mesh."""

    #: (nx, ny, nz) in metres, negative inside, cut off at +-`band_m`
    values: NDArray[np.float32]
    origin: NDArray[np.float64]
    step_m: float
    band_m: float

    def points(self, flat: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the (N, 3) centres of the cells of (N,) flat indices."""
        return self.origin + self.step_m * np.stack(np.unravel_index(flat, self.values.shape), axis=1)


def distance_grid(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], *, cells: int, band_cells: float
) -> DistanceGrid:
    """Return the signed distance over the bounds of a mesh: `cells` along the longest side and a margin of the band.

    Raises:
        ValueError: the mesh has no extent.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    longest = float((high - low).max())
    if not (longest > 0 and np.isfinite(longest)):
        raise ValueError(f"a mesh of size {longest} m has no distance field")
    step = longest / cells
    margin = int(np.ceil(band_cells)) + 1
    counts = np.ceil((high - low) / step).astype(np.int64) + 2 * margin
    # Offset by half a cell, so that the outer faces of a box lie between cells and not on them.
    origin = low + step * (0.5 - margin)
    corners = np.ascontiguousarray((vertices[faces] - origin) / step)
    squared = np.full(tuple(int(n) for n in counts), np.float32(band_cells * band_cells))
    inside = winding_numbers(corners, squared.shape) > 0.5
    lower_to_distances(corners, inside, squared, float(band_cells))
    values = np.sqrt(squared) * np.where(inside, np.float32(-step), np.float32(step))
    return DistanceGrid(values=values, origin=origin, step_m=step, band_m=band_cells * step)


def adapted_cells(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], *, cells: int, min_thickness_cells: float, max_cells: int
) -> int:
    """Return the number of cells along the longest side at which the thinnest part has `min_thickness_cells`.

    From `cells` to `max_cells`, lower if the grid would exceed a cube of 1.5 `cells`. The thickness is the 10th
    percentile, by area, of the depth of the solid inwards from its surface.
    """
    low, size = vertices.min(axis=0), np.ptp(vertices, axis=0)
    step = float(size.max()) / cells
    shape = tuple(int(n) for n in np.ceil(size / step) + 4)
    corners = np.ascontiguousarray((vertices[faces] - (low - 1.5 * step)) / step)
    inside = winding_numbers(corners, shape) > 0.5
    reach, areas, patches = _inward_reach(corners, inside, 400 * 400 // max(len(faces), 1))
    if not areas.sum() > 0:
        return cells
    # Averaged over patches, since on a rough surface single samples appear thin everywhere.
    _, patches = np.unique(patches, return_inverse=True)
    areas_of_patches = np.bincount(patches, areas)
    thickness = np.bincount(patches, areas * reach) / np.maximum(areas_of_patches, 1e-300)
    order = np.argsort(thickness, kind="stable")
    below = np.cumsum(areas_of_patches[order])
    thinnest = thickness[order[int(np.searchsorted(below, 0.1 * below[-1]))]]
    factor = min(min_thickness_cells / max(float(thinnest), 0.5), max_cells / cells)
    room = float(cbrt(1.5 * 1.5 * 1.5 * cells * cells * cells / float(np.prod(shape))))
    return int(np.ceil(cells * max(min(factor, room), 1.0)))


def winding_numbers(corners: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return the mean oriented number of surfaces around each cell; `corners` (F, 3, 3) in cell units.

    A closed mesh gives 1 inside and 0 outside, overlapping parts more; of negative signed volume it is reversed.
    """
    a, b, c = corners.transpose(1, 2, 0)
    # Six times the volume, positive for outward faces.
    terms = np.stack([a[i] * (b[i - 2] * c[i - 1] - b[i - 1] * c[i - 2]) for i in range(3)], axis=1)
    sign = np.sign(np.cumsum(terms)[-1]) if len(corners) else 0.0
    # All other terms are multiples of a half, so that no sum is rounded.
    out = np.zeros(shape, np.float32)
    for axis in range(3):
        turned = (axis, (axis + 1) % 3, (axis + 2) % 3)
        sums = np.zeros([shape[i] for i in turned], np.float32)
        _fill_crossings(corners, *turned, sums)
        out += sums.transpose([(i - axis) % 3 for i in range(3)])
    return np.asarray(sign * out / 3)


@kernel(error_model="numpy")
def _fill_crossings(corners, axis, across, up, sums):
    # From one side: `sums` (of zeros) begin with the axis that is crossed along.
    # A small irrational offset from the lattice, so that no line runs along an edge of a regular mesh.
    dy, dz = 1.2360679e-4, 1.7320508e-4
    for f in range(len(corners)):
        y0, y1, y2 = corners[f, 0, across] - dy, corners[f, 1, across] - dy, corners[f, 2, across] - dy
        z0, z1, z2 = corners[f, 0, up] - dz, corners[f, 1, up] - dz, corners[f, 2, up] - dz
        area = (y1 - y0) * (z2 - z0) - (y2 - y0) * (z1 - z0)
        if area == 0.0:
            continue
        sign = 1.0 if area > 0.0 else -1.0
        first_j, last_j = max(int(np.ceil(min(y0, y1, y2))), 0), int(np.floor(max(y0, y1, y2)))
        first_k, last_k = max(int(np.ceil(min(z0, z1, z2))), 0), int(np.floor(max(z0, z1, z2)))
        for j in range(first_j, min(last_j + 1, sums.shape[1])):
            for k in range(first_k, min(last_k + 1, sums.shape[2])):
                w0 = ((y1 - j) * (z2 - k) - (y2 - j) * (z1 - k)) / area
                w1 = ((y2 - j) * (z0 - k) - (y0 - j) * (z2 - k)) / area
                w2 = 1.0 - w0 - w1
                if w0 < 0.0 or w1 < 0.0 or w2 < 0.0:
                    continue
                last = int(np.floor(w0 * corners[f, 0, axis] + w1 * corners[f, 1, axis] + w2 * corners[f, 2, axis]))
                # An outward face with its normal along the axis lies ahead of the solid, one against it behind.
                sums[0, j, k] += 0.5 * sign if last >= 0 else -0.5 * sign
                if 0 <= last < len(sums) - 1:
                    sums[last + 1, j, k] -= sign
    for i in range(1, len(sums)):
        for j in range(sums.shape[1]):
            for k in range(sums.shape[2]):
                sums[i, j, k] += sums[i - 1, j, k]


def _triangles(corners: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    # The corners, unit normals and areas of the triangles that have a normal.
    a, b, c = corners.transpose(1, 2, 0).copy()
    (ax, ay, az), (bx, by, bz) = b - a, c - a
    normals = np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
    x, y, z = normals
    lengths = np.sqrt(x * x + y * y + z * z)
    has_normal = ~(lengths < 1e-12)
    if not has_normal.all():
        corners, normals, lengths = corners[has_normal], normals[:, has_normal], lengths[has_normal]
    return corners, (normals / lengths).T.copy(), 0.5 * lengths


_MOST_SAMPLES = 60_000


def _inward_reach(
    corners: NDArray[np.float64], inside: NDArray[np.bool_], samples: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    # (depth inwards in cells along the grid axis nearest to the normal, area, patch) of samples of the surface, since
    # the object is aligned with the grid. A patch is a block of cells with one such axis. About `samples` points per
    # face, fewer on small faces; surface within the solid is left out.
    corners, normals, areas = _triangles(corners)
    mains = np.abs(normals).argmax(axis=1)
    sides = np.clip(np.sqrt(np.minimum(float(samples), areas / 4.0)), 1.0, 20.0).astype(np.int64)
    reach, shares, patches = np.empty(_MOST_SAMPLES), np.empty(_MOST_SAMPLES), np.empty(_MOST_SAMPLES, np.int64)
    count = _fill_reach(corners, normals, areas, mains, sides, inside, reach, shares, patches)
    return reach[:count], shares[:count], patches[:count]


@kernel(error_model="numpy")
def _fill_reach(corners, normals, areas, mains, sides, inside, reach, shares, patches):
    count = 0
    for f in range(len(corners)):
        t, main, side = corners[f], mains[f], sides[f]
        is_up = normals[f, main] > 0.0
        for i in range(side):
            for j in range(side - i):
                if count == len(reach):
                    return count
                a, b = (i + 1.0 / 3.0) / side, (j + 1.0 / 3.0) / side
                x = t[0, 0] + a * (t[1, 0] - t[0, 0]) + b * (t[2, 0] - t[0, 0])
                y = t[0, 1] + a * (t[1, 1] - t[0, 1]) + b * (t[2, 1] - t[0, 1])
                z = t[0, 2] + a * (t[1, 2] - t[0, 2]) + b * (t[2, 2] - t[0, 2])
                if is_buried(inside, x, y, z, normals, f):
                    continue
                deepest = 0.0
                for n in range(16):
                    along = 0.5 * (n + 1)
                    down = -along if is_up else along
                    u = int(np.floor(x + (down if main == 0 else 0.0) + 0.5))
                    v = int(np.floor(y + (down if main == 1 else 0.0) + 0.5))
                    w = int(np.floor(z + (down if main == 2 else 0.0) + 0.5))
                    if u < 0 or v < 0 or w < 0 or u >= inside.shape[0] or v >= inside.shape[1] or w >= inside.shape[2]:
                        break
                    if inside[u, v, w]:
                        deepest = along
                    elif deepest > 0.0 or along > 1.5:
                        break
                place = (int(x) // 4 * 1000 + int(y) // 4) * 1000 + int(z) // 4
                patches[count] = place * 6 + main * 2 + is_up
                reach[count], shares[count] = deepest, areas[f] / (side * (side + 1) / 2)
                count += 1
    return count


_ROOM = 512
# The columns: cells, their squared distances so far, and whether the triangle may be nearer.
_X, _Y, _Z, _KNOWN, _IS_NEAR = 0, _ROOM, 2 * _ROOM, 3 * _ROOM, 4 * _ROOM
# The same columns for those to which it may be, moved together; their squared distances and nearest points.
_NEAR_X, _NEAR_Y, _NEAR_Z, _NEAR_KNOWN = 5 * _ROOM, 6 * _ROOM, 7 * _ROOM, 8 * _ROOM
_SQUARED, _ALONG_AB, _ALONG_AC = 9 * _ROOM, 10 * _ROOM, 11 * _ROOM
_COLUMNS = 12


def lower_to_distances(
    corners: NDArray[np.float64], inside: NDArray[np.bool_], squared: NDArray[np.float32], band: float
) -> None:
    """Lower `squared` to the squared distance to the nearest triangle, for cells within `band` of one."""
    # `corners` (F, 3, 3) and `band` in cells; `squared` (nx, ny, nz) in C order is at most band^2. Only the surface of
    # the solid counts, not one part's inside another.
    corners, normals, _ = _triangles(corners)
    a, b, c = corners.transpose(1, 2, 0).copy()
    middles = (a + b + c) / 3.0
    squares = [(x * x + y * y) + z * z for x, y, z in (corner - middles for corner in (a, b, c))]
    radii2 = np.maximum(np.maximum(squares[0], squares[1]), squares[2])
    low = np.ceil(np.minimum(np.minimum(a, b), c) - band).astype(np.int64).T
    high = np.floor(np.maximum(np.maximum(a, b), c) + band).astype(np.int64).T
    bounds = np.concatenate([np.maximum(low, 0), np.minimum(high + 1, squared.shape)], axis=1)
    block, where = np.ones(_COLUMNS * _ROOM), np.empty((2, _ROOM), np.int64)
    _lower_all(corners, normals, middles.T.copy(), radii2, bounds, band, inside, squared, block, where)


@kernel(error_model="numpy")
def _lower_all(corners, normals, middles, radii2, bounds, band, inside, squared, block, where):
    _, size_y, size_z = squared.shape
    cells = squared.reshape(-1)
    for f in range(len(corners)):
        middle_x, middle_y = middles[f, 0], middles[f, 1]
        # Rows that pass the bounding ball by more than the band have no cell within it.
        reach2 = (np.sqrt(radii2[f]) + band) ** 2 * (1.0 + 1e-6)
        count = np.int64(0)
        for i in range(bounds[f, 0], bounds[f, 3]):
            for j in range(bounds[f, 1], bounds[f, 4]):
                if (i - middle_x) ** 2 + (j - middle_y) ** 2 >= reach2:
                    continue
                row = (i * size_y + j) * size_z
                for k in range(bounds[f, 2], bounds[f, 5]):
                    block[_X + count], block[_Y + count], block[_Z + count] = i, j, k
                    block[_KNOWN + count] = cells[row + k]
                    where[0, count] = row + k
                    count += 1
                    if count == _ROOM:
                        _lower(corners, normals, middles, radii2, f, inside, cells, block, where, count)
                        count = np.int64(0)
        _lower(corners, normals, middles, radii2, f, inside, cells, block, where, count)


@kernel(error_model="numpy")
def _lower(corners, normals, middles, radii2, f, inside, cells, block, where, count):
    num_near = _gather_near(block, where, count, normals, middles, radii2[f], f)
    _fill_squared(block, num_near, corners, f)
    t = corners[f]
    for n in range(num_near):
        if block[_SQUARED + n] < block[_NEAR_KNOWN + n]:
            v, w = block[_ALONG_AB + n], block[_ALONG_AC + n]
            x = t[0, 0] + v * (t[1, 0] - t[0, 0]) + w * (t[2, 0] - t[0, 0])
            y = t[0, 1] + v * (t[1, 1] - t[0, 1]) + w * (t[2, 1] - t[0, 1])
            z = t[0, 2] + v * (t[1, 2] - t[0, 2]) + w * (t[2, 2] - t[0, 2])
            if not is_buried(inside, x, y, z, normals, f):
                cells[where[1, n]] = block[_SQUARED + n]


@kernel(error_model="numpy")
def _gather_near(block, where, count, normals, middles, radius2, f):
    # By the triangle's plane and bounding ball, which are lower bounds of the distance.
    n0, n1, n2, m0, m1, m2 = normals[f, 0], normals[f, 1], normals[f, 2], middles[f, 0], middles[f, 1], middles[f, 2]
    for n in range(count):
        x, y, z = block[_X + n] - m0, block[_Y + n] - m1, block[_Z + n] - m2
        known = (1.0 - 1e-5) * block[_KNOWN + n]
        out = n0 * x + n1 * y + n2 * z
        away = x * x + y * y + z * z
        slack = away + radius2 - known
        is_far = (out * out >= known) | ((away > radius2) & (slack > 0.0) & (slack * slack >= 4.0 * radius2 * away))
        block[_IS_NEAR + n] = 0.0 if is_far else 1.0
    num_near = 0
    for n in range(count):
        m = num_near
        block[_NEAR_X + m], block[_NEAR_Y + m], block[_NEAR_Z + m] = block[_X + n], block[_Y + n], block[_Z + n]
        block[_NEAR_KNOWN + m] = block[_KNOWN + n]
        where[1, m] = where[0, n]
        num_near += int(block[_IS_NEAR + n])
    return num_near


@kernel(error_model="numpy")
def _fill_squared(block, count, corners, f):
    # Nearest points a + v ab + w ac: Ericson, Real-Time Collision Detection (2005), 5.1.5.
    a0, a1, a2 = corners[f, 0, 0], corners[f, 0, 1], corners[f, 0, 2]
    abx, aby, abz = corners[f, 1, 0] - a0, corners[f, 1, 1] - a1, corners[f, 1, 2] - a2
    acx, acy, acz = corners[f, 2, 0] - a0, corners[f, 2, 1] - a1, corners[f, 2, 2] - a2
    bb, bc, cc = (
        abx * abx + aby * aby + abz * abz,
        abx * acx + aby * acy + abz * acz,
        acx * acx + acy * acy + acz * acz,
    )
    for n in range(count):
        apx, apy, apz = block[_NEAR_X + n] - a0, block[_NEAR_Y + n] - a1, block[_NEAR_Z + n] - a2
        d1 = abx * apx + aby * apy + abz * apz
        d2 = acx * apx + acy * apy + acz * apz
        d3, d4 = d1 - bb, d2 - bc
        d5, d6 = d1 - bc, d2 - cc
        vc, vb, va = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
        at_a = (d1 <= 0.0) & (d2 <= 0.0)
        at_b = (d3 >= 0.0) & (d4 <= d3)
        at_c = (d6 >= 0.0) & (d5 <= d6)
        on_ab = (vc <= 0.0) & (d1 >= 0.0) & (d3 <= 0.0)
        on_ac = (vb <= 0.0) & (d2 >= 0.0) & (d6 <= 0.0)
        on_bc = (va <= 0.0) & (d4 - d3 >= 0.0) & (d5 - d6 >= 0.0)
        part = d1 if on_ab else (d2 if on_ac else (d4 - d3 if on_bc else 1.0))
        whole = d1 - d3 if on_ab else (d2 - d6 if on_ac else ((d4 - d3) + (d5 - d6) if on_bc else va + vb + vc))
        share = part / max(whole, 1e-30)
        v = share if on_ab else (0.0 if on_ac else (1.0 - share if on_bc else vb * share))
        w = 0.0 if on_ab else (share if (on_ac | on_bc) else vc * share)
        v = 0.0 if at_a else (1.0 if at_b else (0.0 if at_c else v))
        w = 0.0 if (at_a | at_b) else (1.0 if at_c else w)
        ex = apx - v * abx - w * acx
        ey = apy - v * aby - w * acy
        ez = apz - v * abz - w * acz
        block[_SQUARED + n] = ex * ex + ey * ey + ez * ez
        block[_ALONG_AB + n] = v
        block[_ALONG_AC + n] = w


@kernel
def is_buried(inside, x, y, z, normals, f):
    """Return whether the solid continues on both sides of a point of a triangle, at most of a cell's distance."""
    for n in range(2):
        side = 1.5 * n - 0.75
        i = int(np.floor(x + side * normals[f, 0] + 0.5))
        j = int(np.floor(y + side * normals[f, 1] + 0.5))
        k = int(np.floor(z + side * normals[f, 2] + 0.5))
        if i < 0 or j < 0 or k < 0 or i >= inside.shape[0] or j >= inside.shape[1] or k >= inside.shape[2]:
            return False
        if not inside[i, j, k]:
            return False
    return True
