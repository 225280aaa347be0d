"""The signed distance field of a mesh on a grid.

The distance is exact within a narrow band of the surface and truncated beyond it. The sign comes from winding numbers:
the oriented crossings along the six grid directions, averaged, so that a mesh with holes still has an inside, and
overlapping parts count as one solid. A mesh whose faces point inwards is reversed first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.portable_kernels import cbrt
from hickory_stream.shapes.narrow_band import is_buried, lower_to_distances, unit_normal

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
    lower_to_distances(corners, inside, squared, float(band_cells))
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
    return np.asarray(np.sign(_signed_volume(corners)) * _windings(corners, np.array(shape)) / 3)


@kernel
def _signed_volume(corners):
    """Return six times the signed volume of (F, 3, 3) triangles, positive for outward faces."""
    total = 0.0
    for f in range(len(corners)):
        a, b, c = corners[f, 0], corners[f, 1], corners[f, 2]
        total += a[0] * (b[1] * c[2] - b[2] * c[1])
        total += a[1] * (b[2] * c[0] - b[0] * c[2])
        total += a[2] * (b[0] * c[1] - b[1] * c[0])
    return total


@kernel
def _windings(corners, shape):
    """Return (nx, ny, nz) the sums over three axes of the mean of the oriented crossings ahead and behind a cell.

    All are multiples of a half, so that no sum is rounded.
    """
    out = np.zeros((shape[0], shape[1], shape[2]), np.float32)
    for axis in range(3):
        # Cells in the order of the array: those before the axis, along it, after it.
        num_after = 1
        for after in range(axis + 1, 3):
            num_after *= shape[after]
        first, steps = _crossings(corners, shape, axis, num_after)
        _add_running_sums(first, steps, shape[axis], num_after, out.reshape(-1))
    return out


@kernel
def _crossings(corners, shape, axis, num_after):
    """Return the means of the crossings for the first cell of each line along an axis, and the changes at each cell."""
    across, up = (axis + 1) % 3, (axis + 2) % 3
    size = shape[axis]
    first = np.zeros(shape[across] * shape[up], np.float32)
    steps = np.zeros(len(first) * size, np.float32)
    # A small irrational offset from the lattice, so that no line runs along an edge of a regular mesh.
    dy, dz = 1.2360679e-4, 1.7320508e-4
    cell = np.zeros(3, np.int64)
    for f in range(corners.shape[0]):
        y0, y1, y2 = corners[f, 0, across] - dy, corners[f, 1, across] - dy, corners[f, 2, across] - dy
        z0, z1, z2 = corners[f, 0, up] - dz, corners[f, 1, up] - dz, corners[f, 2, up] - dz
        area = (y1 - y0) * (z2 - z0) - (y2 - y0) * (z1 - z0)
        if area == 0.0:
            continue
        sign = 1.0 if area > 0.0 else -1.0
        for j in range(
            max(int(np.ceil(min(y0, y1, y2))), 0), min(int(np.floor(max(y0, y1, y2))), shape[across] - 1) + 1
        ):
            for k in range(
                max(int(np.ceil(min(z0, z1, z2))), 0), min(int(np.floor(max(z0, z1, z2))), shape[up] - 1) + 1
            ):
                w0 = ((y1 - j) * (z2 - k) - (y2 - j) * (z1 - k)) / area
                w1 = ((y2 - j) * (z0 - k) - (y0 - j) * (z2 - k)) / area
                w2 = 1.0 - w0 - w1
                if w0 < 0.0 or w1 < 0.0 or w2 < 0.0:
                    continue
                x = w0 * corners[f, 0, axis] + w1 * corners[f, 1, axis] + w2 * corners[f, 2, axis]
                last = int(np.floor(x))
                cell[axis], cell[across], cell[up] = 0, j, k
                place = (cell[0] * shape[1] + cell[1]) * shape[2] + cell[2]
                line = place // (size * num_after) * num_after + place % num_after
                # An outward face with its normal along the axis lies ahead of the solid, one against it behind.
                first[line] += 0.5 * sign if last >= 0 else -0.5 * sign
                if 0 <= last < size - 1:
                    steps[place + (last + 1) * num_after] -= sign
    return first, steps


@kernel
def _add_running_sums(first, steps, size, num_after, out):
    """Add to each cell what its line begins with and the changes up to the cell."""
    for before in range(len(first) // num_after):
        level = first[before * num_after : (before + 1) * num_after]
        for i in range(size):
            start = (before * size + i) * num_after
            for n in range(num_after):
                level[n] += steps[start + n]
                out[start + n] += level[n]


@kernel
def _inward_reach(corners, inside, samples):
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
        if not unit_normal(t, normal):
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
                if is_buried(inside, point, normal):
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
