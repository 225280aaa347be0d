"""Relative features of pairs of regions, from which boosted trees estimate whether the two are one object.

Of two regions, "large" has more pixels. Sizes are ratios; distances are multiples of a size of the pair or of the
standard deviation of depth; undefined values are NaN.
"""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry import portable
from hickory_stream.perception.regions.absolute_features import absolute_features
from hickory_stream.perception.regions.features import Features, joined, of_both, table
from hickory_stream.perception.regions.ordered_pairs import OrderedPairs, ordered_pairs
from hickory_stream.perception.regions.region_extents import LEAST_M
from hickory_stream.perception.regions.region_graph import RegionGraph, Regions

# Of each region: its shape (flatness, slenderness, orientation, the share of its outline that is cut off), its colour
# variation, overall and between neighbouring pixels, and the share of its foot that rests on structure, on anything,
# and that is unsupported.
_OF_REGIONS = (
    *("in_plane", "level", "flat", "thickness_sigmas", "thickness_of_breadth", "breadth_of_length", "height_of_width"),
    *("filled", "cut", "rugged", "light_spread", "chroma_spread", "grain", "on_structure", "on_any", "free"),
)
# The relative pose of two regions and the shape of their union. The features "before" are the sine of the elevation of
# one region's centroid over the other's plane: positive for both regions of a concave pair, negative for both of a
# convex one (Stein et al. 2014).
_RELATIONS = (
    *("pixels_ratio", "area_ratio", "width_ratio", "height_ratio", "length_ratio", "parallel", "same_plane"),
    *("before_large", "before_small", "before_large_sigmas", "before_small_sigmas", "aside", "higher", "lows", "highs"),
    *("small_over_large", "large_over_small", "lows_sigmas", "highs_sigmas", "overlap_sideways", "overlap_upright"),
    *("overlap_foot", "inset", "inset_sigmas", "joined_width", "joined_height", "joined_height_of_width"),
    *("joined_volume", "joined_thickness_of_breadth", "joined_breadth_of_length", "joined_length", "thicker"),
    "thicker_sigmas",
)
# Their colour difference, in CIE Lab and in multiples of their standard deviation; how much of either rests on the
# other, and of both on the same support; their contact: its length, sharpness and place, and which occludes the other.
_CONTACTS = (
    *("light_difference", "chroma_difference", "light_spreads", "chroma_spreads"),
    *("large_on_small", "small_on_large", "on_the_same"),
    *("meet_of_lesser", "meet_of_small", "touch_of_size", "touch_share", "lean", "concave", "seam_parallel"),
    *("seam_contrast", "seam_grains", "seam_step_sigmas", "far_contrast", "seam_width", "seam_height"),
    *("seam_in_large", "seam_in_small", "large_nearer", "small_nearer", "large_above", "small_above"),
    *("bridged_level_share", "bridged_upright_share", "gap_sigmas", "gap_of_small"),
)


def pair_features(graph: RegionGraph, numbers: NDArray[np.int64], count: int) -> tuple[NDArray[np.int64], Features]:
    """Return the (K, 2) pairs, large and small, of merged regions (`numbers` (n,)), and their features (K,)."""
    ordered = ordered_pairs(graph, numbers, count)
    large, small = ordered.large, ordered.small
    of_regions = of_both(_OF_REGIONS, _of_regions(ordered), large, small)
    of_pairs = (Features(_RELATIONS, _relations(ordered)), Features(_CONTACTS, _contacts(ordered)))
    return np.stack([large, small], axis=1), joined(of_regions, *of_pairs, *absolute_features(ordered))


def _of_regions(ordered: OrderedPairs) -> NDArray[np.float64]:
    regions, extents, support = ordered.regions, ordered.extents, ordered.support
    per, foot = np.maximum(regions.pixels, 1.0), np.maximum(support.outline, 1)
    thickness, breadth, length = np.maximum(extents.axes_m, 1e-4).T
    light, green, blue = np.sqrt(_variances(regions, per)).T
    return table(
        1 - regions.planes[:, 0] / per,
        regions.normals[:, 2] / per,
        _lengths(regions.normals) / per,
        portable.log1p(thickness / extents.sigma_m),
        thickness / breadth,
        breadth / length,
        extents.height_m / (extents.height_m + extents.width_m),
        portable.log((regions.area_m2 + 1e-4) / (breadth * length + 1e-4)),
        regions.cut / np.maximum(regions.outline, 1.0),
        regions.outline / np.sqrt(per),
        light,
        np.sqrt(green * green + blue * blue),
        _grain(regions),
        support.on[:, -1] / foot,
        support.on.sum(axis=1) / foot,
        support.free / foot,
    )


def _relations(ordered: OrderedPairs) -> NDArray[np.float64]:
    regions, extents, union, geometry = ordered.regions, ordered.extents, ordered.union, ordered.geometry
    large, small = ordered.large, ordered.small
    aside, overlap, inset = geometry.aside_m, geometry.overlap_m, geometry.inset_m
    width, height, sigma_m = union.width_m, union.height_m, union.sigma_m
    normals = regions.normals / np.maximum(_lengths(regions.normals), 1e-9)[:, None]
    n_large, n_small = normals[large], normals[small]
    over_large, over_small = _products(aside, n_large), -_products(aside, n_small)
    away = np.maximum(_lengths(aside), 1e-4)
    most = regions.planes.argmax(axis=1)
    sides = np.maximum(regions.high - regions.low, LEAST_M)
    sides_large, sides_small = sides[large].T, sides[small].T
    volumes, joined_sides = _volumes(sides + LEAST_M), union.box_high_m - union.box_low_m + 2 * LEAST_M
    foot = np.maximum(overlap[:, 0], 0.0) * np.maximum(overlap[:, 1], 0.0)
    foot /= np.maximum(sides_small[0] * sides_small[1], 1e-4)
    axes = np.maximum(extents.axes_m, 1e-4)
    thin, broad, long = np.maximum(union.axes_m, 1e-4).T
    thickness = np.maximum(axes[large, 0], axes[small, 0])
    low_large, low_small = extents.low_m[large], extents.low_m[small]
    high_large, high_small = extents.high_m[large], extents.high_m[small]
    lows, highs = low_small - low_large, high_small - high_large
    pixels, area_m2 = np.maximum(regions.pixels, 1.0), regions.area_m2 + 1e-4
    ratios = (
        pixels[small] / pixels[large],
        area_m2[small] / area_m2[large],
        extents.width_m[small] / extents.width_m[large],
        extents.height_m[small] / extents.height_m[large],
        axes[small, 2] / axes[large, 2],
        width / extents.width_m[large],
        height / extents.height_m[large],
        _volumes(joined_sides) / (volumes[large] + volumes[small]),
        long / axes[large, 2],
        thin / thickness,
    )
    sigmas = np.array((over_large, over_small, lows, highs, np.minimum(inset[:, 0], inset[:, 1]), thin - thickness))
    logs, signed = portable.log(ratios), _signed_log(sigmas / sigma_m)
    return table(
        logs[:5],
        _products(n_large, n_small),
        (most[large] > 0) & (most[large] == most[small]),
        over_large / away,
        over_small / away,
        signed[:2],
        np.sqrt(aside[:, 0] * aside[:, 0] + aside[:, 1] * aside[:, 1]) / width,
        np.array((aside[:, 2], lows, highs, low_small - high_large, low_large - high_small)) / height,
        signed[2:4],
        np.minimum(overlap[:, 0] / sides_small[0], overlap[:, 1] / sides_small[1]),
        overlap[:, 2] / sides_small[2],
        np.minimum(foot, 1.5),
        np.minimum(inset[:, 0] / sides_large[0], inset[:, 1] / sides_large[1]),
        signed[4],
        logs[5:7],
        height / (height + width),
        logs[7],
        thin / broad,
        broad / long,
        logs[8:],
        signed[5],
    )


def _contacts(ordered: OrderedPairs) -> NDArray[np.float64]:
    regions, extents, support, pairs = ordered.regions, ordered.extents, ordered.support, ordered.pairs
    large, small, geometry, sigma_m = ordered.large, ordered.small, ordered.geometry, ordered.union.sigma_m
    per = np.maximum(regions.pixels, 1.0)
    shades, variances, grain = regions.lab / per[:, None], _variances(regions, per), _grain(regions)
    shade = np.abs(shades[small] - shades[large]).T
    spread = np.sqrt((variances[large] + variances[small]) / 2 + 1).T
    chroma = np.sqrt(shade[1] * shade[1] + shade[2] * shade[2])
    on = support.on / np.maximum(support.outline, 1)[:, None]
    # NaN where they do not meet, or touch.
    meet, touch = (np.where(count > 0.0, np.maximum(count, 1.0), np.nan) for count in (pairs.meet, pairs.touch))
    away, across = pairs.meet - pairs.touch, np.sqrt(per[small])
    gap_m = np.where(np.isfinite(pairs.gap_m), pairs.gap_m, np.nan)
    seam_x, seam_y, seam_z = geometry.contact_spread_m.T
    contact_z_m = geometry.contact_m[:, 2] + ordered.graph.middle[2]
    turned, contrast = ordered.is_turned[:, None], pairs.contrast / touch
    return table(
        shade[0],
        chroma,
        shade[0] / spread[0],
        chroma / np.sqrt(spread[1] * spread[1] + spread[2] * spread[2]),
        on[large, small],
        on[small, large],
        np.minimum(on[large], on[small]).sum(axis=1),
        pairs.meet / np.maximum(np.minimum(regions.outline[large], regions.outline[small]), 1.0),
        pairs.meet / np.maximum(regions.outline[small], 1.0),
        pairs.touch / across,
        pairs.touch / meet,
        pairs.lean / touch,
        pairs.concave / touch,
        pairs.parallel / touch,
        contrast,
        contrast / (np.maximum(grain[large], grain[small]) + 1),
        touch * pairs.step_m / np.maximum(pairs.sigma_m, 1e-4) / touch,
        np.where(away > 0.0, pairs.far_contrast / np.maximum(away, 1.0), np.nan),
        touch
        * np.sqrt(seam_x * seam_x + seam_y * seam_y)
        / np.minimum(extents.width_m[large], extents.width_m[small])
        / touch,
        touch * seam_z / np.minimum(extents.height_m[large], extents.height_m[small]) / touch,
        touch * (contact_z_m - extents.low_m[large]) / extents.height_m[large] / touch,
        touch * (contact_z_m - extents.low_m[small]) / extents.height_m[small] / touch,
        *(np.where(turned, ends[:, ::-1], ends).T / meet for ends in (pairs.nearer, pairs.above)),
        pairs.bridged.T / across,
        portable.log1p(gap_m / sigma_m),
        gap_m / np.maximum(extents.axes_m[small, 2], LEAST_M),
    )


def _lengths(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.sqrt(_products(vectors, vectors)))


def _products(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, z = (a * b).T
    return np.asarray(x + y + z)


def _volumes(sides: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(sides[:, 0] * sides[:, 1] * sides[:, 2])


def _variances(regions: Regions, per: NDArray[np.float64]) -> NDArray[np.float64]:
    means = regions.lab / per[:, None]
    return np.maximum(regions.lab_squares / per[:, None] - means * means, 0.0)


def _grain(regions: Regions) -> NDArray[np.float64]:
    return np.asarray(regions.grain[:, 0] / np.maximum(regions.grain[:, 1], 1.0))


def _signed_log(values: NDArray[np.float64]) -> NDArray[np.float64]:
    # Differences between large multiples of sigma matter little.
    return np.asarray(np.sign(values) * portable.log1p(np.abs(values)))
