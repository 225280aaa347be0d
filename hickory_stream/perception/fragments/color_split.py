"""Splitting of fragments by colour: a box flush with the one below it, books on a board.

Colour is averaged over windows inside a fragment, so that a texture is one colour, and the windows are split in two
along their principal colour axis (Otsu 1979). It over-segments on purpose: `join` decides about the pieces.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable

# Side of the averaging windows.
_WINDOW_PX = 5
# Weights of CIE Lab; that of lightness is below 1, since shadows change it.
LAB_WEIGHTS = np.array([0.5, 1, 1], dtype=np.float32)
# Minimum weighted distance between two colours that are not one.
COLOR_STEP = 12.0
# Minimum between-class share of the variance along the principal colour axis (Otsu's criterion).
_MIN_SEPARATION = 0.7
# Minimum area of a piece.
_MIN_PIXELS = 16
# Maximum depth of recursive splits.
_MAX_DEPTH = 2


def split_by_color(
    labels: NDArray[np.int32], boxes: NDArray[np.int64], lab: NDArray[np.float32], depth: int = _MAX_DEPTH
) -> NDArray[np.int32]:
    """Return (h, w) labels in which some of 1..n are split, up to `depth` times.

    `boxes` (n + 1, 4): x0, y0, x1, y1 of each label.
    """
    out = labels.copy()
    count = len(boxes)
    pixels = np.bincount(labels.ravel(), minlength=count)
    weighted = lab * LAB_WEIGHTS
    for i in range(1, len(boxes)):
        if pixels[i] < 2 * _MIN_PIXELS:
            continue
        x0, y0, x1, y1 = boxes[i]
        mask = labels[y0:y1, x0:x1] == i
        for piece in _pieces(mask, weighted[y0:y1, x0:x1], depth)[1:]:
            out[y0:y1, x0:x1][piece] = count
            count += 1
    return out


def _pieces(mask: NDArray[np.bool_], lab: NDArray[np.float32], depth: int) -> list[NDArray[np.bool_]]:
    if depth == 0 or int(mask.sum()) < 2 * _MIN_PIXELS:
        return [mask]
    bright = _two_colors(mask, lab)
    if bright is None:
        return [mask]
    pieces = _regions(mask & bright, mask & ~bright, _MIN_PIXELS)
    if len(pieces) < 2:
        return [mask]
    return [part for piece in pieces for part in _pieces(piece, lab, depth - 1)]


def _two_colors(mask: NDArray[np.bool_], lab: NDArray[np.float32]) -> NDArray[np.bool_] | None:
    side = (_WINDOW_PX, _WINDOW_PX)
    share = cv2.blur(mask.astype(np.float32), side, borderType=cv2.BORDER_CONSTANT)
    total = cv2.blur(cv2.copyTo(lab, mask.view(np.uint8)), side, borderType=cv2.BORDER_CONSTANT)
    count = np.count_nonzero(mask)
    colors, centered, spread = np.empty((count, 3), np.float32), np.empty((count, 3)), np.zeros((3, 3))
    _window_colors(total, share, mask, colors, centered, spread)
    spread /= count
    variances, axes = portable.eigh(spread)
    # Two means at the minimum distance cause at least this variance: with less, the split can be skipped early.
    if variances[2] < 0.02 * COLOR_STEP * COLOR_STEP:
        return None
    along = portable.matmul(centered, axes[:, 2])
    threshold, separation = _otsu(along)
    high = along > threshold
    if separation < _MIN_SEPARATION:
        return None
    if portable.norm(colors[high].mean(axis=0) - colors[~high].mean(axis=0)) < COLOR_STEP:
        return None
    out = np.zeros(mask.shape, dtype=bool)
    out[mask] = high
    return out


@kernel
def _window_colors(total, share, mask, colors, centered, spread):
    # (N, 3) mean colours of the windows around a mask's pixels, the same centred, and (3, 3) their products.
    mean = np.zeros(3, dtype=np.float32)
    n = 0
    for y in range(mask.shape[0]):
        for x in range(mask.shape[1]):
            if mask[y, x]:
                for k in range(3):
                    colors[n, k] = total[y, x, k] / share[y, x]
                    mean[k] += colors[n, k]
                n += 1
    for k in range(3):
        mean[k] /= np.float32(n)
    for i in range(n):
        for k in range(3):
            centered[i, k] = colors[i, k] - mean[k]
        for j in range(3):
            for k in range(3):
                spread[j, k] += centered[i, j] * centered[i, k]


_OTSU_BINS = 48


def _otsu(values: NDArray[np.float64]) -> tuple[float, float]:
    edges = np.linspace(values.min(), values.max(), _OTSU_BINS + 1)
    threshold, between = _most_between(_histogram(values, edges), edges)
    return threshold, between / max(float(values.var()) * len(values) * len(values), 1e-12)


@kernel
def _most_between(counts, edges):
    # The edge between the two classes with the largest variance between them, times the square of their number.
    middles, total, all_below = np.empty(len(counts)), 0.0, np.int64(0)
    for i in range(len(counts)):
        middles[i] = (edges[i] + edges[i + 1]) / 2
        total += counts[i] * middles[i]
        all_below += counts[i]
    threshold, most, below, first = edges[1], -1.0, np.int64(0), 0.0
    for i in range(len(counts) - 1):
        below += counts[i]
        first += counts[i] * middles[i]
        above, last = all_below - below, total - first
        apart = last / max(above, 1) - first / max(below, 1)
        between = below * above * (apart * apart)
        if between > most:
            threshold, most = edges[i + 1], between
    return threshold, most


@kernel
def _histogram(values, edges):
    # `edges` are evenly spaced and enclose all values.
    bins = len(edges) - 1
    counts = np.zeros(bins, dtype=np.int64)
    width = (edges[bins] - edges[0]) / bins
    for i in range(len(values)):
        place = min(int((values[i] - edges[0]) / width), bins - 1)
        # Rounding may have picked a neighbouring bin.
        if values[i] < edges[place]:
            place -= 1
        elif place < bins - 1 and values[i] >= edges[place + 1]:
            place += 1
        counts[place] += 1
    return counts


def _regions(one: NDArray[np.bool_], other: NDArray[np.bool_], min_pixels: int) -> list[NDArray[np.bool_]]:
    # Large enough connected regions of two masks; other pixels go to the nearest of these.
    large: list[NDArray[np.bool_]] = []
    for mask in (one, other):
        _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
        large += [labels == i for i in np.flatnonzero(stats[:, cv2.CC_STAT_AREA] >= min_pixels).tolist() if i > 0]
    if len(large) < 2:
        return large
    seeds = np.zeros(one.shape, dtype=np.int32)
    for i, region in enumerate(large):
        seeds[region] = i + 1
    rest = (one | other) & (seeds == 0)
    if rest.any():
        _, nearest = cv2.distanceTransformWithLabels(
            (seeds == 0).astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
        )
        names = np.zeros(int(nearest.max()) + 1, dtype=np.int32)
        names[nearest[seeds > 0]] = seeds[seeds > 0]
        seeds[rest] = names[nearest[rest]]
    return [seeds == i + 1 for i in range(len(large))]
