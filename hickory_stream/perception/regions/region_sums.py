"""Per-region sums over the pixels of a frame, accumulated in one pass in pixel order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.base.compiled import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.perception.surface import Surface


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RegionSums:
    """Measures of n regions, row 0 is background; all arrays (n, ...).

    Sums over pixels: `pixels`, `area_m2`, `depth_m`, `sigma_m`, `lab` (n, 3) and `lab_squares` (n, 3), positions
    `place` (n, 3) and `place_products` (n, 6: xx xy xz yy yz zz) relative to the mean point of the frame, `normals`
    (n, 3), `grain` (n, 2): the colour differences of horizontal neighbours within a region and their number, `planes`
    (n, 1 + planes): pixels in no plane and in each support plane, `heights` (n, bins): a histogram from the bottom up.
    `low`, `high` (n, 3): the bounding box of the points.
    """

    pixels: NDArray[np.float64]
    area_m2: NDArray[np.float64]
    depth_m: NDArray[np.float64]
    sigma_m: NDArray[np.float64]
    lab: NDArray[np.float64]
    lab_squares: NDArray[np.float64]
    place: NDArray[np.float64]
    place_products: NDArray[np.float64]
    normals: NDArray[np.float64]
    grain: NDArray[np.float64]
    planes: NDArray[np.float64]
    heights: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


def region_sums(
    surface: Surface,
    labels: NDArray[np.int32],
    supports: NDArray[np.int32],
    areas_m2: NDArray[np.float32],
    height_bin_m: float,
) -> tuple[RegionSums, NDArray[np.float64], float]:
    """Return the sums of the regions `labels` (h, w), of which there is at least one.

    Also returns the origin of positions (3,) and of heights: the mean point and the lowest z.
    """
    names, points, planes = _labelled(labels, supports, surface.points_world)
    count = int(names.max()) + 1
    middle, bottom_m, top_m = points.mean(axis=0), float(points[:, 2].min()), float(points[:, 2].max())
    sums, low, high = _sums(
        labels.ravel(),
        points - middle,
        points,
        areas_m2.ravel(),
        surface.depth_m.ravel(),
        surface.lab.reshape(-1, 3),
        surface.normals_world.reshape(-1, 3),
        surface.sigma_m.ravel(),
        labels.shape[1],
        count,
    )
    bins = int((top_m - bottom_m) / height_bin_m) + 1
    in_plane, heights = _histograms(
        labels.ravel(), supports.ravel(), points, count, planes, bins, bottom_m, height_bin_m
    )
    widths = np.cumsum([1, 1, 1, 3, 3, 3, 6, 3, 1])
    pixels, area_m2, depth_m, lab_sums, lab_squares, place, products, normals, sigma_m, grain = (
        np.ascontiguousarray(columns) for columns in np.split(sums, widths, axis=1)
    )
    out = RegionSums(
        pixels=pixels[:, 0],
        area_m2=area_m2[:, 0],
        depth_m=depth_m[:, 0],
        sigma_m=sigma_m[:, 0],
        lab=lab_sums,
        lab_squares=lab_squares,
        place=place,
        place_products=products,
        normals=normals,
        grain=grain,
        planes=in_plane,
        heights=heights,
        low=low,
        high=high,
    )
    return out, middle, bottom_m


@kernel
def _labelled(labels, supports, points):
    """Return (N,) the labels of the pixels that have one, (N, 3) their points as float64, and how many planes count."""
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
def _sums(labels, places, points, areas, depth, lab, normals, sigma, width, count):
    """Return (count, 24) sums and (count, 3) least and greatest coordinates; `places` and `points` of labelled pixels.

    Columns: 1, area, depth, lab, squares of lab (in single precision), position, products of positions, normals, sigma,
    colour difference to the right neighbour of the same label, number of such neighbours.
    """
    sums = np.zeros((count, 24))
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
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
    return sums, low, high


@kernel
def _histograms(labels, supports, points, count, planes, bins, bottom, bin_m):
    """Return (count, planes) the pixels of each region in each plane, and (count, bins) at each height."""
    in_plane, at_height = np.zeros((count, planes)), np.zeros((count, bins))
    n = 0
    for i in range(len(labels)):
        if labels[i]:
            in_plane[labels[i], supports[i]] += 1.0
            at_height[labels[i], int((points[n, 2] - bottom) / bin_m)] += 1.0
            n += 1
    return in_plane, at_height
