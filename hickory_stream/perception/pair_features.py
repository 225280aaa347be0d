"""Features of pairs of regions, from which boosted trees estimate whether the two are one object.

Of two regions, "large" is the one with more pixels and "small" the other. These features are relative: sizes are
ratios, distances are multiples of a size of the pair or of the standard deviation of depth, colours are differences.
Absolute metres, heights, pixels and colours depend on the furniture of the training data; they are separate features
(`absolute_features`). What is undefined for a pair (the contact of regions that do not touch) is NaN.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry import portable
from hickory_stream.perception.absolute_features import absolute_features
from hickory_stream.perception.features import Features, of_both
from hickory_stream.perception.ordered_pairs import ordered_pairs
from hickory_stream.perception.region_extents import LEAST_M

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.perception.features import Makers
    from hickory_stream.perception.ordered_pairs import OrderedPairs
    from hickory_stream.perception.region_extents import Extents
    from hickory_stream.perception.region_graph import RegionGraph, Regions
    from hickory_stream.perception.support_contacts import SupportContacts


def pair_features(graph: RegionGraph, numbers: NDArray[np.int64], count: int) -> tuple[NDArray[np.int64], Features]:
    """Return the (K, 2) pairs of merged regions, large and small, and their features (K,) by name.

    `numbers` (n,) gives the merged region 0..count - 1 of each fragment.
    """
    ordered = ordered_pairs(graph, numbers, count)
    regions, large, small = ordered.regions, ordered.large, ordered.small
    of_regions = {**_shapes(regions, ordered.extents), **_colors(regions), **_support_features(ordered.support)}
    features = Features(
        {
            **of_both(of_regions, large, small),
            **_relations(ordered),
            **_colors_of_pairs(regions, large, small),
            **_mutual_support_features(ordered.support, large, small),
            **_contact_features(ordered),
            **absolute_features(ordered),
        }
    )
    return np.stack([large, small], axis=1), features


def _shapes(regions: Regions, extents: Extents) -> Makers:
    """Return the shape of each region: flatness, slenderness, orientation, and the share of its outline cut off."""
    per = np.maximum(regions.pixels, 1)
    axes_m = np.maximum(extents.axes_m, 1e-4)
    return {
        "in_plane": lambda: 1 - regions.planes[:, 0] / per,
        "level": lambda: regions.normals[:, 2] / per,
        "flat": lambda: np.linalg.norm(regions.normals, axis=1) / per,
        "thickness_sigmas": lambda: portable.log1p(axes_m[:, 0] / extents.sigma_m),
        "thickness_of_breadth": lambda: axes_m[:, 0] / axes_m[:, 1],
        "breadth_of_length": lambda: axes_m[:, 1] / axes_m[:, 2],
        "height_of_width": lambda: extents.height_m / (extents.height_m + extents.width_m),
        "filled": lambda: portable.log((regions.area_m2 + 1e-4) / (axes_m[:, 1] * axes_m[:, 2] + 1e-4)),
        "cut": lambda: regions.cut / np.maximum(regions.outline, 1),
        "rugged": lambda: regions.outline / np.sqrt(per),
    }


def _colors(regions: Regions) -> Makers:
    """Return the colour variation of each region: overall, and between neighbouring pixels."""
    per = np.maximum(regions.pixels, 1)[:, None]
    mean = regions.lab / per
    spread = np.sqrt(np.maximum(regions.lab_squares / per - mean * mean, 0))
    return {
        "light_spread": lambda: spread[:, 0],
        "chroma_spread": lambda: portable.hypot(spread[:, 1], spread[:, 2]),
        "grain": lambda: regions.grain[:, 0] / np.maximum(regions.grain[:, 1], 1),
    }


def _colors_of_pairs(regions: Regions, large: NDArray[np.int64], small: NDArray[np.int64]) -> Makers:
    """Return the colour difference of two regions, in CIE Lab and in multiples of their standard deviation."""
    per = np.maximum(regions.pixels, 1)[:, None]
    mean = regions.lab / per
    variance = np.maximum(regions.lab_squares / per - mean * mean, 0)
    shade, spread = np.abs(mean[small] - mean[large]), np.sqrt((variance[large] + variance[small]) / 2 + 1)
    return {
        "light_difference": lambda: shade[:, 0],
        "chroma_difference": lambda: portable.hypot(shade[:, 1], shade[:, 2]),
        "light_spreads": lambda: shade[:, 0] / spread[:, 0],
        "chroma_spreads": lambda: portable.hypot(shade[:, 1], shade[:, 2]) / portable.hypot(spread[:, 1], spread[:, 2]),
    }


def _support_features(support: SupportContacts) -> Makers:
    """Return the share of each region's foot that rests on structure, on anything, and that is unsupported."""
    foot = np.maximum(support.outline, 1)
    return {
        "on_structure": lambda: support.on[:, -1] / foot,
        "on_any": lambda: support.on.sum(axis=1) / foot,
        "free": lambda: support.free / foot,
    }


def _mutual_support_features(support: SupportContacts, large: NDArray[np.int64], small: NDArray[np.int64]) -> Makers:
    """Return how much of either region rests on the other, and of both on the same support."""
    on = support.on / np.maximum(support.outline, 1)[:, None]
    return {
        "large_on_small": lambda: on[large, small],
        "small_on_large": lambda: on[small, large],
        "on_the_same": lambda: np.minimum(on[large], on[small]).sum(axis=1),
    }


def _relations(ordered: OrderedPairs) -> Makers:
    """Return relative poses and the shape of the union of two regions: ratios, angles, multiples of sigma.

    The features "before" are the sine of the elevation of one region's centroid over the other's plane: positive for
    both regions of a concave pair, negative for both of a convex one (Stein et al. 2014).
    """
    regions, extents, union, geometry = ordered.regions, ordered.extents, ordered.union, ordered.geometry
    large, small = ordered.large, ordered.small
    normal = regions.normals / np.maximum(np.linalg.norm(regions.normals, axis=1), 1e-9)[:, None]
    most = regions.planes.argmax(axis=1)
    aside, overlap, inset = geometry.aside_m, geometry.overlap_m, geometry.inset_m
    away = np.maximum(np.sqrt((aside * aside).sum(axis=1)), 1e-4)
    over_large, over_small = (aside * normal[large]).sum(axis=1), -(aside * normal[small]).sum(axis=1)
    sides = np.maximum(regions.high - regions.low, LEAST_M)
    foot = np.clip(overlap[:, :2], 0, None).prod(axis=1) / np.maximum(sides[small, 0] * sides[small, 1], 1e-4)
    volume = np.prod(sides + LEAST_M, axis=1)
    joined = np.prod(union.box_high_m - union.box_low_m + 2 * LEAST_M, axis=1)
    axes_m, own_m = np.maximum(union.axes_m, 1e-4), np.maximum(extents.axes_m, 1e-4)
    thickness = np.maximum(own_m[large, 0], own_m[small, 0])
    height_m = union.height_m
    return {
        "pixels_ratio": lambda: portable.log(
            np.maximum(regions.pixels[small], 1) / np.maximum(regions.pixels[large], 1)
        ),
        "area_ratio": lambda: portable.log((regions.area_m2[small] + 1e-4) / (regions.area_m2[large] + 1e-4)),
        "width_ratio": lambda: portable.log(extents.width_m[small] / extents.width_m[large]),
        "height_ratio": lambda: portable.log(extents.height_m[small] / extents.height_m[large]),
        "length_ratio": lambda: portable.log(own_m[small, 2] / own_m[large, 2]),
        "parallel": lambda: (normal[large] * normal[small]).sum(axis=1),
        "same_plane": lambda: ((most[large] == most[small]) & (most[large] > 0)).astype(np.float64),
        "before_large": lambda: over_large / away,
        "before_small": lambda: over_small / away,
        "before_large_sigmas": lambda: _signed_log(over_large / union.sigma_m),
        "before_small_sigmas": lambda: _signed_log(over_small / union.sigma_m),
        "aside": lambda: portable.hypot(aside[:, 0], aside[:, 1]) / union.width_m,
        "higher": lambda: aside[:, 2] / height_m,
        "lows": lambda: (extents.low_m[small] - extents.low_m[large]) / height_m,
        "highs": lambda: (extents.high_m[small] - extents.high_m[large]) / height_m,
        "small_over_large": lambda: (extents.low_m[small] - extents.high_m[large]) / height_m,
        "large_over_small": lambda: (extents.low_m[large] - extents.high_m[small]) / height_m,
        "lows_sigmas": lambda: _signed_log((extents.low_m[small] - extents.low_m[large]) / union.sigma_m),
        "highs_sigmas": lambda: _signed_log((extents.high_m[small] - extents.high_m[large]) / union.sigma_m),
        "overlap_sideways": lambda: (overlap / sides[small])[:, :2].min(axis=1),
        "overlap_upright": lambda: overlap[:, 2] / sides[small, 2],
        "overlap_foot": lambda: np.minimum(foot, 1.5),
        "inset": lambda: (inset / sides[large])[:, :2].min(axis=1),
        "inset_sigmas": lambda: _signed_log(inset[:, :2].min(axis=1) / union.sigma_m),
        "joined_width": lambda: portable.log(union.width_m / extents.width_m[large]),
        "joined_height": lambda: portable.log(height_m / extents.height_m[large]),
        "joined_height_of_width": lambda: height_m / (height_m + union.width_m),
        "joined_volume": lambda: portable.log(joined / (volume[large] + volume[small])),
        "joined_thickness_of_breadth": lambda: axes_m[:, 0] / axes_m[:, 1],
        "joined_breadth_of_length": lambda: axes_m[:, 1] / axes_m[:, 2],
        "joined_length": lambda: portable.log(axes_m[:, 2] / own_m[large, 2]),
        "thicker": lambda: portable.log(axes_m[:, 0] / thickness),
        "thicker_sigmas": lambda: _signed_log((axes_m[:, 0] - thickness) / union.sigma_m),
    }


def _signed_log(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return log(1 + |x|) with the sign of x: differences between large multiples of sigma matter little."""
    return np.asarray(np.sign(values) * portable.log1p(np.abs(values)))


def _contact_features(ordered: OrderedPairs) -> Makers:
    """Return the contact of two regions: its length, sharpness and place, and which region occludes the other."""
    pairs, regions, geometry = ordered.pairs, ordered.regions, ordered.geometry
    extents, union, large, small = ordered.extents, ordered.union, ordered.large, ordered.small
    meet, touch = np.maximum(pairs.meet, 1), np.maximum(pairs.touch, 1)

    def of_meeting(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(pairs.meet > 0, values / meet, np.nan)

    def of_touching(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(pairs.touch > 0, values / touch, np.nan)

    nearer, above = (np.where(ordered.is_turned[:, None], v[:, ::-1], v) for v in (pairs.nearer, pairs.above))
    at_m, spread = geometry.contact_m[:, 2] + ordered.graph.middle[2], geometry.contact_spread_m
    away = pairs.meet - pairs.touch
    grain = regions.grain[:, 0] / np.maximum(regions.grain[:, 1], 1)
    width_m = np.minimum(extents.width_m[large], extents.width_m[small])
    height_m = np.minimum(extents.height_m[large], extents.height_m[small])
    across = np.sqrt(np.maximum(regions.pixels[small], 1))
    gap_m = np.where(np.isfinite(pairs.gap_m), pairs.gap_m, np.nan)
    return {
        "meet_of_lesser": lambda: (
            pairs.meet / np.maximum(np.minimum(regions.outline[large], regions.outline[small]), 1)
        ),
        "meet_of_small": lambda: pairs.meet / np.maximum(regions.outline[small], 1),
        "touch_of_size": lambda: pairs.touch / across,
        "touch_share": lambda: of_meeting(pairs.touch),
        "lean": lambda: of_touching(pairs.lean),
        "concave": lambda: of_touching(pairs.concave),
        "seam_parallel": lambda: of_touching(pairs.parallel),
        "seam_contrast": lambda: of_touching(pairs.contrast),
        "seam_grains": lambda: of_touching(pairs.contrast) / (np.maximum(grain[large], grain[small]) + 1),
        "seam_step_sigmas": lambda: of_touching(touch * pairs.step_m / np.maximum(pairs.sigma_m, 1e-4)),
        "far_contrast": lambda: np.where(away > 0, pairs.far_contrast / np.maximum(away, 1), np.nan),
        "seam_width": lambda: of_touching(touch * portable.hypot(spread[:, 0], spread[:, 1]) / width_m),
        "seam_height": lambda: of_touching(touch * spread[:, 2] / height_m),
        "seam_in_large": lambda: of_touching(touch * (at_m - extents.low_m[large]) / extents.height_m[large]),
        "seam_in_small": lambda: of_touching(touch * (at_m - extents.low_m[small]) / extents.height_m[small]),
        "large_nearer": lambda: of_meeting(nearer[:, 0]),
        "small_nearer": lambda: of_meeting(nearer[:, 1]),
        "large_above": lambda: of_meeting(above[:, 0]),
        "small_above": lambda: of_meeting(above[:, 1]),
        "bridged_level_share": lambda: pairs.bridged[:, 0] / across,
        "bridged_upright_share": lambda: pairs.bridged[:, 1] / across,
        "gap_sigmas": lambda: portable.log1p(gap_m / union.sigma_m),
        "gap_of_small": lambda: gap_m / np.maximum(extents.axes_m[small, 2], LEAST_M),
    }
