"""The share of each cell of a grid that a superquadric fills: linear in the distance, within half a cell.

Most cells are in or out by bounds without logarithms; the others have the distances of `tangent_planes`, but exact to
the last bits, for a block of cells at a time without branches, so that the compiler vectorises.
"""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.portable_kernels import exp, log, log1p, power

BLOCK = 64
# The columns of a block: points, and their distances.
X, Y, Z, DISTANCE = 0, BLOCK, 2 * BLOCK, 3 * BLOCK
_COLUMNS = 4
# Beyond half a cell a bound of the distance is as good.
_HALF = 0.5


def new_block() -> NDArray[np.float64]:
    """Return a block; points go to its columns X, Y, Z."""
    return np.ones(_COLUMNS * BLOCK)


def occupancies(row: NDArray[np.float64], low: NDArray[np.int64], high: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return the shares that a primitive (`quadric_lm.ROW`) fills of the cells from `low` up to `high`."""
    out = np.empty(high - low, np.float32)
    _fill_shares(row, body_of(row), low, out.shape, np.empty(out.size), new_block(), out.reshape(-1))
    return out


def body_of(row: NDArray[np.float64]) -> tuple[float, ...]:
    """Return what `distance_bound` needs of a primitive, as numbers: an array is counted whenever it is passed on."""
    e1, e2, log_a, log_b, log_c, *place = row.tolist()
    # The box of this share of the semi-axes touches the primitive with its corners.
    inscribed = exp(-0.5 * e1 * log1p(power(2.0, e2 / e1)))
    return (*place, exp(log_a), exp(log_b), exp(log_c), inscribed, 1.0 if e1 <= 1.0 and e2 <= 1.0 else 0.0)


@kernel
def _fill_shares(row, body, low, shape, distances, block, out):
    where, count = np.empty(BLOCK, np.int64), np.int64(0)
    size_z = shape[2]
    for line in range(shape[0] * shape[1]):
        i = line // shape[1]
        first = line * size_z
        x, y = np.float64(low[0] + i), np.float64(low[1] + line - i * shape[1])
        for k in range(size_z):
            distances[first + k] = distance_bound(body, x, y, np.float64(low[2] + k))
        for k in range(size_z):
            if abs(distances[first + k]) <= _HALF:
                block[X + count], block[Y + count], block[Z + count] = x, y, low[2] + k
                where[count] = first + k
                count += 1
            if count == BLOCK or (first + k == len(distances) - 1 and count > 0):
                fill_exact_distances(block, count, row, _HALF)
                for m in range(count):
                    # Inside, the distance to a tangent plane is no lower bound.
                    distances[where[m]] = max(block[DISTANCE + m], -_HALF)
                count = np.int64(0)
    for first in range(0, len(distances), size_z):
        n, last = first, first + size_z
        while n < last:
            # Between adjacent cells the distance changes by at most 1: what follows a far one is as it is.
            end = min(n + 1 + int(max(abs(distances[n]) - _HALF, 0.0)), last)
            share = occupancy(distances[n])
            while n < end:
                out[n] = share
                n += 1


@kernel
def occupancy(d):
    """Return the share of a cell within a primitive, linear near its surface."""
    return min(max(0.5 - d, 0.0), 1.0)


@kernel(error_model="numpy")
def distance_bound(body, x, y, z):
    """Return a bound of a cell's distance to a `body_of` a primitive, without logarithms."""
    # Beyond half a cell, in or out; 0 if there is no bound.
    cx, cy, cz, r0, r1, r2, r3, r4, r5, r6, r7, r8, ax, ay, az, within, is_round = body
    dx, dy, dz = x - cx, y - cy, z - cz
    u, v, w = abs(r0 * dx + r3 * dy + r6 * dz), abs(r1 * dx + r4 * dy + r7 * dz), abs(r2 * dx + r5 * dy + r8 * dz)
    # Outside the box is outside; deep in the inscribed box or octahedron (exponents up to 1, ellipsoid) is inside. A
    # gauge changes by at most 1 / inradius per cell.
    outside = max(u - ax, v - ay, w - az)
    boxed = min(within * ax - u, within * ay - v, within * az - w)
    u, v, w = u / ax, v / ay, w / az
    smallest = min(ax, ay, az)
    if is_round > 0.0:
        inside = max(boxed, (1.0 - np.sqrt(u * u + v * v + w * w)) * smallest)
    else:
        inside = max(boxed, (1.0 - u - v - w) * smallest / 1.7320508)
    return outside if outside > 0.5 else (-inside if inside > 0.5 else 0.0)


@kernel(error_model="numpy")
def fill_exact_distances(block, count, row, depth):
    """Fill the distances of the first points of a block, good to the last bits; beyond `depth` some deeper value."""
    # As in `tangent_planes`. The body holds the ellipsoid, or else the octahedron, of its semi-axes; 1 - h is the share
    # of the way out.
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = row[8], row[9], row[10], row[11], row[12], row[13], row[14], row[15], row[16]
    log_a, log_b, log_c, cx, cy, cz = row[2], row[3], row[4], row[5], row[6], row[7]
    e1, e2 = row[0], row[1]
    smallest = exp(min(log_a, log_b, log_c)) * (1.0 if e1 <= 1.0 and e2 <= 1.0 else 0.57735)
    for n in range(count):
        dx, dy, dz = block[X + n] - cx, block[Y + n] - cy, block[Z + n] - cz
        px, py, pz = r0 * dx + r3 * dy + r6 * dz, r1 * dx + r4 * dy + r7 * dz, r2 * dx + r5 * dy + r8 * dz
        px = px if abs(px) > 1e-6 else 1e-6
        py = py if abs(py) > 1e-6 else 1e-6
        pz = pz if abs(pz) > 1e-6 else 1e-6
        log_x, log_y, log_z = log(abs(px)) - log_a, log(abs(py)) - log_b, log(abs(pz)) - log_c
        gap = 2.0 / e2 * (log_y - log_x)
        small = exp(-abs(gap))
        log_rho = max(log_x, log_y) + 0.5 * e2 * log(1.0 + small)
        large = 1.0 / (1.0 + small)
        share_x = small * large if gap > 0.0 else large
        share_y = large if gap > 0.0 else small * large
        gap = 2.0 / e1 * (log_z - log_rho)
        small = exp(-abs(gap))
        log_h = max(log_rho, log_z) + 0.5 * e1 * log(1.0 + small)
        large = 1.0 / (1.0 + small)
        share_r = small * large if gap > 0.0 else large
        share_z = large if gap > 0.0 else small * large
        gx, gy, gz = share_r * share_x / px, share_r * share_y / py, share_z / pz
        slope = np.sqrt(gx * gx + gy * gy + gz * gz)
        outside = (1.0 - exp(-log_h)) / slope
        h = max(exp(log_h), 1e-200)
        best = (1.0 / h - 1.0) / slope
        # The surface along the axes from a point inside.
        whole = exp(2.0 / e1 * log_h)
        in_plane, along_z = share_r * whole, share_z * whole
        rest_z, rest_r = max(1.0 - in_plane, 1e-300), max(1.0 - along_z, 1e-300)
        log_most = 0.5 * e1 * log(rest_r)
        own = exp(min(2.0 / e2 * (log_rho - log_most), 0.0))
        rest_x, rest_y = max(1.0 - share_y * own, 1e-300), max(1.0 - share_x * own, 1e-300)
        reach_z = exp(log_c + 0.5 * e1 * log(rest_z)) - abs(pz)
        reach_x = exp(log_a + log_most + 0.5 * e2 * log(rest_x)) - abs(px)
        reach_y = exp(log_b + log_most + 0.5 * e2 * log(rest_y)) - abs(py)
        is_x = reach_x < reach_z
        reach = reach_x if is_x else reach_z
        is_y = reach_y < reach
        reach = max(reach_y if is_y else reach, 0.0)
        is_x = is_x & (not is_y)
        is_z = not (is_x | is_y)
        foot_x = share_x if is_z else (rest_x if is_x else 1.0 - rest_y)
        foot_y = share_y if is_z else (1.0 - rest_x if is_x else rest_y)
        foot_r = in_plane if is_z else rest_r
        foot_z = rest_z if is_z else along_z
        gx = foot_r * foot_x / (px + (np.copysign(reach, px) if is_x else 0.0))
        gy = foot_r * foot_y / (py + (np.copysign(reach, py) if is_y else 0.0))
        gz = foot_z / (pz + (np.copysign(reach, pz) if is_z else 0.0))
        along = abs(gx) if is_x else (abs(gy) if is_y else abs(gz))
        planar = reach * along / np.sqrt(gx * gx + gy * gy + gz * gz)
        best = planar if (reach < best * 4.0) & (planar < best) else best
        deep = (1.0 - h) * smallest
        inside = -deep if deep > depth else -best
        block[DISTANCE + n] = outside if log_h >= 0.0 else inside
