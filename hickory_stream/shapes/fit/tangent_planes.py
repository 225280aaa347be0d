"""Signed distances to tangent planes of a superquadric, a block of points at a time.

A convex body lies behind its tangent planes: the distance to one bounds the true distance from below outside, from
above inside. Outside, the plane touches on the ray from the centre; inside it is the nearest of that plane and of those
met along the three axes, since the first alone would place the rim of a plate nearer than its faces.

The order is one that the compiler vectorises: all points, then those inside, moved together. A block is one array with
columns of `BLOCK` numbers, so that no two columns overlap. Its logarithm and exponential have a relative error below
1e-12, no branches, and the same bits on every machine with IEEE doubles.
"""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.portable_kernels import exp

_LOG_2 = 0.6931471805599453
# ln 2 in two parts; the first has trailing zeros, so that its product with n is exact.
_LOG_2_HIGH, _LOG_2_LOW = 0.6931471803691238, 1.9082149292705877e-10
_ROOT_HALF_BITS = 0x3FE6A09E667F3BCD


@kernel(error_model="numpy")
def quick_log(x):
    """Return ln x of a normal positive number, by the artanh series of the mantissa in 1/sqrt 2 .. sqrt 2."""
    bits = np.float64(x).view(np.int64)
    exponent = np.int64(bits - np.int64(_ROOT_HALF_BITS)) >> np.int64(52)
    mantissa = np.int64(bits - (exponent << np.int64(52))).view(np.float64)
    s = (mantissa - 1.0) / (mantissa + 1.0)
    z = s * s
    p = 1.0 / 13 + z * (1.0 / 15)
    p = 1.0 / 9 + z * (1.0 / 11 + z * p)
    p = 1.0 / 5 + z * (1.0 / 7 + z * p)
    p = 1.0 + z * (1.0 / 3 + z * p)
    return np.float64(exponent) * _LOG_2 + 2.0 * s * p


@kernel(error_model="numpy")
def quick_exp(x):
    """Return e^x, with x clipped to +-700, by the Taylor series about the nearest multiple of ln 2."""
    x = min(max(x, -700.0), 700.0)
    n = np.floor(x * (1.0 / _LOG_2) + 0.5)
    r = x - n * _LOG_2_HIGH - n * _LOG_2_LOW
    p = 1.0 / 362880 + r * (1.0 / 3628800)
    p = 1.0 / 5040 + r * (1.0 / 40320 + r * p)
    p = 1.0 / 120 + r * (1.0 / 720 + r * p)
    p = 1.0 / 6 + r * (1.0 / 24 + r * p)
    p = 1.0 + r * (1.0 + r * (0.5 + r * p))
    return p * np.int64((np.int64(n) + np.int64(1023)) << np.int64(52)).view(np.float64)


BLOCK = 64
# The columns: points, replaced by their local coordinates; distances; the gradient of ln h; the shares.
X, Y, Z = 0, BLOCK, 2 * BLOCK
DISTANCE = 3 * BLOCK
GX, GY, GZ = 4 * BLOCK, 5 * BLOCK, 6 * BLOCK
SX, SY, SR, SZ = 7 * BLOCK, 8 * BLOCK, 9 * BLOCK, 10 * BLOCK
_RHO, _LOG_H = 11 * BLOCK, 12 * BLOCK
# The same columns for the points inside, moved together.
_IN_X, _IN_Y, _IN_Z, _IN_BEST = 13 * BLOCK, 14 * BLOCK, 15 * BLOCK, 16 * BLOCK
_IN_SX, _IN_SY, _IN_SR, _IN_SZ = 17 * BLOCK, 18 * BLOCK, 19 * BLOCK, 20 * BLOCK
_IN_RHO, _IN_LOG_H = 21 * BLOCK, 22 * BLOCK
# The derivatives of a distance by the eleven parameters of a step (`quadric_lm`).
JACOBIAN = 23 * BLOCK
_COLUMNS = 34


def new_block() -> NDArray[np.float64]:
    """Return a block; points go to its columns X, Y, Z."""
    return np.ones(_COLUMNS * BLOCK)


@kernel(error_model="numpy")
def fill_distances(block, count, row, depth):
    """Fill distances, local points, gradients and shares of the first `count` points of a block."""
    # For points deeper than `depth` only the distance, of any value deeper than `depth`.
    _from_centre(block, row)
    smallest = exp(min(row[2], row[3], row[4])) * (1.0 if row[0] <= 1.0 and row[1] <= 1.0 else 0.57735)
    which = np.empty(BLOCK, np.int64)
    num_inside = np.int64(0)
    for n in range(count):
        if block[_LOG_H + n] >= 0.0:
            continue
        # The body contains the ellipsoid, or else the octahedron, of its semi-axes; 1 - h is the share of the way out.
        bound = (1.0 - exp(block[_LOG_H + n])) * smallest
        if bound > depth:
            block[DISTANCE + n] = -bound
            continue
        m = num_inside
        block[_IN_X + m], block[_IN_Y + m], block[_IN_Z + m] = block[X + n], block[Y + n], block[Z + n]
        block[_IN_SX + m], block[_IN_SY + m] = block[SX + n], block[SY + n]
        block[_IN_SR + m], block[_IN_SZ + m] = block[SR + n], block[SZ + n]
        block[_IN_RHO + m], block[_IN_LOG_H + m] = block[_RHO + n], block[_LOG_H + n]
        block[_IN_BEST + m] = -block[DISTANCE + n]
        which[m] = n
        num_inside += 1
    if num_inside == 0:
        return
    _along_axes(block, num_inside, row)
    for i in range(num_inside):
        n = which[i]
        if block[_IN_RHO + i] > 0.0:
            block[DISTANCE + n] = -block[_IN_BEST + i]
            block[GX + n], block[GY + n], block[GZ + n] = block[_IN_X + i], block[_IN_Y + i], block[_IN_Z + i]
            block[SX + n], block[SY + n] = block[_IN_SX + i], block[_IN_SY + i]
            block[SR + n], block[SZ + n] = block[_IN_SR + i], block[_IN_SZ + i]


@kernel(error_model="numpy")
def _from_centre(block, row):
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = row[8], row[9], row[10], row[11], row[12], row[13], row[14], row[15], row[16]
    log_a, log_b, log_c, cx, cy, cz = row[2], row[3], row[4], row[5], row[6], row[7]
    half_1, half_2 = 0.5 * row[0], 0.5 * row[1]
    power_1, power_2 = 2.0 / row[0], 2.0 / row[1]
    for n in range(BLOCK):
        dx, dy, dz = block[X + n] - cx, block[Y + n] - cy, block[Z + n] - cz
        px, py, pz = r0 * dx + r3 * dy + r6 * dz, r1 * dx + r4 * dy + r7 * dz, r2 * dx + r5 * dy + r8 * dz
        px = px if abs(px) > 1e-6 else 1e-6
        py = py if abs(py) > 1e-6 else 1e-6
        pz = pz if abs(pz) > 1e-6 else 1e-6
        log_x, log_y, log_z = quick_log(abs(px)) - log_a, quick_log(abs(py)) - log_b, quick_log(abs(pz)) - log_c
        gap = power_2 * (log_y - log_x)
        small = quick_exp(-abs(gap))
        large = 1.0 / (1.0 + small)
        rho = max(log_x, log_y) + half_2 * quick_log(1.0 + small)
        share_x = small * large if gap > 0.0 else large
        share_y = large if gap > 0.0 else small * large
        gap = power_1 * (log_z - rho)
        small = quick_exp(-abs(gap))
        large = 1.0 / (1.0 + small)
        log_h = max(rho, log_z) + half_1 * quick_log(1.0 + small)
        share_r = small * large if gap > 0.0 else large
        share_z = large if gap > 0.0 else small * large
        gx, gy, gz = share_r * share_x / px, share_r * share_y / py, share_z / pz
        slope = np.sqrt(gx * gx + gy * gy + gz * gz)
        inverse = quick_exp(-log_h)
        block[X + n], block[Y + n], block[Z + n] = px, py, pz
        block[GX + n], block[GY + n], block[GZ + n] = gx, gy, gz
        block[SX + n], block[SY + n], block[SR + n], block[SZ + n] = share_x, share_y, share_r, share_z
        block[_RHO + n], block[_LOG_H + n] = rho, log_h
        # Outside 1 - 1 / h, inside 1 / h - 1 with the other sign.
        block[DISTANCE + n] = (1.0 - min(inverse, 1e200)) / slope


@kernel(error_model="numpy")
def _along_axes(block, count, row):
    # Gradients in place of points, 1 in place of rho if the surface along an axis is nearer.
    log_a, log_b, log_c = row[2], row[3], row[4]
    half_1, half_2 = 0.5 * row[0], 0.5 * row[1]
    power_1, power_2 = 2.0 / row[0], 2.0 / row[1]
    for n in range(count):
        px, py, pz = block[_IN_X + n], block[_IN_Y + n], block[_IN_Z + n]
        share_x, share_y = block[_IN_SX + n], block[_IN_SY + n]
        best = block[_IN_BEST + n]
        whole = quick_exp(power_1 * block[_IN_LOG_H + n])
        in_plane, along_z = block[_IN_SR + n] * whole, block[_IN_SZ + n] * whole
        rest_z, rest_r = max(1.0 - in_plane, 1e-300), max(1.0 - along_z, 1e-300)
        # ln of the largest gauge in the plane at this height, and what the point's own is of it.
        log_most = half_1 * quick_log(rest_r)
        own = quick_exp(min(power_2 * (block[_IN_RHO + n] - log_most), 0.0))
        rest_x, rest_y = max(1.0 - share_y * own, 1e-300), max(1.0 - share_x * own, 1e-300)
        reach_z = quick_exp(log_c + half_1 * quick_log(rest_z)) - abs(pz)
        reach_x = quick_exp(log_a + log_most + half_2 * quick_log(rest_x)) - abs(px)
        reach_y = quick_exp(log_b + log_most + half_2 * quick_log(rest_y)) - abs(py)
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
        is_nearer = (reach < best * 4.0) & (planar < best)
        block[_IN_X + n], block[_IN_Y + n], block[_IN_Z + n] = gx, gy, gz
        block[_IN_SX + n], block[_IN_SY + n], block[_IN_SR + n], block[_IN_SZ + n] = foot_x, foot_y, foot_r, foot_z
        block[_IN_BEST + n] = min(planar, best)
        block[_IN_RHO + n] = 1.0 if is_nearer else 0.0


@kernel(error_model="numpy")
def fill_jacobian(block):
    """Fill the derivatives of the distances: the plane moves with the surface, its direction held fixed."""
    # dd = d ln h / |grad ln h|, by e1, e2, ln a (3), the centre and the rotation in the local frame (3 and 3).
    for n in range(BLOCK):
        gx, gy, gz = block[GX + n], block[GY + n], block[GZ + n]
        px, py, pz = block[X + n], block[Y + n], block[Z + n]
        x, y, r, z = block[SX + n], block[SY + n], block[SR + n], block[SZ + n]
        scale = 1.0 / np.sqrt(gx * gx + gy * gy + gz * gz)
        of_r = r * quick_log(max(r, 1e-300)) + z * quick_log(max(z, 1e-300))
        of_x = x * quick_log(max(x, 1e-300)) + y * quick_log(max(y, 1e-300))
        block[JACOBIAN + n] = -0.5 * of_r * scale
        block[JACOBIAN + BLOCK + n] = -0.5 * r * of_x * scale
        block[JACOBIAN + 2 * BLOCK + n] = -r * x * scale
        block[JACOBIAN + 3 * BLOCK + n] = -r * y * scale
        block[JACOBIAN + 4 * BLOCK + n] = -z * scale
        block[JACOBIAN + 5 * BLOCK + n] = -gx * scale
        block[JACOBIAN + 6 * BLOCK + n] = -gy * scale
        block[JACOBIAN + 7 * BLOCK + n] = -gz * scale
        block[JACOBIAN + 8 * BLOCK + n] = (gy * pz - gz * py) * scale
        block[JACOBIAN + 9 * BLOCK + n] = (gz * px - gx * pz) * scale
        block[JACOBIAN + 10 * BLOCK + n] = (gx * py - gy * px) * scale


def distances_of(row: NDArray[np.float64], points: NDArray[np.float64], depth: float) -> NDArray[np.float64]:
    """Return the (N,) signed distances of (N, 3) points."""
    out = np.empty(len(points))
    fill_all_distances(row, points, depth, new_block(), out)
    return out


@kernel
def fill_all_distances(row, points, depth, block, out):
    """Fill the (N,) signed distances of (N, 3) points, a block at a time."""
    for first in range(0, len(points), BLOCK):
        count = min(BLOCK, len(points) - first)
        for n in range(count):
            block[X + n], block[Y + n], block[Z + n] = points[first + n, 0], points[first + n, 1], points[first + n, 2]
        fill_distances(block, count, row, depth)
        for n in range(count):
            out[first + n] = block[DISTANCE + n]
