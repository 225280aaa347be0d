"""Over-segmentation into fragments: connected surface without depth edges, concave creases or support plane borders.

Union-find joins neighbouring pixels: only which pairs may be joined matters, not their order.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.portable_kernels import cos
from hickory_stream.perception.structure.room_structure import RoomStructure
from hickory_stream.perception.surface import Surface

# Minimum depth edge: distance of a pixel from its neighbour's tangent plane, plus 3 sigma.
_STEP_M = np.float32(0.008)
# Neighbours whose depths differ by more than this share are separate whatever their planes.
_GAP_SHARE = np.float32(0.025)
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
    out = np.zeros(structure.shape, dtype=bool)
    is_open, cosine = ~structure & ~np.isnan(surface.sigma_m), np.float32(cos(_CREASE_RAD))
    _mark_creases(surface.points_world, surface.normals_world, surface.sigma_m, is_open, cosine, out)
    return out


@kernel
def _mark_creases(points, normals, sigma, is_open, cos_crease, out):
    height, width = sigma.shape
    reach = _CREASE_REACH_PX
    for y in range(height):
        for x in range(width):
            if not is_open[y, x]:
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
                if lean_a + lean_b > 2.0 * sigma[y, x] + 0.15 * length and min(lean_a, lean_b) > -0.3 * _STEP_M:
                    out[y, x] = True
                    break


def fragments_of(
    surface: Surface,
    structure: NDArray[np.bool_],
    supports: NDArray[np.int32],
    creases: NDArray[np.bool_],
) -> NDArray[np.int32]:
    """Return (h, w) fragment labels 1..n in scan order; 0 on structure and where there is no depth."""
    usable = ~structure & np.isfinite(surface.depth_m)
    labels, parent = np.zeros(usable.shape, dtype=np.int32), np.arange(usable.size)
    arrays = (surface.depth_m, surface.points_world, surface.normals_world, surface.sigma_m, supports)
    _join(usable & ~creases, *arrays, parent, labels)
    return _in_scan_order(_grown(labels, usable, surface.depth_m, supports))


@kernel
def _join(is_open, depth, points, normals, sigma, supports, parent, labels):
    # Fills in `labels`; `parent` (h w,) is each pixel's own index.
    height, width = depth.shape
    for y in range(height):
        for x in range(width):
            if not is_open[y, x]:
                continue
            for side in range(2):
                yy, xx = (y, x + 1) if side == 0 else (y + 1, x)
                # Whether objects on and below a plane are one is decided for whole fragments, in `join`.
                if yy >= height or xx >= width or not is_open[yy, xx] or supports[y, x] != supports[yy, xx]:
                    continue
                away, noise = abs(depth[y, x] - depth[yy, xx]), sigma[y, x]
                if away >= 0.5 * _STEP_M + noise:
                    if away > _GAP_SHARE * min(depth[y, x], depth[yy, xx]) + 3.0 * noise:
                        continue
                    off_a, off_b = np.float32(0.0), np.float32(0.0)
                    for k in range(3):
                        d = points[yy, xx, k] - points[y, x, k]
                        off_a += d * normals[y, x, k]
                        off_b += d * normals[yy, xx, k]
                    # Comparisons with NaN normals are False: such pixels are joined by similar depth alone.
                    limit = _STEP_M + 2.0 * noise
                    if not (abs(off_a) < limit or abs(off_b) < limit):
                        continue
                a, b = y * width + x, yy * width + xx
                while parent[a] != a:
                    parent[a] = parent[parent[a]]
                    a = parent[a]
                while parent[b] != b:
                    parent[b] = parent[parent[b]]
                    b = parent[b]
                parent[max(a, b)] = min(a, b)
    # A parent comes before its children.
    count = 0
    for y in range(height):
        for x in range(width):
            if is_open[y, x]:
                root = parent[y * width + x]
                if root == y * width + x:
                    count += 1
                    labels[y, x] = count
                else:
                    labels[y, x] = labels[root // width, root % width]


def _grown(
    labels: NDArray[np.int32], usable: NDArray[np.bool_], depth: NDArray[np.float32], supports: NDArray[np.int32]
) -> NDArray[np.int32]:
    # Crease pixels and small fragments go to the neighbour of the most similar depth, ring by ring.
    small = np.where(np.bincount(labels.ravel())[labels] < _MIN_PIXELS, 0, labels)
    out, depth, supports = (np.pad(own, 1).ravel() for own in (small, depth, supports))
    height, width = labels.shape
    waiting = np.flatnonzero(np.pad(usable & (small == 0), 1))
    for _ in range(4):
        best, chosen = 0.03 * depth[waiting].astype(np.float64) + 0.005, np.zeros(len(waiting), dtype=np.int32)
        for beside in (waiting + width + 2, waiting - width - 2, waiting + 1, waiting - 1):
            difference = np.abs(depth[beside] - depth[waiting]).astype(np.float64)
            difference += np.where(supports[beside] == supports[waiting], 0.0, 0.01)
            is_better = (out[beside] > 0) & (difference < best)
            best, chosen = np.where(is_better, difference, best), np.where(is_better, out[beside], chosen)
        out[waiting] = chosen
        if not chosen.any():
            break
        waiting = waiting[chosen == 0]
    return out.reshape(height + 2, width + 2)[1:-1, 1:-1]


def _in_scan_order(labels: NDArray[np.int32]) -> NDArray[np.int32]:
    # Numbered by their first pixels; 0 stays.
    first = np.full(int(labels.max()) + 1, labels.size)
    first[labels.ravel()[::-1]] = np.arange(labels.size)[::-1]
    first[0] = -1
    names = np.empty(len(first), dtype=np.int32)
    names[np.argsort(first, kind="stable")] = np.arange(len(first))
    return names[labels]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Fragments:
    """An over-segmented frame at working resolution (h, w): `labels` 1..n, and the support plane of each pixel or 0."""

    surface: Surface
    room: RoomStructure
    supports: NDArray[np.int32]
    labels: NDArray[np.int32]
