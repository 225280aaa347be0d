"""How two parts of a frame look beside each other: the numbers from which trees tell whether they are one thing.

Of two parts, "large" is the one with more pixels and "small" the other one. What cannot be measured of a pair (the seam
of parts that do not touch, heights while no floor is known) is NaN.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry import portable
from hickory_stream.perception.parts import HEIGHT_BIN_M, grouped_pairs, grouped_parts
from hickory_stream.perception.standing import standing_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.perception.parts import Measures, Pairs, Parts
    from hickory_stream.perception.standing import Standing

_FAR_M = 0.3
_LEAST_HEIGHT_M = 0.02


def pair_features(
    measures: Measures, numbers: NDArray[np.int64], count: int
) -> tuple[NDArray[np.int64], dict[str, NDArray[np.float64]]]:
    """Return the (K, 2) pairs of groups large and small, and by name (K,) how they look beside each other.

    `numbers` (n,) names the group 0..count - 1 of each fragment.
    """
    parts, pairs = grouped_parts(measures.parts, numbers, count), grouped_pairs(measures.pairs, numbers)
    standing = standing_of(measures.contacts, np.append(numbers, count), measures.heights_m, measures.level)
    is_turned = parts.pixels[pairs.a] < parts.pixels[pairs.b]
    large, small = np.where(is_turned, pairs.b, pairs.a), np.where(is_turned, pairs.a, pairs.b)
    low_m, high_m = _heights(parts, measures.bottom_m)
    axes_m = _axes(parts.pixels, parts.place, parts.place_products)
    features: dict[str, NDArray[np.float64]] = {}
    for name, values in {
        **_sizes(parts, axes_m),
        **_colors(parts),
        **_carried(standing),
        "height": high_m - low_m,
        "low": low_m - measures.floor_z_m,
        "high": high_m - measures.floor_z_m,
    }.items():
        features[f"large_{name}"], features[f"small_{name}"] = values[large], values[small]
    features |= _relations(parts, axes_m, low_m, high_m, large, small)
    features |= _standing_of_pairs(standing, large, small)
    features |= _seams(pairs, parts, measures, low_m, high_m, large, small, is_turned)
    return np.stack([large, small], axis=1), features


def _heights(parts: Parts, bottom_m: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the 5th and 95th percentile of each part's heights."""
    below = np.cumsum(parts.heights, axis=1)
    low, high = ((below < share * parts.pixels[:, None]).sum(axis=1) for share in (0.05, 0.95))
    return bottom_m + (low + 0.5) * HEIGHT_BIN_M, bottom_m + (high + 0.5) * HEIGHT_BIN_M


def _sizes(parts: Parts, axes_m: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Return how large, flat and level each part is, and how much of its outline the image cuts."""
    per = np.maximum(parts.pixels, 1)
    extent = parts.high - parts.low
    return {
        "pixels": portable.log(per),
        "area": portable.log(parts.area_m2 + 1e-4),
        "depth": parts.depth_m / per,
        "width": portable.hypot(extent[:, 0], extent[:, 1]),
        "in_plane": 1 - parts.planes[:, 0] / per,
        "level": parts.normals[:, 2] / per,
        "flat": np.linalg.norm(parts.normals, axis=1) / per,
        "thickness": axes_m[:, 0],
        "breadth": axes_m[:, 1],
        "length": axes_m[:, 2],
        "cut": parts.cut / np.maximum(parts.outline, 1),
        "members": parts.members,
    }


def _colors(parts: Parts) -> dict[str, NDArray[np.float64]]:
    """Return the lightness and chroma of each part, and their spread."""
    per = np.maximum(parts.pixels, 1)[:, None]
    mean = parts.lab / per
    spread = np.sqrt(np.maximum(parts.lab_squares / per - mean * mean, 0))
    return {
        "light": mean[:, 0],
        "chroma": portable.hypot(mean[:, 1], mean[:, 2]),
        "light_spread": spread[:, 0],
        "chroma_spread": portable.hypot(spread[:, 1], spread[:, 2]),
    }


def _carried(standing: Standing) -> dict[str, NDArray[np.float64]]:
    """Return which share of each part's foot is on structure, on anything, and over nothing near."""
    foot = np.maximum(standing.outline, 1)
    return {
        "on_structure": standing.on[:, -1] / foot,
        "on_any": standing.on.sum(axis=1) / foot,
        "free": standing.free / foot,
    }


def _standing_of_pairs(
    standing: Standing, large: NDArray[np.int64], small: NDArray[np.int64]
) -> dict[str, NDArray[np.float64]]:
    """Return how much of either stands on the other, and of both on the same."""
    on = standing.on / np.maximum(standing.outline, 1)[:, None]
    return {
        "large_on_small": on[large, small],
        "small_on_large": on[small, large],
        "on_the_same": np.minimum(on[large], on[small]).sum(axis=1),
    }


def _relations(
    parts: Parts,
    axes_m: NDArray[np.float64],
    low_m: NDArray[np.float64],
    high_m: NDArray[np.float64],
    large: NDArray[np.int64],
    small: NDArray[np.int64],
) -> dict[str, NDArray[np.float64]]:
    """Return how two parts lie to each other, what their union would be, and how their colours differ."""
    per = np.maximum(parts.pixels, 1)[:, None]
    normal, color, center = parts.normals / per, parts.lab / per, parts.place / per
    flat = np.linalg.norm(normal, axis=1)
    most = parts.planes.argmax(axis=1)
    low, high = np.minimum(parts.low[large], parts.low[small]), np.maximum(parts.high[large], parts.high[small])
    extent = parts.high - parts.low
    overlap = np.minimum(parts.high[large], parts.high[small]) - np.maximum(parts.low[large], parts.low[small])
    inset = np.minimum(parts.low[small] - parts.low[large], parts.high[large] - parts.high[small])
    joined = _axes(
        parts.pixels[large] + parts.pixels[small],
        parts.place[large] + parts.place[small],
        parts.place_products[large] + parts.place_products[small],
    )
    aside, shade = center[small] - center[large], color[small] - color[large]
    foot = np.clip(overlap[:, :2], 0, None).prod(axis=1) / np.maximum(extent[small, 0] * extent[small, 1], 1e-4)
    volume = np.prod(extent + 0.01, axis=1)
    return {
        "parallel": (normal[large] * normal[small]).sum(axis=1) / np.maximum(flat[large] * flat[small], 1e-3),
        "same_plane": ((most[large] == most[small]) & (most[large] > 0)).astype(np.float64),
        "light_difference": np.abs(shade[:, 0]),
        "chroma_difference": portable.hypot(shade[:, 1], shade[:, 2]),
        "aside": portable.hypot(aside[:, 0], aside[:, 1]),
        "higher": aside[:, 2],
        "lows": low_m[small] - low_m[large],
        "highs": high_m[small] - high_m[large],
        "small_over_large": low_m[small] - high_m[large],
        "large_over_small": low_m[large] - high_m[small],
        "overlap_sideways": overlap[:, :2].min(axis=1),
        "overlap_upright": overlap[:, 2],
        "overlap_foot": np.minimum(foot, 1.5),
        "inset": inset[:, :2].min(axis=1),
        "joined_width": portable.hypot(*(high - low)[:, :2].T),
        "joined_height": np.maximum(high_m[large], high_m[small]) - np.minimum(low_m[large], low_m[small]),
        "joined_volume": portable.log(np.prod(high - low + 0.01, axis=1) / (volume[large] + volume[small])),
        "joined_thickness": joined[:, 0],
        "joined_breadth": joined[:, 1],
        "thicker": joined[:, 0] - np.maximum(axes_m[large, 0], axes_m[small, 0]),
    }


def _seams(
    pairs: Pairs,
    parts: Parts,
    measures: Measures,
    low_m: NDArray[np.float64],
    high_m: NDArray[np.float64],
    large: NDArray[np.int64],
    small: NDArray[np.int64],
    is_turned: NDArray[np.bool_],
) -> dict[str, NDArray[np.float64]]:
    """Return how two parts meet: how much of their outlines, how sharply, where, and which is before the other."""
    meet, touch = np.maximum(pairs.meet, 1), np.maximum(pairs.touch, 1)

    def of_meeting(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(pairs.meet > 0, values / meet, np.nan)

    def of_touching(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(pairs.touch > 0, values / touch, np.nan)

    nearer, above = (np.where(is_turned[:, None], v[:, ::-1], v) for v in (pairs.nearer, pairs.above))
    center = pairs.seam / touch[:, None]
    spread = np.sqrt(np.maximum(pairs.seam_squares / touch[:, None] - center * center, 0))
    at_m = center[:, 2] + measures.middle[2]
    away = pairs.meet - pairs.touch
    height = np.maximum(high_m - low_m, _LEAST_HEIGHT_M)
    return {
        "meet_of_lesser": pairs.meet / np.maximum(np.minimum(parts.outline[large], parts.outline[small]), 1),
        "meet_of_small": pairs.meet / np.maximum(parts.outline[small], 1),
        "touch": portable.log1p(pairs.touch),
        "touch_of_size": pairs.touch / np.sqrt(np.maximum(parts.pixels[small], 1)),
        "touch_share": of_meeting(pairs.touch),
        "lean": of_touching(pairs.lean),
        "concave": of_touching(pairs.concave),
        "seam_parallel": of_touching(pairs.parallel),
        "seam_contrast": of_touching(pairs.contrast),
        "seam_step": of_touching(pairs.step_m),
        "far_contrast": np.where(away > 0, pairs.far_contrast / np.maximum(away, 1), np.nan),
        "seam_width": of_touching(touch * portable.hypot(spread[:, 0], spread[:, 1])),
        "seam_height": of_touching(touch * spread[:, 2]),
        "seam_in_large": of_touching(touch * (at_m - low_m[large]) / height[large]),
        "seam_in_small": of_touching(touch * (at_m - low_m[small]) / height[small]),
        "large_nearer": of_meeting(nearer[:, 0]),
        "small_nearer": of_meeting(nearer[:, 1]),
        "large_above": of_meeting(above[:, 0]),
        "small_above": of_meeting(above[:, 1]),
        "bridged_level": pairs.bridged[:, 0],
        "bridged_upright": pairs.bridged[:, 1],
        "gap": np.minimum(pairs.gap_m, _FAR_M),
    }


def _axes(
    pixels: NDArray[np.float64], place: NDArray[np.float64], products: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return (n, 3) the standard deviations of each part's points along its main axes, the least first."""
    per = np.maximum(pixels, 1)[:, None]
    mean, second = place / per, products / per
    covariance = second[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3) - mean[:, :, None] * mean[:, None, :]
    return np.asarray(np.sqrt(np.maximum(portable.eigenvalues(covariance), 0)))
