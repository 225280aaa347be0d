"""Absolute features of pairs of regions: metres, pixels and colours.

They help in rooms with furniture of the size in the training data. `pair_features` has relative features for others.
"""

import numpy as np

from hickory_stream.geometry import portable
from hickory_stream.perception.regions.features import Features, of_both, table
from hickory_stream.perception.regions.ordered_pairs import OrderedPairs

_FAR_M = 0.3
_OF_REGIONS = (
    *("pixels", "area_m2", "depth_m", "width_m", "thickness_m", "breadth_m", "length_m", "members", "light", "chroma"),
    *("height_m", "low_m", "high_m"),
)
_OF_PAIRS = (
    *("aside_m", "higher_m", "lows_m", "highs_m", "small_over_large_m", "large_over_small_m", "overlap_sideways_m"),
    *("overlap_upright_m", "inset_m", "joined_width_m", "joined_height_m", "joined_volume_m3", "joined_thickness_m"),
    *("joined_breadth_m", "thicker_m", "touch", "seam_step_m", "seam_width_m", "seam_height_m", "gap_m"),
    *("bridged_level", "bridged_upright"),
)


def absolute_features(ordered: OrderedPairs) -> tuple[Features, Features]:
    """Return the sizes of the regions `large` and `small` of each pair, and their relative position."""
    regions, extents, union = ordered.regions, ordered.extents, ordered.union
    geometry, pairs, large, small = ordered.geometry, ordered.pairs, ordered.large, ordered.small
    per, floor_z_m = np.maximum(regions.pixels, 1.0), ordered.graph.floor_z_m
    light, green, blue = regions.lab.T / per
    wide, deep, tall = (regions.high - regions.low).T
    of_regions = table(
        portable.log(per),
        portable.log(regions.area_m2 + 1e-4),
        regions.depth_m / per,
        portable.hypot(wide, deep),
        extents.axes_m.T,
        regions.members,
        light,
        portable.hypot(green, blue),
        extents.high_m - extents.low_m,
        extents.low_m - floor_z_m,
        extents.high_m - floor_z_m,
    )
    volumes = (wide + 0.01) * (deep + 0.01) * (tall + 0.01)
    low_large, low_small = extents.low_m[large], extents.low_m[small]
    high_large, high_small = extents.high_m[large], extents.high_m[small]
    aside, overlap, inset, spread = geometry.aside_m, geometry.overlap_m, geometry.inset_m, geometry.contact_spread_m
    wide, deep, tall = (union.box_high_m - union.box_low_m).T
    joined = (wide + 0.01) * (deep + 0.01) * (tall + 0.01)
    # NaN where they do not touch.
    if_touching = np.where(pairs.touch > 0.0, 0.0, np.nan)
    of_pairs = table(
        portable.hypot(aside[:, 0], aside[:, 1]),
        aside[:, 2],
        low_small - low_large,
        high_small - high_large,
        low_small - high_large,
        low_large - high_small,
        np.minimum(overlap[:, 0], overlap[:, 1]),
        overlap[:, 2],
        np.minimum(inset[:, 0], inset[:, 1]),
        portable.hypot(wide, deep),
        union.high_m - union.low_m,
        portable.log(joined / (volumes[large] + volumes[small])),
        union.axes_m[:, 0],
        union.axes_m[:, 1],
        union.axes_m[:, 0] - np.maximum(extents.axes_m[large, 0], extents.axes_m[small, 0]),
        portable.log1p(pairs.touch),
        pairs.step_m / np.maximum(pairs.touch, 1.0) + if_touching,
        portable.hypot(spread[:, 0], spread[:, 1]) + if_touching,
        spread[:, 2] + if_touching,
        np.minimum(pairs.gap_m, _FAR_M),
        pairs.bridged.T,
    )
    return of_both(_OF_REGIONS, of_regions, large, small), Features(_OF_PAIRS, of_pairs)
