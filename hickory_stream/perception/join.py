"""Joining fragments into things: what hangs below a supporting plane, what is one colour across a seam, what would fall.

Every rule looks at two fragments and the seam between them. Rules only join; what no rule joins stays apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.perception.surface import Surface


@dataclass(frozen=True, kw_only=True, slots=True)
class JoinConfig:
    """When two fragments are one thing.

    Attributes:
        seam_share: a seam must be at least this share of the square root of the smaller fragment's pixels.
        like_color: difference in Lab (lightness at half weight) under which two fragments are of one colour.
        rim_m: a seam within this distance of a plane's rim lies on the rim (a chair's back on its seat).
        below_m: a fragment whose top is at most this far above a plane hangs below it.
        leg_gap_m: a leg is seen up to this far below the plane that it carries.
    """

    seam_share: float = 0.3
    like_color: float = 11.0
    rim_m: float = 0.07
    below_m: float = 0.012
    leg_gap_m: float = 0.2


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FragmentStats:
    """Per fragment (index = label): pixels, Lab mean, height percentiles, and its supporting plane (0 = none)."""

    pixels: NDArray[np.int64]
    lab: NDArray[np.float32]
    z_low_m: NDArray[np.float32]
    z_high_m: NDArray[np.float32]
    area_m2: NDArray[np.float64]
    support: NDArray[np.int32]


@dataclass(frozen=True, kw_only=True, slots=True)
class Seam:
    """Where fragments a < b touch in 3D: the number of neighbouring pixel pairs, and the mean point of the seam."""

    a: int
    b: int
    pairs: int
    points_world: NDArray[np.float32]


def join_fragments(
    surface: Surface,
    labels: NDArray[np.int32],
    supports: NDArray[np.int32],
    areas_m2: NDArray[np.float32],
    config: JoinConfig,
) -> NDArray[np.int32]:
    """Return (h, w) instance labels 1..n: fragments joined by the rules, numbered in the order of their first fragment."""
    count = int(labels.max()) + 1
    if count == 1:
        return labels
    stats = _stats(surface, labels, supports, areas_m2)
    parent = list(range(count))

    def root(i: int) -> int:
        while parent[i] != i:
            i = parent[i]
        return i

    for seam in _seams(surface, labels):
        if _is_one_thing(seam, stats, surface, labels, config):
            ra, rb = root(seam.a), root(seam.b)
            parent[max(ra, rb)] = min(ra, rb)
    groups = np.array([root(i) for i in range(count)])
    for plane, leg in _legs(surface, labels, groups, stats, config):
        ra, rb = root(plane), root(leg)
        parent[max(ra, rb)] = min(ra, rb)
    roots = np.array([root(i) for i in range(count)])
    _, numbered = np.unique(roots, return_inverse=True)
    return numbered.astype(np.int32)[labels]


def _stats(
    surface: Surface, labels: NDArray[np.int32], supports: NDArray[np.int32], areas_m2: NDArray[np.float32]
) -> FragmentStats:
    count = int(labels.max()) + 1
    flat = labels.ravel()
    pixels = np.bincount(flat, minlength=count)
    lab_image = cv2.cvtColor(surface.rgb.astype(np.float32) / 255, cv2.COLOR_RGB2LAB).reshape(-1, 3)
    lab = np.stack([np.bincount(flat, weights=lab_image[:, c], minlength=count) for c in range(3)], axis=1)
    order = np.argsort(flat, kind="stable")
    z = surface.points_world[..., 2].ravel()[order]
    starts = np.concatenate([[0], np.cumsum(pixels)])
    low, high = np.zeros(count, dtype=np.float32), np.zeros(count, dtype=np.float32)
    support = np.zeros(count, dtype=np.int32)
    planes = supports.ravel()[order]
    for i in range(1, count):
        part = slice(starts[i], starts[i + 1])
        low[i], high[i] = np.nanpercentile(z[part], [5, 95])
        if np.mean(planes[part] > 0) > 0.5:
            support[i] = np.bincount(planes[part]).argmax()
    return FragmentStats(
        pixels=pixels,
        lab=(lab / np.maximum(pixels, 1)[:, None]).astype(np.float32),
        z_low_m=low,
        z_high_m=high,
        area_m2=np.bincount(flat, weights=areas_m2.ravel(), minlength=count),
        support=support,
    )


def _seams(surface: Surface, labels: NDArray[np.int32]) -> list[Seam]:
    """Return the seams in the order of their labels; pixel pairs across a depth edge are no seam."""
    keys, points = [], []
    for dy, dx in ((0, 1), (1, 0)):
        h, w = labels.shape
        here, there = labels[: h - dy, : w - dx], labels[dy:, dx:]
        pa, pb = surface.points_world[: h - dy, : w - dx], surface.points_world[dy:, dx:]
        differ = (here != there) & (here > 0) & (there > 0)
        a, b = here[differ], there[differ]
        near = np.linalg.norm(pa[differ] - pb[differ], axis=1) < 0.015 + 0.012 * surface.depth_m[: h - dy, : w - dx][differ]
        lo, hi = np.minimum(a, b)[near].astype(np.int64), np.maximum(a, b)[near].astype(np.int64)
        keys.append(lo * 100_000 + hi)
        points.append(pa[differ][near])
    key, at = np.concatenate(keys), np.concatenate(points)
    order = np.argsort(key, kind="stable")
    unique, starts = np.unique(key[order], return_index=True)
    groups = np.split(at[order], starts[1:])
    return [
        Seam(a=int(k) // 100_000, b=int(k) % 100_000, pairs=len(group), points_world=group)
        for k, group in zip(unique, groups, strict=True)
    ]


def _is_one_thing(
    seam: Seam, stats: FragmentStats, surface: Surface, labels: NDArray[np.int32], config: JoinConfig
) -> bool:
    a, b = seam.a, seam.b
    if seam.pairs < config.seam_share * np.sqrt(min(stats.pixels[a], stats.pixels[b])):
        return False
    difference = stats.lab[a] - stats.lab[b]
    color = float(np.hypot(0.5 * difference[0], np.hypot(difference[1], difference[2])))
    plane_a, plane_b = stats.support[a] > 0, stats.support[b] > 0
    if plane_a and plane_b:
        # Two levels that touch: a step of one thing if of one colour, else a thing on another.
        return color < 0.6 * config.like_color
    if plane_a or plane_b:
        plane, other = (a, b) if plane_a else (b, a)
        height = float(stats.z_high_m[plane] + stats.z_low_m[plane]) / 2
        if stats.z_high_m[other] < height + config.below_m:
            return True
        return color < config.like_color and _stands_on_rim(seam, plane, surface, labels, config)
    return color < config.like_color


def _stands_on_rim(
    seam: Seam, plane: int, surface: Surface, labels: NDArray[np.int32], config: JoinConfig
) -> bool:
    """Return whether a seam runs along the rim of a plane and is as long as half of it: a back on its seat."""
    at = surface.points_world[labels == plane][:, :2]
    hull = cv2.convexHull(at[np.isfinite(at).all(axis=1)].astype(np.float32))
    if len(hull) < 3:
        return False
    inside = np.array([cv2.pointPolygonTest(hull, (float(x), float(y)), True) for x, y, _ in seam.points_world])
    extent = float(np.linalg.norm(np.ptp(seam.points_world[:, :2], axis=0)))
    size = float(np.sqrt(max(cv2.contourArea(hull), 1e-6)))
    return bool(np.mean(inside < config.rim_m) > 0.8) and extent > 0.5 * size


def _legs(
    surface: Surface, labels: NDArray[np.int32], groups: NDArray[np.int64], stats: FragmentStats, config: JoinConfig
) -> list[tuple[int, int]]:
    """Return (plane, leg) pairs: a leg vanishes upwards behind the edge of what it carries, and stands under it."""
    upper, lower = labels[:-1], labels[1:]
    vanishes = (upper != lower) & (upper > 0) & (lower > 0) & (surface.depth_m[:-1] < surface.depth_m[1:] - 0.02)
    pairs, counts = np.unique(
        groups[upper[vanishes]].astype(np.int64) * 100_000 + lower[vanishes], return_counts=True
    )
    found: list[tuple[int, int]] = []
    for pair, count in zip(pairs, counts, strict=True):
        group, leg = int(pair) // 100_000, int(pair) % 100_000
        if groups[leg] == group or stats.support[leg] > 0:
            continue
        for plane in np.flatnonzero((groups == group) & (stats.support > 0)):
            top = float(stats.z_low_m[plane])
            if not top - config.leg_gap_m < stats.z_high_m[leg] < top + config.below_m:
                continue
            columns = np.flatnonzero((labels == leg).any(axis=0)).size
            if count > 0.4 * columns and _is_under(surface, labels, int(plane), leg):
                found.append((int(plane), leg))
                break
    return found


def _is_under(surface: Surface, labels: NDArray[np.int32], plane: int, leg: int) -> bool:
    """Return whether 80 % of a fragment's points lie under the convex hull of a plane, to 6 cm."""
    at = surface.points_world[labels == plane][:, :2]
    hull = cv2.convexHull(at.astype(np.float32))
    below = surface.points_world[labels == leg][::7, :2]
    return float(np.mean([cv2.pointPolygonTest(hull, (float(x), float(y)), True) > -0.06 for x, y in below])) > 0.8
