"""Degrees in 0..1 of shape words, from an object's superquadrics, sides, and height map from above."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.geometry.superquadric import Superquadrics, volumes_m3


def ramp(value: NDArray[np.float64], zero_at: float, one_at: float) -> NDArray[np.float64]:
    """Return 0 up to `zero_at`, 1 from `one_at` on, linear between; falling if `one_at` is less."""
    return np.asarray(np.clip((value - zero_at) / (one_at - zero_at), 0.0, 1.0))


def rising(value: float, zero_at: float, one_at: float) -> float:
    """Return `ramp` of one number."""
    return float(np.clip((value - zero_at) / (one_at - zero_at), 0.0, 1.0))


SHAPE_WORDS = ("box", "cylinder", "ball", "flat", "thin", "hollow")

# A flat thing's smallest side, and a thin one's middle side, over the next larger one: fully, not at all.
_FLAT = (0.25, 0.45)
_THIN = (0.25, 0.45)
# Exponents of a superquadric: an edge is sharp up to the first and gone from the second; one near 1 is round.
_SHARP = (0.5, 0.95)
_ROUND = (0.25, 0.55)
# The ratio of two semi-axes that are equal, and that are not.
_EQUAL = (0.85, 0.6)
# Volume of the primitives over the volume of their box: of a solid body, and of a frame of bars and boards.
_BODY = (0.3, 0.5)


def shape_scores(primitives: Superquadrics | None, sides_m: NDArray[np.float64], hollow: float) -> NDArray[np.float64]:
    """Return the degree in 0..1 of each of `SHAPE_WORDS`.

    `primitives` is layer 3 or the sketch, None for neither box, cylinder nor ball; `sides_m` (3,) are of the upright
    box, `hollow` is in 0..1.
    """
    shortest, middle, longest = np.sort(sides_m)
    flat = 1.0 - rising(shortest / middle, *_FLAT)
    thin = 1.0 - rising(middle / longest, *_THIN)
    if primitives is None or not len(primitives):
        return np.array([0.0, 0.0, 0.0, flat, thin, hollow])
    volumes = volumes_m3(primitives)
    body = rising(float(volumes.sum() / sides_m.prod()), *_BODY)
    shares = volumes / volumes.sum()
    e1, e2 = primitives.exponents.T
    axes = primitives.semi_axes_m
    is_turned = _is_round(e2) * _are_equal(axes[:, 0], axes[:, 1])
    box = _is_sharp(e1) * _is_sharp(e2)
    cylinder = _is_sharp(e1) * is_turned
    ball = _is_round(e1) * is_turned * _are_equal(axes[:, 0], axes[:, 2])
    found = [min(body, float((shares * kind).sum())) for kind in (box, cylinder, ball)]
    return np.array([*found, flat, thin, hollow])


def _is_sharp(exponents: NDArray[np.float64]) -> NDArray[np.float64]:
    return 1.0 - ramp(exponents, *_SHARP)


def _is_round(exponents: NDArray[np.float64]) -> NDArray[np.float64]:
    return 1.0 - ramp(np.abs(exponents - 1.0), *_ROUND)


def _are_equal(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return ramp(np.minimum(a, b) / np.maximum(a, b), _EQUAL[1], _EQUAL[0])


LEVEL_M = 0.05
NUM_LEVELS = 44
_CELL_M = (0.01, 0.04)
_CELLS_ACROSS = 24
# The middle and the rim of a footprint, as shares of the way from its centre to its border.
_MIDDLE, _RIM = 0.45, 0.6
_SECTORS = 8
# The rim is at least this high, as a share of the object; how deep the middle lies below the top, likewise.
_RIM_HEIGHT = 0.7
_SHALLOW, _DEEP = 0.45, 0.7
# In how many of the sectors there is a rim: not all around, and all around.
_BROKEN, _WHOLE = 0.7, 0.95


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TopMap:
    """Highest points of the columns of an object: `places` (N, 2) along its box's sides in -1..1, `heights_m` (N,).

    Heights are above the bottom of the box; a column covers `cell_m2`.
    """

    places: NDArray[np.float64]
    heights_m: NDArray[np.float64]
    cell_m2: float


def top_map(points: NDArray[np.float32], box: OrientedBox) -> TopMap:
    """Return the height map of (N, 3) points in an upright box."""
    half_m = box.half_extents_m
    local = (points.astype(np.float64) - box.center) @ box.world_from_box[:3, :3]
    cell_m = float(np.clip(2 * half_m[:2].max() / _CELLS_ACROSS, *_CELL_M))
    cells = np.floor(local[:, :2] / cell_m).astype(np.int64)
    # One number for each column, in the order of x and then y: the rows themselves take far longer to sort.
    x, y = cells.T
    lowest, highest = y.min(initial=0), y.max(initial=0)
    keys = x * (highest - lowest + 1) + y - lowest
    order = np.argsort(keys)
    is_first = np.ones(len(keys), bool)
    is_first[1:] = np.diff(keys[order]) != 0
    starts = np.flatnonzero(is_first)
    heights_m = np.maximum.reduceat(local[order, 2], starts) + half_m[2] if len(starts) else np.empty(0)
    places = np.clip((cells[order[starts]] + 0.5) * cell_m / half_m[:2], -1.0, 1.0)
    return TopMap(places=places, heights_m=heights_m, cell_m2=cell_m * cell_m)


def level_areas_m2(top: TopMap, bottom_m: float) -> NDArray[np.float64]:
    """Return (`NUM_LEVELS`,) the area that is open above, by height above the floor in steps of `LEVEL_M`."""
    levels = np.floor((top.heights_m + bottom_m) / LEVEL_M).astype(np.int64)
    inside = levels[(levels >= 0) & (levels < NUM_LEVELS)]
    return np.asarray(np.bincount(inside, minlength=NUM_LEVELS) * top.cell_m2, dtype=np.float64)


def hollow_score(top: TopMap, height_m: float) -> float:
    """Return the degree in 0..1 of being hollow from above: a rim all around, and the middle far below it."""
    radius = np.abs(top.places).max(axis=1, initial=0.0)
    is_middle = radius < _MIDDLE
    if not is_middle.any():
        return 0.0
    angles = np.arctan2(top.places[:, 1], top.places[:, 0])
    sectors = np.floor((angles / (2 * np.pi) + 0.5) * _SECTORS).astype(np.int64) % _SECTORS
    is_rim = (radius > _RIM) & (top.heights_m > _RIM_HEIGHT * height_m)
    around = len(np.unique(sectors[is_rim])) / _SECTORS
    depth = 1.0 - float(np.median(top.heights_m[is_middle])) / height_m
    return min(rising(around, _BROKEN, _WHOLE), rising(depth, _SHALLOW, _DEEP))
