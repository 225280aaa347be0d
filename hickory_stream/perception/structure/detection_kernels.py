"""Kernels of structure detection."""

from __future__ import annotations

import numpy as np

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.portable_kernels import arctan2


@kernel
def areas_m2(points, normals, depth, origin, focal_product):
    """Return (h, w) the surface area of each pixel, with its cosine bounded at 0.15; 0 without depth."""
    height, width = depth.shape
    out = np.zeros((height, width), dtype=np.float32)
    for y in range(height):
        for x in range(width):
            rx, ry, rz = points[y, x, 0] - origin[0], points[y, x, 1] - origin[1], points[y, x, 2] - origin[2]
            across = rx * normals[y, x, 0] + ry * normals[y, x, 1] + rz * normals[y, x, 2]
            cosine = abs(across) / np.sqrt(rx * rx + ry * ry + rz * rz)
            if not np.isnan(cosine):
                out[y, x] = depth[y, x] * depth[y, x] / focal_product / max(cosine, np.float32(0.15))
    return out


@kernel
def surface_of_area(points, sigma, areas):
    """Return positions (N, 2), areas (N,) and doubled standard deviations (N,) of the pixels with an area."""
    count = 0
    for i in range(len(areas)):
        count += areas[i] > 0
    at, weight, noise = np.empty((count, 2), np.float32), np.empty(count), np.empty(count, np.float32)
    n = 0
    for i in range(len(areas)):
        if areas[i] > 0:
            at[n, 0], at[n, 1] = points[i, 0], points[i, 1]
            weight[n], noise[n] = areas[i], np.float32(2.0) * sigma[i]
            n += 1
    return at, weight, noise


@kernel
def upright_pixels(normals, areas):
    """Return flat indices (N,) of the pixels with an area and a horizontal normal, and its direction (N, 2)."""
    pixels = np.empty(len(areas), dtype=np.int64)
    direction = np.empty((len(areas), 2), dtype=np.float32)
    count = 0
    for i in range(len(areas)):
        if areas[i] > 0 and abs(normals[i, 2]) < np.float32(0.2):
            x, y = normals[i, 0], normals[i, 1]
            length = np.sqrt(x * x + y * y)
            pixels[count], direction[count, 0], direction[count, 1] = i, x / length, y / length
            count += 1
    return pixels[:count].copy(), direction[:count].copy()


@kernel
def along(rows, direction):
    """Return (N,) the projections of (N, 2) or (N, 3) rows on a horizontal direction (2,), in single precision."""
    out = np.empty(len(rows), dtype=np.float32)
    x, y = direction[0], direction[1]
    for i in range(len(rows)):
        out[i] = np.float32(0.0) + rows[i, 0] * x + rows[i, 1] * y
    return out


@kernel
def bins_of_azimuth(directions, count):
    """Return (N,) the bin of each of (N, 2) directions, of `count` equal bins of azimuth from -pi on."""
    azimuths, out = np.empty(len(directions)), np.empty(len(directions), dtype=np.int64)
    for i in range(len(directions)):  # vectorised
        azimuths[i] = arctan2(np.float64(directions[i, 1]), np.float64(directions[i, 0]))
    for i in range(len(directions)):
        out[i] = np.int64((azimuths[i] + np.pi) / (2 * np.pi) * count) % count
    return out


@kernel
def spread_of(at, share):
    """Return the mean (2,) of (N, 2) places whose shares add up to 1, and the (2, 2) covariance."""
    middle, spread = np.zeros(2), np.zeros((2, 2))
    for i in range(len(at)):
        for k in range(2):
            middle[k] += share[i] * at[i, k]
    for i in range(len(at)):
        for j in range(2):
            weighted = (at[i, j] - middle[j]) * share[i]
            for k in range(2):
                spread[j, k] += weighted * (at[i, k] - middle[k])
    return middle, spread


@kernel
def places_of(pixels, points, sigma, areas):
    """Return positions (N, 2), heights, standard deviations and, as float64, areas of (N,) pixels."""
    at, heights = np.empty((len(pixels), 2), np.float32), np.empty(len(pixels), np.float32)
    noise, weight = np.empty(len(pixels), np.float32), np.empty(len(pixels))
    for n in range(len(pixels)):
        i = pixels[n]
        at[n, 0], at[n, 1], heights[n] = points[i, 0], points[i, 1], points[i, 2]
        noise[n], weight[n] = sigma[i], areas[i]
    return at, heights, noise, weight


@kernel
def taken(values, mask):
    """Return values[mask] of (N,) values."""
    out = np.empty(len(values), dtype=values.dtype)
    count = 0
    for i in range(len(mask)):
        # Branch-free: values that are not taken are overwritten.
        out[count] = values[i]
        count += mask[i]
    return out[:count]


@kernel
def taken_rows(values, mask):
    """Return values[mask] of (N, 2) values."""
    out = np.empty(values.shape, dtype=values.dtype)
    count = 0
    for i in range(len(mask)):
        out[count, 0], out[count, 1] = values[i, 0], values[i, 1]
        count += mask[i]
    return out[:count]


@kernel
def weighted_sum(rows, weight):
    """Return the weighted sum of (N, 2) rows, added in order."""
    out = np.zeros(2)
    for i in range(len(rows)):
        out[0] += rows[i, 0] * weight[i]
        out[1] += rows[i, 1] * weight[i]
    return out


@kernel
def near_offset(along, offset, tolerance):
    """Return (N,) which values lie within their tolerance of an offset."""
    out = np.empty(len(along), dtype=np.bool_)
    for i in range(len(along)):
        out[i] = abs(along[i] - offset) < tolerance[i]
    return out


@kernel
def weight_below(weight, along, offset, noise):
    """Return the weights of the values that are below an offset by more than their noise."""
    out = np.empty(len(along))
    count = 0
    for i in range(len(along)):
        out[count] = weight[i]
        count += along[i] < offset - noise[i]
    return out[:count]


@kernel
def on_wall(distance, facing, tolerance, is_end):
    """Return (h, w) which pixels are near and parallel to a wall, or very near; with `is_end`, also all behind it."""
    height, width = distance.shape
    out = np.empty((height, width), dtype=np.bool_)
    for y in range(height):
        for x in range(width):
            away = distance[y, x] if is_end else abs(distance[y, x])
            slack = tolerance[y, x]
            out[y, x] = (away < np.float32(1.5) * slack) & (
                (facing[y, x] > np.float32(0.8)) | (away < np.float32(0.6) * slack)
            )
    return out
