"""The region adjacency graph of a frame: measures of its regions, and of pairs that touch, nearly touch or are bridged.

All measures are sums, minima or maxima, so a merged region's follow from its fragments', without the image.
"""

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.voxels import sorted_unique
from hickory_stream.perception.fragments.over_segmentation import Fragments
from hickory_stream.perception.regions.contacts import Contacts, contacts_of
from hickory_stream.perception.regions.occlusion_bridging import bridges
from hickory_stream.perception.regions.region_sums import RegionSums, region_sums
from hickory_stream.perception.surface import Surface

HEIGHT_BIN_M = 0.01
_CONCAVE = 0.15


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Regions(RegionSums):
    """Region sums with the `outline` in pixels, its part on the image border (`cut`), and the fragment count."""

    outline: NDArray[np.float64]
    cut: NDArray[np.float64]
    members: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RegionPairs:
    """Measures of K pairs of regions a < b; sums over their neighbouring pixels, all (K, ...)."""

    a: NDArray[np.int64]
    b: NDArray[np.int64]
    meet: NDArray[np.float64]
    #: neighbours that touch in 3D, of all that `meet`; `lean` to `contact_squares` but `far_contrast` are over these
    touch: NDArray[np.float64]
    #: concavity of the normals, per distance
    lean: NDArray[np.float64]
    #: number of concave ones
    concave: NDArray[np.float64]
    #: cosine of the normals
    parallel: NDArray[np.float64]
    #: Lab distance, lightness at half weight
    contrast: NDArray[np.float64]
    #: the same over neighbours that do not touch
    far_contrast: NDArray[np.float64]
    #: distance of the two pixels
    step_m: NDArray[np.float64]
    #: standard deviation of depth
    sigma_m: NDArray[np.float64]
    #: (3) positions of the pixels with the lower label
    contact: NDArray[np.float64]
    contact_squares: NDArray[np.float64]
    #: (2) pixels where a occludes b, and b a
    nearer: NDArray[np.float64]
    #: (2) pixels where a is above b in the image, and b above a
    above: NDArray[np.float64]
    #: (2) lines that bridge an occlusion of a horizontal and of a vertical plane
    bridged: NDArray[np.float64]
    #: minimum distance of the two, infinite beyond reach
    gap_m: NDArray[np.float64]


_OF_PIXELS = tuple(field.name for field in fields(RegionSums))
_REGION_SUMS = tuple(field.name for field in fields(Regions) if field.name not in ("low", "high"))
_PAIR_SUMS = tuple(name for name in RegionPairs.__slots__ if name not in ("a", "b", "nearer", "above", "gap_m"))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RegionGraph:
    """The region adjacency graph of the fragments of a frame."""

    labels: NDArray[np.int32]
    regions: Regions
    pairs: RegionPairs
    contacts: Contacts
    #: (3,) origin of positions; `bottom_m`: origin of heights
    middle: NDArray[np.float64]
    bottom_m: float
    #: NaN if no floor is known
    floor_z_m: float
    #: (h, w) pixels of surfaces that can support something
    level: NDArray[np.bool_]
    #: (h, w) world z
    heights_m: NDArray[np.float32]


def build_region_graph(fragments: Fragments, *, reach_px: int, gap_m: float) -> RegionGraph:
    """Return the graph of at least one fragment.

    Pixels are neighbours across fewer than `reach_px` unlabelled pixels; fragments are close up to `gap_m`.
    """
    surface, room, labels, supports = fragments.surface, fragments.room, fragments.labels, fragments.supports
    sums, middle, bottom_m = region_sums(surface, labels, supports, room.areas_m2, HEIGHT_BIN_M)
    count = len(sums.pixels)
    contacts = contacts_of(surface, np.where(room.structure, np.int32(count), labels), reach_px)
    ends = np.concatenate([contacts.here, contacts.there, contacts.cut])
    regions = Regions(
        outline=np.bincount(ends, minlength=count + 1)[:count].astype(np.float64),
        cut=np.bincount(contacts.cut, minlength=count + 1)[:count].astype(np.float64),
        members=np.minimum(np.arange(count), 1).astype(np.float64),
        **{name: getattr(sums, name) for name in _OF_PIXELS},
    )
    reach = np.float32(gap_m * max(surface.camera.fx, surface.camera.fy))
    gaps = _gaps(labels, surface.depth_m, surface.points_world, count, reach, np.float32(gap_m))
    return RegionGraph(
        labels=labels,
        regions=regions,
        pairs=_pairs(surface, contacts, count, middle, gaps, bridges(surface, labels)),
        contacts=contacts,
        middle=middle,
        bottom_m=bottom_m,
        floor_z_m=np.nan if room.floor_z_m is None else room.floor_z_m,
        level=(surface.normals_world[..., 2] > 0.7) | (supports > 0),
        heights_m=np.ascontiguousarray(surface.points_world[..., 2]),
    )


def merged_regions(regions: Regions, numbers: NDArray[np.int64], count: int) -> Regions:
    """Return the measures of `count` merged regions; `numbers` (n,) gives the merged region of each region."""
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, numbers, regions.low)
    np.maximum.at(high, numbers, regions.high)
    return Regions(
        low=low, high=high, **{name: summed(getattr(regions, name), numbers, count) for name in _REGION_SUMS}
    )


def merged_pairs(pairs: RegionPairs, numbers: NDArray[np.int64]) -> RegionPairs:
    """Return the measures of the pairs of merged regions, ordered by number, without pairs within one."""
    a, b, places = merged_keys(pairs.a, pairs.b, numbers, int(numbers.max(initial=0)) + 1)
    # `nearer` and `above` are by side, and sides may have changed places.
    turned, apart = (numbers[pairs.a] > numbers[pairs.b])[:, None], places >= 0
    sides = {
        name: np.where(turned, own[:, ::-1], own) for name, own in (("nearer", pairs.nearer), ("above", pairs.above))
    }
    values = {name: getattr(pairs, name) for name in _PAIR_SUMS} | sides
    gap_m = np.full(len(a), np.inf)
    np.minimum.at(gap_m, places[apart], pairs.gap_m[apart])
    return RegionPairs(a=a, b=b, gap_m=gap_m, **{name: summed(own, places, len(a)) for name, own in values.items()})


def merged_keys(
    a: NDArray[np.int64], b: NDArray[np.int64], numbers: NDArray[np.int64], count: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return (M,), (M,) the pairs of merged regions, ordered, and (K,) the place of each pair a, b among them.

    `numbers` (n,) gives the merged region 0..count - 1 of each region; pairs within one have no place, -1.
    """
    one, other = numbers[a], numbers[b]
    wanted = np.where(one == other, -1, np.minimum(one, other) * count + np.maximum(one, other))
    keys = sorted_unique(wanted[wanted >= 0])
    return keys // count, keys % count, np.where(wanted < 0, -1, np.searchsorted(keys, wanted))


def summed(values: NDArray[Any], places: NDArray[np.int64], count: int) -> NDArray[Any]:
    """Return (count, ...) the sums of values (n, ...) by place (n,), in their order; those at place -1 are left out."""
    out = np.zeros((count, *values.shape[1:]), values.dtype)
    width = math.prod(values.shape[1:])
    _add_rows(values.reshape(len(values), width), places, out.reshape(count, width))
    return out


@kernel
def _add_rows(rows, places, out):
    for i in range(len(places)):
        if places[i] >= 0:
            for k in range(rows.shape[1]):
                out[places[i], k] += rows[i, k]


def _pairs(
    surface: Surface,
    contacts: Contacts,
    count: int,
    middle: NDArray[np.float64],
    gaps: NDArray[np.float32],
    bridged: NDArray[np.int64],
) -> RegionPairs:
    # The measures of the pairs of fragments; `gaps` (n, n), `bridged` (M, 3).
    inner = (contacts.here < count) & (contacts.there < count)
    here, there = contacts.here[inner].astype(np.int64), contacts.there[inner].astype(np.int64)
    turned = here > there
    at_a = np.where(turned, contacts.there_px[inner], contacts.here_px[inner])
    at_b = np.where(turned, contacts.here_px[inner], contacts.there_px[inner])
    contact_key = np.minimum(here, there) * count + np.maximum(here, there)
    near_a, near_b = np.nonzero(np.isfinite(gaps))
    near_key = np.minimum(near_a, near_b) * count + np.maximum(near_a, near_b)
    bridge_key = np.minimum(bridged[:, 0], bridged[:, 1]) * count + np.maximum(bridged[:, 0], bridged[:, 1])
    keys = np.unique(np.concatenate([contact_key, near_key, bridge_key]))
    place = np.searchsorted(keys, contact_key)

    def total(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.bincount(place, weights=values, minlength=len(keys)).astype(np.float64)

    def columns(*values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.stack([total(column) for column in values], axis=1)

    lab, points, normals = (own.reshape(-1, 3) for own in (surface.lab, surface.points_world, surface.normals_world))
    touch = contacts.touches[inner].astype(np.float64)
    across = (points[at_b] - points[at_a]).astype(np.float64)
    step_m = np.linalg.norm(across, axis=1) + 1e-6
    normal_a, normal_b = np.nan_to_num(normals[at_a]), np.nan_to_num(normals[at_b])
    lean = (across * (normal_a - normal_b)).sum(axis=1) / step_m
    light, green, blue = (lab[at_b] - lab[at_a]).T.astype(np.float64)
    contrast = np.sqrt(0.25 * light * light + green * green + blue * blue)
    depth, sigma_m = surface.depth_m.ravel(), surface.sigma_m.ravel().astype(np.float64)
    behind, limit = depth[at_b] - depth[at_a], 0.02 * depth[at_a] + 0.01
    is_below = contacts.is_below[inner]
    contact = (points[at_a] - middle) * touch[:, None]
    gap_m = np.full(len(keys), np.inf)
    np.minimum.at(gap_m, np.searchsorted(keys, near_key), gaps[near_a, near_b].astype(np.float64))
    lines = np.zeros((len(keys), 2))
    np.add.at(lines, (np.searchsorted(keys, bridge_key), 1 - bridged[:, 2]), 1.0)
    return RegionPairs(
        a=keys // count,
        b=keys % count,
        meet=total(np.ones(len(place))),
        touch=total(touch),
        lean=total(touch * lean),
        concave=total(touch * (lean > _CONCAVE)),
        parallel=total(touch * (normal_a * normal_b).sum(axis=1)),
        contrast=total(touch * contrast),
        far_contrast=total((1 - touch) * contrast),
        step_m=total(touch * step_m),
        sigma_m=total(touch * (sigma_m[at_a] + sigma_m[at_b]) / 2),
        contact=columns(*contact.T),
        contact_squares=columns(*(contact * contact).T),
        nearer=columns((behind > limit).astype(np.float64), (behind < -limit).astype(np.float64)),
        above=columns((is_below & ~turned).astype(np.float64), (is_below & turned).astype(np.float64)),
        bridged=lines,
        gap_m=gap_m,
    )


@kernel
def _gaps(labels, depth, points, count, reach, limit):
    # (count, count) the minimum distance of each two labels at a stride of 2; infinite beyond the limit.
    height, width = labels.shape
    out = np.full((count, count), np.inf, dtype=np.float32)
    for y in range(0, height, 2):
        for x in range(0, width, 2):
            i = labels[y, x]
            if i == 0:
                continue
            # Interior pixels cannot be nearest; pixels to the right and below suffice, for distance is symmetric.
            if (
                0 < x < width - 1
                and 0 < y < height - 1
                and labels[y, x - 1] == i
                and labels[y, x + 1] == i
                and labels[y - 1, x] == i
                and labels[y + 1, x] == i
                and labels[max(0, y - 2), x] == i
                and labels[min(height - 1, y + 2), x] == i
                and labels[y, max(0, x - 2)] == i
                and labels[y, min(width - 1, x + 2)] == i
            ):
                continue
            radius = int(reach / depth[y, x]) + 1
            for yy in range(y, min(height, y + radius + 1), 2):
                first = x + 2 if yy == y else max(x % 2, x - radius // 2 * 2)
                for xx in range(first, min(width, x + radius + 1), 2):
                    j = labels[yy, xx]
                    if j == 0 or j == i or abs(depth[yy, xx] - depth[y, x]) > limit:
                        continue
                    d0 = points[yy, xx, 0] - points[y, x, 0]
                    d1 = points[yy, xx, 1] - points[y, x, 1]
                    d2 = points[yy, xx, 2] - points[y, x, 2]
                    distance = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
                    if distance < min(out[i, j], limit):
                        out[i, j] = out[j, i] = distance
    return out
