"""The signed distance field of a mesh on a grid.

The distance is exact within a narrow band of the surface and truncated beyond it. The sign comes from winding numbers:
the oriented crossings along the six grid directions, averaged, so that a mesh with holes still has an inside, and
overlapping parts count as one solid. A mesh whose faces point inwards is reversed first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.compiled import numba
from hickory_stream.geometry.portable_kernels import cbrt

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class DistanceGrid:
    """Signed distances `values` (nx, ny, nz) float32 in metres, negative inside, cut off at +-`band_m`.

    The centre of cell (i, j, k) is `origin` + `step_m` * (i, j, k) in the frame of the mesh.
    """

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
    _band(corners, inside, squared, band_cells)
    values = np.sqrt(squared) * np.where(inside, np.float32(-step), np.float32(step))
    return DistanceGrid(values=values, origin=origin, step_m=step, band_m=band_cells * step)


def adapted_cells(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], *, cells: int, min_thickness_cells: float, max_cells: int
) -> int:
    """Return the number of cells along the longest side at which the thinnest part has `min_thickness_cells`.

    It is at least `cells`, at most `max_cells`, and lower if the whole grid would exceed a cube of 1.5 `cells`. The
    thickness of the thinnest part is the 10th percentile, by area, of the depth of the solid inwards from its surface.
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

    A closed mesh with outward faces gives 1 inside and 0 outside; overlapping parts give more. A mesh with negative
    signed volume is reversed.
    """
    winding = np.zeros(shape, np.float32)
    for axis in range(3):
        turned = np.ascontiguousarray(np.roll(corners, -axis, axis=2))
        lines = np.zeros(tuple(np.roll(shape, -axis)), np.float32)
        _crossings(turned, lines)
        winding += np.transpose(lines, np.roll(np.arange(3), axis))
    return np.asarray(np.sign(_signed_volume(corners)) * winding / 3)


@numba.njit(cache=True, nogil=True)
def _signed_volume(corners):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return six times the signed volume of (F, 3, 3) triangles, positive for outward faces."""
    total = 0.0
    for f in range(len(corners)):
        a, b, c = corners[f, 0], corners[f, 1], corners[f, 2]
        total += a[0] * (b[1] * c[2] - b[2] * c[1])
        total += a[1] * (b[2] * c[0] - b[0] * c[2])
        total += a[2] * (b[0] * c[1] - b[1] * c[0])
    return total


@numba.njit(cache=True, nogil=True)
def _crossings(corners, out):  # type: ignore[no-untyped-def] # pragma: no cover
    """Add to each cell the mean of the oriented crossings ahead and behind along the first axis."""
    nx, ny, nz = out.shape
    # A small irrational offset from the lattice, so that no line runs along an edge of a regular mesh.
    dy, dz = 1.2360679e-4, 1.7320508e-4
    ahead = np.zeros(out.shape, np.float32)
    behind = np.zeros(out.shape, np.float32)
    for f in range(corners.shape[0]):
        y0, y1, y2 = corners[f, 0, 1] - dy, corners[f, 1, 1] - dy, corners[f, 2, 1] - dy
        z0, z1, z2 = corners[f, 0, 2] - dz, corners[f, 1, 2] - dz, corners[f, 2, 2] - dz
        area = (y1 - y0) * (z2 - z0) - (y2 - y0) * (z1 - z0)
        if area == 0.0:
            continue
        sign = 1.0 if area > 0.0 else -1.0
        for j in range(max(int(np.ceil(min(y0, y1, y2))), 0), min(int(np.floor(max(y0, y1, y2))), ny - 1) + 1):
            for k in range(max(int(np.ceil(min(z0, z1, z2))), 0), min(int(np.floor(max(z0, z1, z2))), nz - 1) + 1):
                w0 = ((y1 - j) * (z2 - k) - (y2 - j) * (z1 - k)) / area
                w1 = ((y2 - j) * (z0 - k) - (y0 - j) * (z2 - k)) / area
                w2 = 1.0 - w0 - w1
                if w0 < 0.0 or w1 < 0.0 or w2 < 0.0:
                    continue
                x = w0 * corners[f, 0, 0] + w1 * corners[f, 1, 0] + w2 * corners[f, 2, 0]
                last = int(np.floor(x))
                # An outward face with its normal along +x lies ahead of the solid, one along -x behind it.
                if last >= 0:
                    ahead[min(last, nx - 1), j, k] += sign
                if last + 1 < nx:
                    behind[max(last + 1, 0), j, k] -= sign
    for j in range(ny):
        for k in range(nz):
            total = np.float32(0.0)
            for i in range(nx - 1, -1, -1):
                total += ahead[i, j, k]
                out[i, j, k] += 0.5 * total
            total = np.float32(0.0)
            for i in range(nx):
                total += behind[i, j, k]
                out[i, j, k] += 0.5 * total


@numba.njit(cache=True, nogil=True)
def _inward_reach(corners, inside, samples):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return for samples of the surface the depth of the solid inwards, in cells, the sample's area and its patch.

    The depth is measured along the grid axis nearest to the normal, since the object is aligned with the grid. A patch
    is a block of cells with one such direction.
    About `samples` points per face on a regular pattern, fewer on small faces; surface within the solid is left out.
    """
    most = 60_000
    thickness, areas, patches = np.empty(most), np.empty(most), np.empty(most, np.int64)
    count = 0
    down = np.empty(3)
    normal, point = np.empty(3), np.empty(3)
    for f in range(corners.shape[0]):
        t = corners[f]
        if not _normal(t, normal):
            continue
        ux, uy, uz = t[1, 0] - t[0, 0], t[1, 1] - t[0, 1], t[1, 2] - t[0, 2]
        vx, vy, vz = t[2, 0] - t[0, 0], t[2, 1] - t[0, 1], t[2, 2] - t[0, 2]
        area = 0.5 * np.sqrt((uy * vz - uz * vy) ** 2 + (uz * vx - ux * vz) ** 2 + (ux * vy - uy * vx) ** 2)
        main = int(np.argmax(np.abs(normal)))
        down[:] = 0.0
        down[main] = -1.0 if normal[main] > 0.0 else 1.0
        side = int(min(max(np.sqrt(min(float(samples), area / 4.0)), 1.0), 20.0))
        for i in range(side):
            for j in range(side - i):
                if count == most:
                    return thickness[:count], areas[:count], patches[:count]
                a, b = (i + 1.0 / 3.0) / side, (j + 1.0 / 3.0) / side
                for axis in range(3):
                    point[axis] = t[0, axis] + a * (t[1, axis] - t[0, axis]) + b * (t[2, axis] - t[0, axis])
                if _is_buried(inside, point, normal):
                    continue
                reach, first = 0.0, False
                for n in range(16):
                    along = 0.5 * (n + 1)
                    x = int(np.floor(point[0] + along * down[0] + 0.5))
                    y = int(np.floor(point[1] + along * down[1] + 0.5))
                    z = int(np.floor(point[2] + along * down[2] + 0.5))
                    if x < 0 or y < 0 or z < 0 or x >= inside.shape[0] or y >= inside.shape[1] or z >= inside.shape[2]:
                        break
                    if inside[x, y, z]:
                        reach, first = along, True
                    elif first or along > 1.5:
                        break
                block = (int(point[0]) // 4 * 1000 + int(point[1]) // 4) * 1000 + int(point[2]) // 4
                patches[count] = block * 6 + main * 2 + (normal[main] > 0.0)
                thickness[count], areas[count] = reach, area / (side * (side + 1) / 2)
                count += 1
    return thickness[:count], areas[:count], patches[:count]


@numba.njit(cache=True, nogil=True)
def _band(corners, inside, squared, band):  # type: ignore[no-untyped-def] # pragma: no cover
    """Lower `squared` to the squared distance to the nearest triangle, for cells within `band` of one.

    Only the surface of the solid counts; surface of one part inside another is skipped.
    """
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    nearest, normal, middle = np.empty(3), np.empty(3), np.empty(3)
    is_near = np.empty(squared.shape[2], np.bool_)
    for f in range(corners.shape[0]):
        t = corners[f]
        if not _normal(t, normal):
            continue
        first = (t[0, 0], t[0, 1], t[0, 2])
        ab = (t[1, 0] - t[0, 0], t[1, 1] - t[0, 1], t[1, 2] - t[0, 2])
        ac = (t[2, 0] - t[0, 0], t[2, 1] - t[0, 1], t[2, 2] - t[0, 2])
        products = (
            ab[0] * ab[0] + ab[1] * ab[1] + ab[2] * ab[2],
            ab[0] * ac[0] + ab[1] * ac[1] + ab[2] * ac[2],
            ac[0] * ac[0] + ac[1] * ac[1] + ac[2] * ac[2],
        )
        radius2 = 0.0
        for axis in range(3):
            middle[axis] = (t[0, axis] + t[1, axis] + t[2, axis]) / 3.0
        for corner in range(3):
            x, y, z = t[corner, 0] - middle[0], t[corner, 1] - middle[1], t[corner, 2] - middle[2]
            radius2 = max(radius2, x * x + y * y + z * z)
        for axis in range(3):
            size = squared.shape[axis]
            low[axis] = max(int(np.ceil(min(t[0, axis], t[1, axis], t[2, axis]) - band)), 0)
            high[axis] = min(int(np.floor(max(t[0, axis], t[1, axis], t[2, axis]) + band)), size - 1)
        n0, n1, n2, m2 = normal[0], normal[1], normal[2], middle[2]
        first_k, count = low[2], high[2] + 1 - low[2]
        for i in range(low[0], high[0] + 1):
            x = i - middle[0]
            for j in range(low[1], high[1] + 1):
                y = j - middle[1]
                # The distances to the triangle's plane and bounding ball are lower bounds, by which most cells are
                # skipped: a row of them at a time, without branches.
                row = squared[i, j, first_k : first_k + count]
                num_near = 0
                for n in range(count):
                    z = first_k + n - m2
                    known = (1.0 - 1e-5) * row[n]
                    out = n0 * x + n1 * y + n2 * z
                    away = x * x + y * y + z * z
                    slack = away + radius2 - known
                    is_far = (out * out >= known) | (
                        (away > radius2) & (slack > 0.0) & (slack * slack >= 4.0 * radius2 * away)
                    )
                    is_near[n] = not is_far
                    num_near += not is_far
                if num_near == 0:
                    continue
                for n in range(count):
                    if not is_near[n]:
                        continue
                    k = first_k + n
                    d, v, w = _squared_distance(float(i), float(j), float(k), first, ab, ac, products)
                    if d < row[n]:
                        for axis in range(3):
                            nearest[axis] = first[axis] + v * ab[axis] + w * ac[axis]
                        if not _is_buried(inside, nearest, normal):
                            row[n] = d


@numba.njit(cache=True, nogil=True)
def _normal(t, normal):  # type: ignore[no-untyped-def] # pragma: no cover
    """Fill the unit normal of a triangle; return whether it has one."""
    ax, ay, az = t[1, 0] - t[0, 0], t[1, 1] - t[0, 1], t[1, 2] - t[0, 2]
    bx, by, bz = t[2, 0] - t[0, 0], t[2, 1] - t[0, 1], t[2, 2] - t[0, 2]
    normal[0], normal[1], normal[2] = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    length = np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    if length < 1e-12:
        return False
    normal /= length
    return True


@numba.njit(cache=True, nogil=True)
def _is_buried(inside, point, normal):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return whether the solid continues on both sides of a point of a triangle, at most of a cell's distance."""
    for side in (-0.75, 0.75):
        i = int(np.floor(point[0] + side * normal[0] + 0.5))
        j = int(np.floor(point[1] + side * normal[1] + 0.5))
        k = int(np.floor(point[2] + side * normal[2] + 0.5))
        if i < 0 or j < 0 or k < 0 or i >= inside.shape[0] or j >= inside.shape[1] or k >= inside.shape[2]:
            return False
        if not inside[i, j, k]:
            return False
    return True


@numba.njit(cache=True, nogil=True)
def _squared_distance(x, y, z, first, ab, ac, products):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return the squared distance from a point to a triangle, and the coordinates v, w of the triangle's nearest point.

    That point is first + v ab + w ac; `products` are ab.ab, ab.ac and ac.ac. From Ericson, Real-Time Collision
    Detection (2005), 5.1.5.
    """
    abx, aby, abz = ab
    acx, acy, acz = ac
    bb, bc, cc = products
    apx, apy, apz = x - first[0], y - first[1], z - first[2]
    d1 = abx * apx + aby * apy + abz * apz
    d2 = acx * apx + acy * apy + acz * apz
    d3, d4 = d1 - bb, d2 - bc
    d5, d6 = d1 - bc, d2 - cc
    if d1 <= 0.0 and d2 <= 0.0:
        v, w = 0.0, 0.0
    elif d3 >= 0.0 and d4 <= d3:
        v, w = 1.0, 0.0
    elif d6 >= 0.0 and d5 <= d6:
        v, w = 0.0, 1.0
    else:
        vc = d1 * d4 - d3 * d2
        vb = d5 * d2 - d1 * d6
        va = d3 * d6 - d5 * d4
        if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
            v, w = d1 / max(d1 - d3, 1e-30), 0.0
        elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
            v, w = 0.0, d2 / max(d2 - d6, 1e-30)
        elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
            w = (d4 - d3) / max((d4 - d3) + (d5 - d6), 1e-30)
            v = 1.0 - w
        else:
            scale = 1.0 / max(va + vb + vc, 1e-30)
            v, w = vb * scale, vc * scale
    ex = apx - v * abx - w * acx
    ey = apy - v * aby - w * acy
    ez = apz - v * abz - w * acz
    return ex * ex + ey * ey + ez * ez, v, w
