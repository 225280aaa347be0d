"""Two parts of a frame in metres, pixels and colours as such: what tells furniture as large as that of the training.

People's rooms are alike in size, so that this helps in most of them; where it misleads, `affinity` has the same in
ratios, sigmas and angles, and the trees of the package are grown half on these alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry import portable

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.perception.bodies import Bodies
    from hickory_stream.perception.parts import Measures, Pairs, Parts

_FAR_M = 0.3
_UNITS = ("_m", "_m2", "_m3")
_OTHERS = ("_pixels", "_members", "_light", "_chroma")
_COUNTS = ("touch", "bridged_level", "bridged_upright")


def is_size(name: str) -> bool:
    """Return whether a feature of this name is one of `size_features`."""
    return name.endswith((*_UNITS, *_OTHERS)) or name in _COUNTS


def size_features(
    measures: Measures,
    parts: Parts,
    pairs: Pairs,
    bodies: Bodies,
    union: Bodies,
    large: NDArray[np.int64],
    small: NDArray[np.int64],
) -> dict[str, NDArray[np.float64]]:
    """Return by name (K,) the sizes of the parts `large` and `small` of each pair, and how they lie to each other."""
    pixels = portable.log(np.maximum(parts.pixels, 1))
    features = {"large_pixels": pixels[large], "small_pixels": pixels[small]}
    for name, values in _of_parts(measures, parts, bodies).items():
        features[f"large_{name}"], features[f"small_{name}"] = values[large], values[small]
    return features | _of_pairs(parts, pairs, bodies, union, large, small)


def _of_parts(measures: Measures, parts: Parts, bodies: Bodies) -> dict[str, NDArray[np.float64]]:
    per = np.maximum(parts.pixels, 1)
    extent = parts.high - parts.low
    mean = parts.lab / per[:, None]
    return {
        "area_m2": portable.log(parts.area_m2 + 1e-4),
        "depth_m": parts.depth_m / per,
        "width_m": portable.hypot(extent[:, 0], extent[:, 1]),
        "thickness_m": bodies.axes_m[:, 0],
        "breadth_m": bodies.axes_m[:, 1],
        "length_m": bodies.axes_m[:, 2],
        "members": parts.members,
        "light": mean[:, 0],
        "chroma": portable.hypot(mean[:, 1], mean[:, 2]),
        "height_m": bodies.high_m - bodies.low_m,
        "low_m": bodies.low_m - measures.floor_z_m,
        "high_m": bodies.high_m - measures.floor_z_m,
    }


def _of_pairs(
    parts: Parts,
    pairs: Pairs,
    bodies: Bodies,
    union: Bodies,
    large: NDArray[np.int64],
    small: NDArray[np.int64],
) -> dict[str, NDArray[np.float64]]:
    center = parts.place / np.maximum(parts.pixels, 1)[:, None]
    aside = center[small] - center[large]
    overlap = np.minimum(parts.high[large], parts.high[small]) - np.maximum(parts.low[large], parts.low[small])
    inset = np.minimum(parts.low[small] - parts.low[large], parts.high[large] - parts.high[small])
    joined = union.box_high_m - union.box_low_m
    volume = np.prod(parts.high - parts.low + 0.01, axis=1)
    touch = np.maximum(pairs.touch, 1)
    seam = pairs.seam / touch[:, None]
    spread = np.sqrt(np.maximum(pairs.seam_squares / touch[:, None] - seam * seam, 0))

    def of_touching(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(pairs.touch > 0, values, np.nan)

    return {
        "aside_m": portable.hypot(aside[:, 0], aside[:, 1]),
        "higher_m": aside[:, 2],
        "lows_m": bodies.low_m[small] - bodies.low_m[large],
        "highs_m": bodies.high_m[small] - bodies.high_m[large],
        "small_over_large_m": bodies.low_m[small] - bodies.high_m[large],
        "large_over_small_m": bodies.low_m[large] - bodies.high_m[small],
        "overlap_sideways_m": overlap[:, :2].min(axis=1),
        "overlap_upright_m": overlap[:, 2],
        "inset_m": inset[:, :2].min(axis=1),
        "joined_width_m": portable.hypot(joined[:, 0], joined[:, 1]),
        "joined_height_m": union.high_m - union.low_m,
        "joined_volume_m3": portable.log(np.prod(joined + 0.01, axis=1) / (volume[large] + volume[small])),
        "joined_thickness_m": union.axes_m[:, 0],
        "joined_breadth_m": union.axes_m[:, 1],
        "thicker_m": union.axes_m[:, 0] - np.maximum(bodies.axes_m[large, 0], bodies.axes_m[small, 0]),
        "touch": portable.log1p(pairs.touch),
        "seam_step_m": of_touching(pairs.step_m / touch),
        "seam_width_m": of_touching(portable.hypot(spread[:, 0], spread[:, 1])),
        "seam_height_m": of_touching(spread[:, 2]),
        "gap_m": np.minimum(pairs.gap_m, _FAR_M),
        "bridged_level": pairs.bridged[:, 0],
        "bridged_upright": pairs.bridged[:, 1],
    }
