"""Sums of regions over the pixels of a frame, accumulated in one pass in pixel order."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable
from hickory_stream.geometry.bounds import bounds_of
from hickory_stream.perception.surface import Surface


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RegionSums:
    """Sums over the pixels of n regions, row 0 is background; all arrays (n, ...)."""

    pixels: NDArray[np.float64]
    area_m2: NDArray[np.float64]
    depth_m: NDArray[np.float64]
    sigma_m: NDArray[np.float64]
    lab: NDArray[np.float64]
    lab_squares: NDArray[np.float64]
    place: NDArray[np.float64]
    #: (n, 6) xx xy xz yy yz zz of positions relative to the frame's mean point, like `place` (n, 3)
    place_products: NDArray[np.float64]
    normals: NDArray[np.float64]
    #: (n, 2) colour differences of horizontal neighbours within a region, and their number
    grain: NDArray[np.float64]
    #: (n, 1 + planes) pixels in no plane and in each support plane
    planes: NDArray[np.float64]
    #: (n, bins) a histogram from the bottom up
    heights: NDArray[np.float64]
    #: (n, 3) like `high`: the bounding box of the points
    low: NDArray[np.float64]
    high: NDArray[np.float64]


def region_sums(
    surface: Surface,
    labels: NDArray[np.int32],
    supports: NDArray[np.int32],
    areas_m2: NDArray[np.float32],
    height_bin_m: float,
) -> tuple[RegionSums, NDArray[np.float64], float]:
    """Return the sums of at least one region of `labels` (h, w), and the origin of positions (3,) and of heights."""
    names, points, planes = _labelled(labels, supports, surface.points_world)
    count = int(names.max()) + 1
    middle = portable.matmul(np.ones(len(points)), points) / len(points)
    bottom_m, top_m = (float(height) for height in bounds_of(points)[:, 2])
    sums, low, high = np.zeros((count, 24)), np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    _add(
        labels.ravel(),
        points - middle,
        points,
        areas_m2.ravel(),
        surface.depth_m.ravel(),
        surface.lab.reshape(-1, 3),
        surface.normals_world.reshape(-1, 3),
        surface.sigma_m.ravel(),
        labels.shape[1],
        sums,
        low,
        high,
    )
    bins = int((top_m - bottom_m) / height_bin_m) + 1
    flat = labels.ravel()
    in_plane, heights = _histograms(flat, supports.ravel(), points, count, planes, bins, bottom_m, height_bin_m)
    parts = [np.ascontiguousarray(part) for part in np.split(sums, np.cumsum(list(_WIDTHS.values())[:-1]), axis=1)]
    of_pixels = {name: part[:, 0] if w == 1 else part for (name, w), part in zip(_WIDTHS.items(), parts, strict=True)}
    return RegionSums(planes=in_plane, heights=heights, low=low, high=high, **of_pixels), middle, bottom_m


# The columns of `_add`.
_WIDTHS = {"pixels": 1, "area_m2": 1, "depth_m": 1, "lab": 3, "lab_squares": 3, "place": 3, "place_products": 6}
_WIDTHS |= {"normals": 3, "sigma_m": 1, "grain": 2}


@kernel
def _labelled(labels, supports, points):
    # (N,) the labels of the pixels that have one, (N, 3) their points as float64, and how many planes count.
    height, width = labels.shape
    names, places = np.empty(height * width, dtype=np.int32), np.empty((height * width, 3))
    n, planes = 0, 1
    for y in range(height):
        for x in range(width):
            if labels[y, x]:
                names[n] = labels[y, x]
                planes = max(planes, supports[y, x] + 1)
                for k in range(3):
                    places[n, k] = points[y, x, k]
                n += 1
    return names[:n], places[:n], planes


@kernel
def _add(labels, places, points, areas, depth, lab, normals, sigma, width, sums, low, high):
    # (count, 24) sums and (count, 3) least and greatest coordinates. Columns: 1, area, depth, lab, squares of lab (in
    # single precision), position, products of positions, normals, sigma, colour difference to the right neighbour of
    # the same label, number of such neighbours. `places` and `points` are of labelled pixels.
    n = 0
    for i in range(len(labels)):
        name = labels[i]
        if name == 0:
            continue
        own = sums[name]
        own[0] += 1.0
        own[1] += areas[i]
        own[2] += depth[i]
        for k in range(3):
            own[3 + k] += lab[i, k]
            own[6 + k] += lab[i, k] * lab[i, k]
            own[9 + k] += places[n, k]
            if not np.isnan(normals[i, k]):
                own[18 + k] += normals[i, k]
            low[name, k] = min(low[name, k], points[n, k])
            high[name, k] = max(high[name, k], points[n, k])
        x, y, z = places[n, 0], places[n, 1], places[n, 2]
        own[12] += x * x
        own[13] += x * y
        own[14] += x * z
        own[15] += y * y
        own[16] += y * z
        own[17] += z * z
        own[21] += sigma[i]
        if (i + 1) % width and labels[i + 1] == name:
            light = np.float64(lab[i + 1, 0] - lab[i, 0])
            green, blue = np.float64(lab[i + 1, 1] - lab[i, 1]), np.float64(lab[i + 1, 2] - lab[i, 2])
            own[22] += np.sqrt(0.25 * light * light + green * green + blue * blue)
            own[23] += 1.0
        n += 1


@kernel
def _histograms(labels, supports, points, count, planes, bins, bottom, bin_m):
    # (count, planes) the pixels of each region in each plane, and (count, bins) at each height.
    in_plane, at_height = np.zeros((count, planes)), np.zeros((count, bins))
    n = 0
    for i in range(len(labels)):
        if labels[i]:
            in_plane[labels[i], supports[i]] += 1.0
            at_height[labels[i], int((points[n, 2] - bottom) / bin_m)] += 1.0
            n += 1
    return in_plane, at_height
