"""Absolute features of pairs of regions: metres, pixels and colours.

They help in rooms with furniture of about the size in the training data, which most rooms have. `pair_features` has
relative features for the others; half of the packaged trees are grown on those alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry import portable
from hickory_stream.perception.features import of_both

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.perception.features import Makers
    from hickory_stream.perception.ordered_pairs import OrderedPairs
    from hickory_stream.perception.region_extents import Extents
    from hickory_stream.perception.region_graph import RegionGraph, Regions

_FAR_M = 0.3
_UNITS = ("_m", "_m2", "_m3")
_OTHERS = ("_pixels", "_members", "_light", "_chroma")
_COUNTS = ("touch", "bridged_level", "bridged_upright")


def is_size(name: str) -> bool:
    """Return whether a feature of this name is one of `absolute_features`."""
    return name.endswith((*_UNITS, *_OTHERS)) or name in _COUNTS


def absolute_features(ordered: OrderedPairs) -> Makers:
    """Return by name (K,) the sizes of the regions `large` and `small` of each pair, and their relative position."""
    of_regions = _of_regions(ordered.graph, ordered.regions, ordered.extents)
    return {**of_both(of_regions, ordered.large, ordered.small), **_of_pairs(ordered)}


def _of_regions(graph: RegionGraph, regions: Regions, extents: Extents) -> Makers:
    per = np.maximum(regions.pixels, 1)
    extent = regions.high - regions.low
    mean = regions.lab / per[:, None]
    return {
        "pixels": lambda: portable.log(np.maximum(regions.pixels, 1)),
        "area_m2": lambda: portable.log(regions.area_m2 + 1e-4),
        "depth_m": lambda: regions.depth_m / per,
        "width_m": lambda: portable.hypot(extent[:, 0], extent[:, 1]),
        "thickness_m": lambda: extents.axes_m[:, 0],
        "breadth_m": lambda: extents.axes_m[:, 1],
        "length_m": lambda: extents.axes_m[:, 2],
        "members": lambda: regions.members,
        "light": lambda: mean[:, 0],
        "chroma": lambda: portable.hypot(mean[:, 1], mean[:, 2]),
        "height_m": lambda: extents.high_m - extents.low_m,
        "low_m": lambda: extents.low_m - graph.floor_z_m,
        "high_m": lambda: extents.high_m - graph.floor_z_m,
    }


def _of_pairs(ordered: OrderedPairs) -> Makers:
    regions, pairs, geometry = ordered.regions, ordered.pairs, ordered.geometry
    extents, union, large, small = ordered.extents, ordered.union, ordered.large, ordered.small
    aside, overlap, inset, spread = geometry.aside_m, geometry.overlap_m, geometry.inset_m, geometry.contact_spread_m
    joined = union.box_high_m - union.box_low_m
    volume = np.prod(regions.high - regions.low + 0.01, axis=1)
    touch = np.maximum(pairs.touch, 1)

    def of_touching(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(pairs.touch > 0, values, np.nan)

    return {
        "aside_m": lambda: portable.hypot(aside[:, 0], aside[:, 1]),
        "higher_m": lambda: aside[:, 2],
        "lows_m": lambda: extents.low_m[small] - extents.low_m[large],
        "highs_m": lambda: extents.high_m[small] - extents.high_m[large],
        "small_over_large_m": lambda: extents.low_m[small] - extents.high_m[large],
        "large_over_small_m": lambda: extents.low_m[large] - extents.high_m[small],
        "overlap_sideways_m": lambda: overlap[:, :2].min(axis=1),
        "overlap_upright_m": lambda: overlap[:, 2],
        "inset_m": lambda: inset[:, :2].min(axis=1),
        "joined_width_m": lambda: portable.hypot(joined[:, 0], joined[:, 1]),
        "joined_height_m": lambda: union.high_m - union.low_m,
        "joined_volume_m3": lambda: portable.log(np.prod(joined + 0.01, axis=1) / (volume[large] + volume[small])),
        "joined_thickness_m": lambda: union.axes_m[:, 0],
        "joined_breadth_m": lambda: union.axes_m[:, 1],
        "thicker_m": lambda: union.axes_m[:, 0] - np.maximum(extents.axes_m[large, 0], extents.axes_m[small, 0]),
        "touch": lambda: portable.log1p(pairs.touch),
        "seam_step_m": lambda: of_touching(pairs.step_m / touch),
        "seam_width_m": lambda: of_touching(portable.hypot(spread[:, 0], spread[:, 1])),
        "seam_height_m": lambda: of_touching(spread[:, 2]),
        "gap_m": lambda: np.minimum(pairs.gap_m, _FAR_M),
        "bridged_level": lambda: pairs.bridged[:, 0],
        "bridged_upright": lambda: pairs.bridged[:, 1],
    }
