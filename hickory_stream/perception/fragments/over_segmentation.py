"""Over-segmentation into fragments: connected surface without depth edges, concave creases or support plane borders.

Union-find joins neighbouring pixels: only which pairs may be joined matters, not their order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.portable_kernels import cos
from hickory_stream.perception.fragments.union_find import find_root
from hickory_stream.perception.structure.room_structure import RoomStructure
from hickory_stream.perception.surface import Surface

# Minimum depth edge: distance of a pixel from its neighbour's tangent plane, plus 3 sigma.
_STEP_M = 0.008
# Neighbours whose depths differ by more than this share are separate whatever their planes.
_GAP_SHARE = 0.025
# Minimum angle of a concave crease; normals are compared across twice this many pixels.
_CREASE_RAD = 0.45
_CREASE_REACH_PX = 2
# Smaller fragments are merged with a neighbour or dropped.
_MIN_PIXELS = 12


def support_labels(surface: Surface, heights_m: NDArray[np.float64], *, min_pixels: int) -> NDArray[np.int32]:
    """Return (h, w) 1 + the index of the support plane under a pixel; 0 if there is none."""
    labels = np.zeros(surface.depth_m.shape, dtype=np.int32)
    slack = 0.008 + 1.5 * surface.sigma_m
    for i, height in enumerate(heights_m):
        _label_level(surface.points_world, surface.normals_world, slack, float(height), min_pixels, i + 1, labels)
    return labels


@kernel
def _label_level(points, normals, slack, z_m, min_pixels, label, labels):
    height, width = labels.shape
    waits = np.empty((height, width), dtype=np.bool_)
    for y in range(height):
        for x in range(width):
            away = abs(np.float64(points[y, x, 2]) - z_m)
            waits[y, x] = (normals[y, x, 2] > np.float32(0.85)) & (away < slack[y, x])
    region = np.empty(height * width, dtype=np.int64)
    for start in range(height * width):
        if not waits[start // width, start % width]:
            continue
        region[0], count, done = start, 1, 0
        waits[start // width, start % width] = False
        while done < count:
            y, x = region[done] // width, region[done] % width
            done += 1
            for side in range(4):
                yy = y + (1 if side == 0 else (-1 if side == 1 else 0))
                xx = x + (1 if side == 2 else (-1 if side == 3 else 0))
                if 0 <= yy < height and 0 <= xx < width and waits[yy, xx]:
                    waits[yy, xx] = False
                    region[count] = yy * width + xx
                    count += 1
        if count >= min_pixels:
            for i in range(count):
                y, x = region[i] // width, region[i] % width
                if labels[y, x] == 0:
                    labels[y, x] = label


def concave_creases(surface: Surface, structure: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return (h, w) the pixels on a concave crease, outside of structure."""
    limits = (_CREASE_REACH_PX, np.float32(cos(_CREASE_RAD)), np.float32(_STEP_M))
    return _creases(surface.points_world, surface.normals_world, surface.sigma_m, structure, *limits)


def fragments_of(
    surface: Surface,
    structure: NDArray[np.bool_],
    supports: NDArray[np.int32],
    creases: NDArray[np.bool_],
) -> NDArray[np.int32]:
    """Return (h, w) fragment labels 1..n in scan order; 0 on structure and where there is no depth."""
    arrays = (surface.depth_m, surface.points_world, surface.normals_world, surface.sigma_m)
    limits = (np.float32(_STEP_M), np.float32(_GAP_SHARE))
    labels = _join(*arrays, structure, supports, creases, *limits)
    usable = ~structure & np.isfinite(surface.depth_m)
    return _grow_into(labels, usable, surface.depth_m, supports, _MIN_PIXELS)


@kernel
def _creases(points, normals, sigma, structure, reach, cos_crease, step):
    height, width = sigma.shape
    out = np.zeros((height, width), dtype=np.bool_)
    for y in range(height):
        for x in range(width):
            if np.isnan(sigma[y, x]) or structure[y, x]:
                continue
            for direction in range(4):
                dx = reach if direction == 0 else (0 if direction == 1 else reach)
                dy = 0 if direction == 0 else (reach if direction != 3 else -reach)
                ya, xa, yb, xb = y - dy, x - dx, y + dy, x + dx
                if min(ya, yb) < 0 or max(ya, yb) >= height or xa < 0 or xb >= width:
                    continue
                ax, ay, az = normals[ya, xa, 0], normals[ya, xa, 1], normals[ya, xa, 2]
                bx, by, bz = normals[yb, xb, 0], normals[yb, xb, 1], normals[yb, xb, 2]
                if not ax * bx + ay * by + az * bz <= cos_crease:  # NaN fails too
                    continue
                across_x = points[yb, xb, 0] - points[ya, xa, 0]
                across_y = points[yb, xb, 1] - points[ya, xa, 1]
                across_z = points[yb, xb, 2] - points[ya, xa, 2]
                length = np.sqrt(across_x * across_x + across_y * across_y + across_z * across_z)
                if length > 0.10:
                    continue
                # Concave: the normals at both ends lean towards each other. The crease must be deeper than the noise.
                lean_a = across_x * ax + across_y * ay + across_z * az
                lean_b = -(across_x * bx + across_y * by + across_z * bz)
                if lean_a + lean_b > 2.0 * sigma[y, x] + 0.15 * length and min(lean_a, lean_b) > -0.3 * step:
                    out[y, x] = True
                    break
    return out


@kernel
def _join(depth, points, normals, sigma, structure, supports, creases, step, gap_share):
    height, width = depth.shape
    parent = np.arange(height * width)
    for y in range(height):
        for x in range(width):
            if np.isnan(depth[y, x]) or structure[y, x] or creases[y, x]:
                continue
            for side in range(2):
                yy, xx = (y, x + 1) if side == 0 else (y + 1, x)
                if yy >= height or xx >= width or np.isnan(depth[yy, xx]) or structure[yy, xx] or creases[yy, xx]:
                    continue
                if _may_join(y, x, yy, xx, depth, points, normals, sigma, supports, step, gap_share):
                    ra, rb = find_root(parent, y * width + x), find_root(parent, yy * width + xx)
                    if ra != rb:
                        parent[max(ra, rb)] = min(ra, rb)
    labels = np.zeros((height, width), dtype=np.int32)
    names = np.zeros(height * width, dtype=np.int32)
    count = 0
    for y in range(height):
        for x in range(width):
            if np.isnan(depth[y, x]) or structure[y, x] or creases[y, x]:
                continue
            root = find_root(parent, y * width + x)
            if names[root] == 0:
                count += 1
                names[root] = count
            labels[y, x] = names[root]
    return labels


@kernel
def _may_join(y, x, yy, xx, depth, points, normals, sigma, supports, step, gap_share):
    a, b = supports[y, x], supports[yy, xx]
    if a != b:  # whether objects on and below a plane are one is decided for whole fragments, in `join`
        return False
    za, zb = depth[y, x], depth[yy, xx]
    nearer = min(za, zb)
    if abs(za - zb) < 0.5 * step + sigma[y, x]:
        return True
    if abs(za - zb) > gap_share * nearer + 3.0 * sigma[y, x]:
        return False
    d0, d1, d2 = (
        points[yy, xx, 0] - points[y, x, 0],
        points[yy, xx, 1] - points[y, x, 1],
        points[yy, xx, 2] - points[y, x, 2],
    )
    out_a = abs(d0 * normals[y, x, 0] + d1 * normals[y, x, 1] + d2 * normals[y, x, 2])
    out_b = abs(d0 * normals[yy, xx, 0] + d1 * normals[yy, xx, 1] + d2 * normals[yy, xx, 2])
    limit = step + 2.0 * sigma[y, x]
    # Comparisons with NaN normals are False: such pixels are joined by similar depth alone.
    return out_a < limit or out_b < limit


@kernel
def _grow_into(labels, usable, depth, supports, min_pixels):
    # Crease pixels and small fragments go to the neighbour of the most similar depth, ring by ring.
    height, width = labels.shape
    sizes = np.bincount(labels.ravel())
    out = labels.copy()
    for y in range(height):
        for x in range(width):
            if sizes[out[y, x]] < min_pixels:
                out[y, x] = 0
    for _ in range(4):
        changed = False
        before = out.copy()
        for y in range(height):
            for x in range(width):
                if before[y, x] or not usable[y, x]:
                    continue
                best = 0.03 * depth[y, x] + 0.005
                for side in range(4):
                    yy = y + (1 if side == 0 else (-1 if side == 1 else 0))
                    xx = x + (1 if side == 2 else (-1 if side == 3 else 0))
                    if yy < 0 or xx < 0 or yy >= height or xx >= width or before[yy, xx] == 0:
                        continue
                    difference = abs(depth[yy, xx] - depth[y, x])
                    if supports[y, x] != supports[yy, xx]:
                        difference += 0.01
                    if difference < best:
                        best = difference
                        out[y, x] = before[yy, xx]
                        changed = True
        if not changed:
            break
    names = np.zeros(len(sizes), dtype=np.int32)
    count = 0
    for y in range(height):
        for x in range(width):
            label = out[y, x]
            if label:
                if names[label] == 0:
                    count += 1
                    names[label] = count
                out[y, x] = names[label]
    return out


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Fragments:
    """An over-segmented frame at working resolution (h, w): `labels` 1..n, and the support plane of each pixel or 0."""

    surface: Surface
    room: RoomStructure
    supports: NDArray[np.int32]
    labels: NDArray[np.int32]
