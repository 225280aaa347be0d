"""Relative features of pairs of regions, from which boosted trees estimate whether the two are one object.

Of two regions, "large" has more pixels. Sizes are ratios; distances are multiples of a size of the pair or of the
standard deviation of depth; undefined values are NaN. Kernels fill in all features row by row, since a NumPy call for
each of them takes longer than its arithmetic.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.portable_kernels import log, log1p
from hickory_stream.perception.regions.absolute_features import absolute_features
from hickory_stream.perception.regions.features import Features, joined, of_both
from hickory_stream.perception.regions.ordered_pairs import OrderedPairs, ordered_pairs
from hickory_stream.perception.regions.region_extents import LEAST_M
from hickory_stream.perception.regions.region_graph import RegionGraph

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
_JOINED = _RELATIONS.index("joined_width")
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
    out = np.empty((len(regions.pixels), len(_OF_REGIONS)))
    _fill_regions(
        out,
        (regions.pixels, regions.area_m2, regions.outline, regions.cut),
        (regions.planes, regions.normals, regions.lab, regions.lab_squares, regions.grain),
        (extents.axes_m, extents.width_m, extents.height_m, extents.sigma_m),
        (support.outline, support.free, support.on),
    )
    return out


def _relations(ordered: OrderedPairs) -> NDArray[np.float64]:
    regions, extents, union, geometry = ordered.regions, ordered.extents, ordered.union, ordered.geometry
    out = np.empty((len(ordered.large), len(_RELATIONS)))
    _fill_relations(
        out,
        ordered.large,
        ordered.small,
        (regions.pixels, regions.area_m2, regions.planes, regions.normals, regions.low, regions.high),
        (extents.axes_m, extents.width_m, extents.height_m, extents.low_m, extents.high_m),
        (union.axes_m, union.width_m, union.height_m, union.sigma_m, union.box_low_m, union.box_high_m),
        (geometry.aside_m, geometry.overlap_m, geometry.inset_m),
    )
    return out


def _contacts(ordered: OrderedPairs) -> NDArray[np.float64]:
    regions, extents, support, pairs = ordered.regions, ordered.extents, ordered.support, ordered.pairs
    large, small = ordered.large, ordered.small
    on = support.on / np.maximum(support.outline, 1)[:, None]
    out = np.empty((len(large), len(_CONTACTS)))
    _fill_contacts(
        out,
        large,
        small,
        ordered.is_turned,
        (regions.pixels, regions.outline, regions.lab, regions.lab_squares, regions.grain),
        (extents.axes_m, extents.width_m, extents.height_m, extents.low_m),
        (on, np.minimum(on[large], on[small]).sum(axis=1)),
        (pairs.meet, pairs.touch, pairs.lean, pairs.concave, pairs.parallel, pairs.contrast, pairs.far_contrast),
        (pairs.step_m, pairs.sigma_m, pairs.nearer, pairs.above, pairs.bridged, pairs.gap_m),
        ordered.geometry.contact_m[:, 2] + ordered.graph.middle[2],
        ordered.geometry.contact_spread_m,
        ordered.union.sigma_m,
    )
    return out


@kernel(error_model="numpy")
def _fill_regions(out, sizes, sums, extents, support):
    pixels, area_m2, outline, cut = sizes
    planes, normals, lab, lab_squares, grain = sums
    axes_m, width_m, height_m, sigma_m = extents
    foot_outline, free, on = support
    for i in range(len(out)):
        per, foot = max(pixels[i], 1.0), max(foot_outline[i], 1)
        thickness, breadth, length = max(axes_m[i, 0], 1e-4), max(axes_m[i, 1], 1e-4), max(axes_m[i, 2], 1e-4)
        green = np.sqrt(_variance(lab, lab_squares, i, 1, per))
        blue = np.sqrt(_variance(lab, lab_squares, i, 2, per))
        out[i, :] = (
            1 - planes[i, 0] / per,
            normals[i, 2] / per,
            _length(normals[i]) / per,
            log1p(thickness / sigma_m[i]),
            thickness / breadth,
            breadth / length,
            height_m[i] / (height_m[i] + width_m[i]),
            log((area_m2[i] + 1e-4) / (breadth * length + 1e-4)),
            cut[i] / max(outline[i], 1.0),
            outline[i] / np.sqrt(per),
            np.sqrt(_variance(lab, lab_squares, i, 0, per)),
            np.sqrt(green * green + blue * blue),
            grain[i, 0] / max(grain[i, 1], 1.0),
            on[i, -1] / foot,
            on[i].sum() / foot,
            free[i] / foot,
        )


@kernel(error_model="numpy")
def _fill_relations(out, larges, smalls, regions, extents, union, geometry):
    pixels, area_m2, planes, normals, low, high = regions
    axes_m, width_m, height_m, low_m, high_m = extents
    union_axes_m, union_width_m, union_height_m, union_sigma_m, box_low_m, box_high_m = union
    asides_m, overlaps_m, insets_m = geometry
    sides, joined_sides = np.empty((2, 3)), np.empty(3)
    for k in range(len(out)):
        large, small = larges[k], smalls[k]
        aside, overlap, inset = asides_m[k], overlaps_m[k], insets_m[k]
        sigma_m, whole_width, whole_height = union_sigma_m[k], union_width_m[k], union_height_m[k]
        per_large = max(_length(normals[large]), 1e-9)
        per_small = max(_length(normals[small]), 1e-9)
        over_large, over_small, parallel = 0.0, 0.0, 0.0
        for i in range(3):
            n_large, n_small = normals[large, i] / per_large, normals[small, i] / per_small
            over_large += aside[i] * n_large
            over_small += aside[i] * n_small
            parallel += n_large * n_small
            sides[0, i] = max(high[large, i] - low[large, i], LEAST_M)
            sides[1, i] = max(high[small, i] - low[small, i], LEAST_M)
            joined_sides[i] = box_high_m[k, i] - box_low_m[k, i] + 2 * LEAST_M
        over_small = -over_small
        away = max(_length(aside), 1e-4)
        most = np.argmax(planes[large])
        foot = max(overlap[0], 0.0) * max(overlap[1], 0.0) / max(sides[1, 0] * sides[1, 1], 1e-4)
        volumes = _volume(sides[0], LEAST_M) + _volume(sides[1], LEAST_M)
        joined = joined_sides[0] * joined_sides[1] * joined_sides[2]
        thickness = max(max(axes_m[large, 0], 1e-4), max(axes_m[small, 0], 1e-4))
        thin, broad, long = max(union_axes_m[k, 0], 1e-4), max(union_axes_m[k, 1], 1e-4), max(union_axes_m[k, 2], 1e-4)
        long_large, long_small = max(axes_m[large, 2], 1e-4), max(axes_m[small, 2], 1e-4)
        lows, highs = low_m[small] - low_m[large], high_m[small] - high_m[large]
        least_inset = min(inset[0], inset[1])
        out[k, :_JOINED] = (
            log(max(pixels[small], 1.0) / max(pixels[large], 1.0)),
            log((area_m2[small] + 1e-4) / (area_m2[large] + 1e-4)),
            log(width_m[small] / width_m[large]),
            log(height_m[small] / height_m[large]),
            log(long_small / long_large),
            parallel,
            1.0 if most > 0 and most == np.argmax(planes[small]) else 0.0,
            over_large / away,
            over_small / away,
            _signed_log(over_large / sigma_m),
            _signed_log(over_small / sigma_m),
            np.sqrt(aside[0] * aside[0] + aside[1] * aside[1]) / whole_width,
            aside[2] / whole_height,
            lows / whole_height,
            highs / whole_height,
            (low_m[small] - high_m[large]) / whole_height,
            (low_m[large] - high_m[small]) / whole_height,
            _signed_log(lows / sigma_m),
            _signed_log(highs / sigma_m),
            min(overlap[0] / sides[1, 0], overlap[1] / sides[1, 1]),
            overlap[2] / sides[1, 2],
            min(foot, 1.5),
            min(inset[0] / sides[0, 0], inset[1] / sides[0, 1]),
            _signed_log(least_inset / sigma_m),
        )
        # In two parts: the compiler knows no longer tuples.
        out[k, _JOINED:] = (
            log(whole_width / width_m[large]),
            log(whole_height / height_m[large]),
            whole_height / (whole_height + whole_width),
            log(joined / volumes),
            thin / broad,
            broad / long,
            log(long / long_large),
            log(thin / thickness),
            _signed_log((thin - thickness) / sigma_m),
        )


@kernel(error_model="numpy")
def _fill_contacts(
    out, larges, smalls, turned, regions, extents, support, seams, places, contact_z_m, spread_m, sigma_m
):
    pixels, outline, lab, lab_squares, grain = regions
    axes_m, width_m, height_m, low_m = extents
    on, on_the_same = support
    all_meet, all_touch, lean, concave, parallel, contrast, far_contrast = seams
    step_m, seam_sigma_m, nearer, above, bridged, gaps_m = places
    shade, spread = np.empty(3), np.empty(3)
    for k in range(len(out)):
        large, small = larges[k], smalls[k]
        first, second = (1, 0) if turned[k] else (0, 1)
        per_large, per_small = max(pixels[large], 1.0), max(pixels[small], 1.0)
        for i in range(3):
            shade[i] = abs(lab[small, i] / per_small - lab[large, i] / per_large)
            variances = _variance(lab, lab_squares, large, i, per_large) + _variance(
                lab, lab_squares, small, i, per_small
            )
            spread[i] = np.sqrt(variances / 2 + 1)
        chroma = np.sqrt(shade[1] * shade[1] + shade[2] * shade[2])
        # NaN where they do not meet, or touch.
        meet = all_meet[k] if all_meet[k] >= 1.0 else (1.0 if all_meet[k] > 0.0 else np.nan)
        touch = all_touch[k] if all_touch[k] >= 1.0 else (1.0 if all_touch[k] > 0.0 else np.nan)
        away = all_meet[k] - all_touch[k]
        grain_large = grain[large, 0] / max(grain[large, 1], 1.0)
        grain_small = grain[small, 0] / max(grain[small, 1], 1.0)
        across = np.sqrt(per_small)
        gap_m = gaps_m[k] if np.isfinite(gaps_m[k]) else np.nan
        wide = np.sqrt(spread_m[k, 0] * spread_m[k, 0] + spread_m[k, 1] * spread_m[k, 1])
        out[k, :] = (
            shade[0],
            chroma,
            shade[0] / spread[0],
            chroma / np.sqrt(spread[1] * spread[1] + spread[2] * spread[2]),
            on[large, small],
            on[small, large],
            on_the_same[k],
            all_meet[k] / max(min(outline[large], outline[small]), 1.0),
            all_meet[k] / max(outline[small], 1.0),
            all_touch[k] / across,
            all_touch[k] / meet,
            lean[k] / touch,
            concave[k] / touch,
            parallel[k] / touch,
            contrast[k] / touch,
            contrast[k] / touch / (max(grain_large, grain_small) + 1),
            touch * step_m[k] / max(seam_sigma_m[k], 1e-4) / touch,
            far_contrast[k] / max(away, 1.0) if away > 0.0 else np.nan,
            touch * wide / min(width_m[large], width_m[small]) / touch,
            touch * spread_m[k, 2] / min(height_m[large], height_m[small]) / touch,
            touch * (contact_z_m[k] - low_m[large]) / height_m[large] / touch,
            touch * (contact_z_m[k] - low_m[small]) / height_m[small] / touch,
            nearer[k, first] / meet,
            nearer[k, second] / meet,
            above[k, first] / meet,
            above[k, second] / meet,
            bridged[k, 0] / across,
            bridged[k, 1] / across,
            log1p(gap_m / sigma_m[k]),
            gap_m / max(axes_m[small, 2], LEAST_M),
        )


@kernel
def _length(vector):
    return np.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])


@kernel
def _volume(sides, more):
    return (sides[0] + more) * (sides[1] + more) * (sides[2] + more)


@kernel
def _variance(sums, squares, region, channel, count):
    mean = sums[region, channel] / count
    return max(squares[region, channel] / count - mean * mean, 0.0)


@kernel
def _signed_log(value):
    # Differences between large multiples of sigma matter little.
    return np.sign(value) * log1p(abs(value))
