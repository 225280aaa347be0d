"""Absolute features of pairs of regions: metres, pixels and colours.

They help in rooms with furniture of the size in the training data. `pair_features` has relative features for others.
"""

from __future__ import annotations

import numpy as np

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.portable_kernels import log, log1p
from hickory_stream.perception.regions.features import Features, of_both
from hickory_stream.perception.regions.ordered_pairs import OrderedPairs

_FAR_M = 0.3
_UNITS = ("_m", "_m2", "_m3")
_OTHERS = ("_pixels", "_members", "_light", "_chroma")
_COUNTS = ("touch", "bridged_level", "bridged_upright")
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


def is_size(name: str) -> bool:
    """Return whether a feature of this name is one of `absolute_features`."""
    return name.endswith((*_UNITS, *_OTHERS)) or name in _COUNTS


def absolute_features(ordered: OrderedPairs) -> tuple[Features, Features]:
    """Return the sizes of the regions `large` and `small` of each pair, and their relative position."""
    regions, extents, union = ordered.regions, ordered.extents, ordered.union
    geometry, pairs, large, small = ordered.geometry, ordered.pairs, ordered.large, ordered.small
    of_regions = np.empty((len(regions.pixels), len(_OF_REGIONS)))
    _fill_regions(
        of_regions,
        (regions.pixels, regions.area_m2, regions.depth_m, regions.members, regions.lab, regions.low, regions.high),
        (extents.axes_m, extents.low_m, extents.high_m),
        ordered.graph.floor_z_m,
    )
    of_pairs = np.empty((len(large), len(_OF_PAIRS)))
    _fill_pairs(
        of_pairs,
        large,
        small,
        (regions.low, regions.high),
        (extents.axes_m, extents.low_m, extents.high_m),
        (union.axes_m, union.low_m, union.high_m, union.box_low_m, union.box_high_m),
        (geometry.aside_m, geometry.overlap_m, geometry.inset_m, geometry.contact_spread_m),
        (pairs.touch, pairs.step_m, pairs.gap_m, pairs.bridged),
    )
    return of_both(_OF_REGIONS, of_regions, large, small), Features(_OF_PAIRS, of_pairs)


@kernel(error_model="numpy")
def _fill_regions(out, sums, extents, floor_z_m):
    pixels, area_m2, depth_m, members, lab, low, high = sums
    axes_m, low_m, high_m = extents
    for i in range(len(out)):
        per = max(pixels[i], 1.0)
        out[i, :] = (
            log(per),
            log(area_m2[i] + 1e-4),
            depth_m[i] / per,
            _hypot(high[i, 0] - low[i, 0], high[i, 1] - low[i, 1]),
            axes_m[i, 0],
            axes_m[i, 1],
            axes_m[i, 2],
            members[i],
            lab[i, 0] / per,
            _hypot(lab[i, 1] / per, lab[i, 2] / per),
            high_m[i] - low_m[i],
            low_m[i] - floor_z_m,
            high_m[i] - floor_z_m,
        )


@kernel(error_model="numpy")
def _fill_pairs(out, larges, smalls, boxes, extents, union, geometry, contact):
    low, high = boxes
    axes_m, low_m, high_m = extents
    union_axes_m, union_low_m, union_high_m, box_low_m, box_high_m = union
    aside_m, overlap_m, inset_m, spread_m = geometry
    touch, step_m, gap_m, bridged = contact
    for k in range(len(out)):
        large, small = larges[k], smalls[k]
        volumes, joined = np.ones(2), 1.0
        for i in range(3):
            volumes[0] *= high[large, i] - low[large, i] + 0.01
            volumes[1] *= high[small, i] - low[small, i] + 0.01
            joined *= box_high_m[k, i] - box_low_m[k, i] + 0.01
        # NaN where they do not touch.
        if_touching = 0.0 if touch[k] > 0.0 else np.nan
        out[k, :] = (
            _hypot(aside_m[k, 0], aside_m[k, 1]),
            aside_m[k, 2],
            low_m[small] - low_m[large],
            high_m[small] - high_m[large],
            low_m[small] - high_m[large],
            low_m[large] - high_m[small],
            min(overlap_m[k, 0], overlap_m[k, 1]),
            overlap_m[k, 2],
            min(inset_m[k, 0], inset_m[k, 1]),
            _hypot(box_high_m[k, 0] - box_low_m[k, 0], box_high_m[k, 1] - box_low_m[k, 1]),
            union_high_m[k] - union_low_m[k],
            log(joined / (volumes[0] + volumes[1])),
            union_axes_m[k, 0],
            union_axes_m[k, 1],
            union_axes_m[k, 0] - max(axes_m[large, 0], axes_m[small, 0]),
            log1p(touch[k]),
            step_m[k] / max(touch[k], 1.0) + if_touching,
            _hypot(spread_m[k, 0], spread_m[k, 1]) + if_touching,
            spread_m[k, 2] + if_touching,
            min(gap_m[k], _FAR_M),
            bridged[k, 0],
            bridged[k, 1],
        )


@kernel
def _hypot(x, y):
    return np.sqrt(x * x + y * y)
