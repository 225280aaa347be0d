"""How two parts of a frame look beside each other: the numbers from which trees tell whether they are one thing.

Of two parts, "large" is the one with more pixels and "small" the other one. Sizes are ratios, distances are multiples
of a size of the pair or of the standard deviation of depth, colours are differences: metres, heights above the floor,
pixels and colours as such tell which furniture the trees were grown on, and have names of their own (`sizes`). What
cannot be measured of a pair (the seam of parts that do not touch) is NaN.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry import portable
from hickory_stream.perception.bodies import LEAST_M, bodies_of, union_of
from hickory_stream.perception.features import Features, of_both
from hickory_stream.perception.pair_geometry import pair_geometry
from hickory_stream.perception.parts import grouped_pairs, grouped_parts
from hickory_stream.perception.sizes import size_features
from hickory_stream.perception.standing import standing_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.perception.bodies import Bodies
    from hickory_stream.perception.features import Makers
    from hickory_stream.perception.pair_geometry import PairGeometry
    from hickory_stream.perception.parts import Measures, Pairs, Parts
    from hickory_stream.perception.standing import Standing


def pair_features(measures: Measures, numbers: NDArray[np.int64], count: int) -> tuple[NDArray[np.int64], Features]:
    """Return the (K, 2) pairs of groups large and small, and by name (K,) how they look beside each other.

    `numbers` (n,) names the group 0..count - 1 of each fragment.
    """
    parts, pairs = grouped_parts(measures.parts, numbers, count), grouped_pairs(measures.pairs, numbers)
    standing = standing_of(measures.contacts, np.append(numbers, count), measures.heights_m, measures.level)
    is_turned = parts.pixels[pairs.a] < parts.pixels[pairs.b]
    large, small = np.where(is_turned, pairs.b, pairs.a), np.where(is_turned, pairs.a, pairs.b)
    bodies = bodies_of(parts, measures.bottom_m)
    union = union_of(parts, bodies, large, small)
    geometry = pair_geometry(parts, pairs, large, small)
    features = Features(
        {
            **of_both({**_shapes(parts, bodies), **_colors(parts), **_carried(standing)}, large, small),
            **_relations(parts, geometry, bodies, union, large, small),
            **_colors_of_pairs(parts, large, small),
            **_standing_of_pairs(standing, large, small),
            **_seams(pairs, parts, geometry, measures, bodies, union, large, small, is_turned),
            **size_features(measures, parts, pairs, geometry, bodies, union, large, small),
        }
    )
    return np.stack([large, small], axis=1), features


def _shapes(parts: Parts, bodies: Bodies) -> Makers:
    """Return how flat, slim, upright and level each part is, and how much of its outline the image cuts."""
    per = np.maximum(parts.pixels, 1)
    axes_m = np.maximum(bodies.axes_m, 1e-4)
    return {
        "in_plane": lambda: 1 - parts.planes[:, 0] / per,
        "level": lambda: parts.normals[:, 2] / per,
        "flat": lambda: np.linalg.norm(parts.normals, axis=1) / per,
        "thickness_sigmas": lambda: portable.log1p(axes_m[:, 0] / bodies.sigma_m),
        "thickness_of_breadth": lambda: axes_m[:, 0] / axes_m[:, 1],
        "breadth_of_length": lambda: axes_m[:, 1] / axes_m[:, 2],
        "height_of_width": lambda: bodies.height_m / (bodies.height_m + bodies.width_m),
        "filled": lambda: portable.log((parts.area_m2 + 1e-4) / (axes_m[:, 1] * axes_m[:, 2] + 1e-4)),
        "cut": lambda: parts.cut / np.maximum(parts.outline, 1),
        "rugged": lambda: parts.outline / np.sqrt(per),
    }


def _colors(parts: Parts) -> Makers:
    """Return how colour varies over each part: as a whole, and from one pixel to the next."""
    per = np.maximum(parts.pixels, 1)[:, None]
    mean = parts.lab / per
    spread = np.sqrt(np.maximum(parts.lab_squares / per - mean * mean, 0))
    return {
        "light_spread": lambda: spread[:, 0],
        "chroma_spread": lambda: portable.hypot(spread[:, 1], spread[:, 2]),
        "grain": lambda: parts.grain[:, 0] / np.maximum(parts.grain[:, 1], 1),
    }


def _colors_of_pairs(parts: Parts, large: NDArray[np.int64], small: NDArray[np.int64]) -> Makers:
    """Return how two parts differ in colour, in CIE Lab and in multiples of how much they vary."""
    per = np.maximum(parts.pixels, 1)[:, None]
    mean = parts.lab / per
    variance = np.maximum(parts.lab_squares / per - mean * mean, 0)
    shade, spread = np.abs(mean[small] - mean[large]), np.sqrt((variance[large] + variance[small]) / 2 + 1)
    return {
        "light_difference": lambda: shade[:, 0],
        "chroma_difference": lambda: portable.hypot(shade[:, 1], shade[:, 2]),
        "light_spreads": lambda: shade[:, 0] / spread[:, 0],
        "chroma_spreads": lambda: portable.hypot(shade[:, 1], shade[:, 2]) / portable.hypot(spread[:, 1], spread[:, 2]),
    }


def _carried(standing: Standing) -> Makers:
    """Return which share of each part's foot is on structure, on anything, and over nothing near."""
    foot = np.maximum(standing.outline, 1)
    return {
        "on_structure": lambda: standing.on[:, -1] / foot,
        "on_any": lambda: standing.on.sum(axis=1) / foot,
        "free": lambda: standing.free / foot,
    }


def _standing_of_pairs(standing: Standing, large: NDArray[np.int64], small: NDArray[np.int64]) -> Makers:
    """Return how much of either stands on the other, and of both on the same."""
    on = standing.on / np.maximum(standing.outline, 1)[:, None]
    return {
        "large_on_small": lambda: on[large, small],
        "small_on_large": lambda: on[small, large],
        "on_the_same": lambda: np.minimum(on[large], on[small]).sum(axis=1),
    }


def _relations(
    parts: Parts,
    geometry: PairGeometry,
    bodies: Bodies,
    union: Bodies,
    large: NDArray[np.int64],
    small: NDArray[np.int64],
) -> Makers:
    """Return how two parts lie to each other and what their union would be: ratios, angles, multiples of sigma.

    "Before" is the sine of the angle at which one part's middle lies over the other's plane: positive for both where
    they make a hollow, negative where they make an edge (the convexity of Stein et al. 2014).
    """
    normal = parts.normals / np.maximum(np.linalg.norm(parts.normals, axis=1), 1e-9)[:, None]
    most = parts.planes.argmax(axis=1)
    aside, overlap, inset = geometry.aside_m, geometry.overlap_m, geometry.inset_m
    away = np.maximum(np.sqrt((aside * aside).sum(axis=1)), 1e-4)
    over_large, over_small = (aside * normal[large]).sum(axis=1), -(aside * normal[small]).sum(axis=1)
    sides = np.maximum(parts.high - parts.low, LEAST_M)
    foot = np.clip(overlap[:, :2], 0, None).prod(axis=1) / np.maximum(sides[small, 0] * sides[small, 1], 1e-4)
    volume = np.prod(sides + LEAST_M, axis=1)
    joined = np.prod(union.box_high_m - union.box_low_m + 2 * LEAST_M, axis=1)
    axes_m, own_m = np.maximum(union.axes_m, 1e-4), np.maximum(bodies.axes_m, 1e-4)
    thickness = np.maximum(own_m[large, 0], own_m[small, 0])
    height_m = union.height_m
    return {
        "pixels_ratio": lambda: portable.log(np.maximum(parts.pixels[small], 1) / np.maximum(parts.pixels[large], 1)),
        "area_ratio": lambda: portable.log((parts.area_m2[small] + 1e-4) / (parts.area_m2[large] + 1e-4)),
        "width_ratio": lambda: portable.log(bodies.width_m[small] / bodies.width_m[large]),
        "height_ratio": lambda: portable.log(bodies.height_m[small] / bodies.height_m[large]),
        "length_ratio": lambda: portable.log(own_m[small, 2] / own_m[large, 2]),
        "parallel": lambda: (normal[large] * normal[small]).sum(axis=1),
        "same_plane": lambda: ((most[large] == most[small]) & (most[large] > 0)).astype(np.float64),
        "before_large": lambda: over_large / away,
        "before_small": lambda: over_small / away,
        "before_large_sigmas": lambda: _signed_log(over_large / union.sigma_m),
        "before_small_sigmas": lambda: _signed_log(over_small / union.sigma_m),
        "aside": lambda: portable.hypot(aside[:, 0], aside[:, 1]) / union.width_m,
        "higher": lambda: aside[:, 2] / height_m,
        "lows": lambda: (bodies.low_m[small] - bodies.low_m[large]) / height_m,
        "highs": lambda: (bodies.high_m[small] - bodies.high_m[large]) / height_m,
        "small_over_large": lambda: (bodies.low_m[small] - bodies.high_m[large]) / height_m,
        "large_over_small": lambda: (bodies.low_m[large] - bodies.high_m[small]) / height_m,
        "lows_sigmas": lambda: _signed_log((bodies.low_m[small] - bodies.low_m[large]) / union.sigma_m),
        "highs_sigmas": lambda: _signed_log((bodies.high_m[small] - bodies.high_m[large]) / union.sigma_m),
        "overlap_sideways": lambda: (overlap / sides[small])[:, :2].min(axis=1),
        "overlap_upright": lambda: overlap[:, 2] / sides[small, 2],
        "overlap_foot": lambda: np.minimum(foot, 1.5),
        "inset": lambda: (inset / sides[large])[:, :2].min(axis=1),
        "inset_sigmas": lambda: _signed_log(inset[:, :2].min(axis=1) / union.sigma_m),
        "joined_width": lambda: portable.log(union.width_m / bodies.width_m[large]),
        "joined_height": lambda: portable.log(height_m / bodies.height_m[large]),
        "joined_height_of_width": lambda: height_m / (height_m + union.width_m),
        "joined_volume": lambda: portable.log(joined / (volume[large] + volume[small])),
        "joined_thickness_of_breadth": lambda: axes_m[:, 0] / axes_m[:, 1],
        "joined_breadth_of_length": lambda: axes_m[:, 1] / axes_m[:, 2],
        "joined_length": lambda: portable.log(axes_m[:, 2] / own_m[large, 2]),
        "thicker": lambda: portable.log(axes_m[:, 0] / thickness),
        "thicker_sigmas": lambda: _signed_log((axes_m[:, 0] - thickness) / union.sigma_m),
    }


def _signed_log(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return log(1 + |x|) with the sign of x: what is many sigmas is many, however many."""
    return np.asarray(np.sign(values) * portable.log1p(np.abs(values)))


def _seams(
    pairs: Pairs,
    parts: Parts,
    geometry: PairGeometry,
    measures: Measures,
    bodies: Bodies,
    union: Bodies,
    large: NDArray[np.int64],
    small: NDArray[np.int64],
    is_turned: NDArray[np.bool_],
) -> Makers:
    """Return how two parts meet: how much of their outlines, how sharply, where, and which is before the other."""
    meet, touch = np.maximum(pairs.meet, 1), np.maximum(pairs.touch, 1)

    def of_meeting(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(pairs.meet > 0, values / meet, np.nan)

    def of_touching(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(pairs.touch > 0, values / touch, np.nan)

    nearer, above = (np.where(is_turned[:, None], v[:, ::-1], v) for v in (pairs.nearer, pairs.above))
    at_m, spread = geometry.seam_m[:, 2] + measures.middle[2], geometry.seam_spread_m
    away = pairs.meet - pairs.touch
    grain = parts.grain[:, 0] / np.maximum(parts.grain[:, 1], 1)
    width_m = np.minimum(bodies.width_m[large], bodies.width_m[small])
    height_m = np.minimum(bodies.height_m[large], bodies.height_m[small])
    across = np.sqrt(np.maximum(parts.pixels[small], 1))
    gap_m = np.where(np.isfinite(pairs.gap_m), pairs.gap_m, np.nan)
    return {
        "meet_of_lesser": lambda: pairs.meet / np.maximum(np.minimum(parts.outline[large], parts.outline[small]), 1),
        "meet_of_small": lambda: pairs.meet / np.maximum(parts.outline[small], 1),
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
        "seam_in_large": lambda: of_touching(touch * (at_m - bodies.low_m[large]) / bodies.height_m[large]),
        "seam_in_small": lambda: of_touching(touch * (at_m - bodies.low_m[small]) / bodies.height_m[small]),
        "large_nearer": lambda: of_meeting(nearer[:, 0]),
        "small_nearer": lambda: of_meeting(nearer[:, 1]),
        "large_above": lambda: of_meeting(above[:, 0]),
        "small_above": lambda: of_meeting(above[:, 1]),
        "bridged_level_share": lambda: pairs.bridged[:, 0] / across,
        "bridged_upright_share": lambda: pairs.bridged[:, 1] / across,
        "gap_sigmas": lambda: portable.log1p(gap_m / union.sigma_m),
        "gap_of_small": lambda: gap_m / np.maximum(bodies.axes_m[small, 2], LEAST_M),
    }
