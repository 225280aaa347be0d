"""The layer-1 cloud of a track: one mean point per voxel of the world's lattice, with its sightings and information.

One lattice for all: clouds of one surface fall into the same cells, and surface alone bounds a cloud's size. A point is
worth 1 / sigma^2 of its depth, so that far returns count little where near ones are. Clouds
that were not seen recently are compressed, to a fifth to a half, and read back to the byte; the object stays the same.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from threading import RLock
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable
from hickory_stream.geometry.bounds import extent_of
from hickory_stream.geometry.flush import Plane
from hickory_stream.geometry.lattice import STEPS_PER_M, on_steps
from hickory_stream.geometry.lazy_arrays import Keep, compressed, in_memory, restored
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.voxels import (
    are_near,
    cells_of_keys,
    coarse_keys,
    contains,
    keys_of_cells,
    keys_of_points,
    places,
    sorted_unique,
    sums_of_equal,
)

NAMES = ("keys", "points", "colors", "hits", "weights")

_NO_WEIGHTS = np.empty(0, np.float32)
# A depth of which nothing is known is sure to 2^-7 m, 8 mm.
_WEIGHT = np.float32(2**14)
_lock = RLock()
_cold: "WeakKeyDictionary[Any, _Packed]" = WeakKeyDictionary()


@dataclass(frozen=True, slots=True)
class _Packed:
    # `count` None: the number of keys. `array` restores an array by its name.
    count: int | None
    array: Callable[[str], NDArray[Any]]


def pack(cloud: Any, keep: Keep = in_memory) -> None:
    """Compress the arrays of a cloud into `keep`; arrays that were restored from an earlier packing are released."""
    with _lock:
        if cloud in _cold:
            _let_go(cloud)
        elif len(cloud.keys):
            packed = {name: compressed(getattr(cloud, name), keep) for name in NAMES}
            _keep(cloud, _Packed(len(cloud.keys), lambda name: restored(packed[name])))


def pack_part(part: Any, whole: Any, keep: Keep = in_memory) -> None:
    """Compress a cloud, as a selection of `whole`'s voxels where it is one, and `whole`."""
    with _lock:
        if part in _cold or part is whole:
            pack(part, keep)
            return pack(whole, keep)
        marks = np.isin(whole.keys, part.keys, assume_unique=True)
        chosen = {name: getattr(whole, name)[marks] for name in NAMES}
        if all(np.array_equal(chosen[name], getattr(part, name)) for name in NAMES):
            bits, count = np.packbits(marks), len(marks)

            def chosen_of(name: str) -> NDArray[Any]:
                kept: NDArray[Any] = array_of(whole, name)[np.unpackbits(bits, count=count).astype(bool)]
                return kept

            _keep(part, _Packed(len(part.keys), chosen_of))
        else:
            pack(part, keep)
        return pack(whole, keep)


def leave_unread(cloud: Any, count: int | None, array: Callable[[str], NDArray[Any]]) -> None:
    """Make a cloud of `count` points whose arrays `array` reads by name when they are first used."""
    with _lock:
        _cold[cloud] = _Packed(count, array)


def unpacked(cloud: Any, name: str) -> NDArray[Any]:
    """Return an array of a packed cloud, after restoring all of them; raises `AttributeError` for another name."""
    if name not in NAMES:
        raise AttributeError(name)
    with _lock:
        if is_packed(cloud):
            arrays = {each: _cold[cloud].array(each) for each in NAMES}
            for each, array in arrays.items():
                object.__setattr__(cloud, each, array)
        there: NDArray[Any] = object.__getattribute__(cloud, name)
    return there


def _count_of(cloud: Any) -> int:
    """Return the number of points of a cloud, without unpacking it."""
    packed = _cold.get(cloud)
    return len(cloud.keys) if packed is None or packed.count is None else packed.count


def is_packed(cloud: Any) -> bool:
    """Return whether some arrays of a cloud are only there compressed."""
    return cloud in _cold and not all(_is_at_hand(cloud, name) for name in NAMES)


def array_of(cloud: Any, name: str) -> NDArray[Any]:
    """Return an array of a cloud without unpacking the cloud."""
    packed = _cold.get(cloud)
    return getattr(cloud, name) if packed is None or _is_at_hand(cloud, name) else packed.array(name)


def _is_at_hand(cloud: Any, name: str) -> bool:
    try:
        object.__getattribute__(cloud, name)
    except AttributeError:
        return False
    return True


def _keep(cloud: Any, packed: _Packed) -> None:
    _cold[cloud] = packed
    _let_go(cloud)


def _let_go(cloud: Any) -> None:
    for name in NAMES:
        try:
            object.__delattr__(cloud, name)
        except AttributeError:
            pass  # let go before


# From so many sightings on the size of a track is settled.
SETTLED_SIGHTINGS = 5
_MOST_TAIL, _MUCH_SMALLER = 0.35, 0.4

NO_PLANE = (0.0,) * 5


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, weakref_slot=True)
class Cloud:
    """Sorted voxel `keys` (N,), mean `points` on lattice steps and `colors` (N, 3), and frames per voxel `hits`.

    `weights` (N,): the sums of 1 / sigma^2 of the frames' depth; without them depth is sure to 8 mm. `behind`: sums
    over frames of the plane that the surface is flush with, normal and offset times weight, and of the weights.
    """

    keys: NDArray[np.int64]
    points: NDArray[np.float32]
    colors: NDArray[np.float32]
    hits: NDArray[np.int32]
    weights: NDArray[np.float32] = field(default_factory=lambda: _NO_WEIGHTS)
    behind: tuple[float, float, float, float, float] = NO_PLANE

    def __post_init__(self) -> None:
        if self.weights is _NO_WEIGHTS:
            object.__setattr__(self, "weights", self.hits.astype(np.float32) * _WEIGHT)

    def __len__(self) -> int:
        return _count_of(self)

    def __getattr__(self, name: str) -> Any:
        # Python asks here only for missing attributes.
        return unpacked(self, name)


def cloud_of(
    points: NDArray[Any],
    colors: NDArray[Any],
    voxel_m: float,
    weights: NDArray[np.float32] | None = None,
    behind: Plane | None = None,
) -> Cloud:
    """Return the cloud of one frame's points; `behind` is the plane that they are flush with."""
    weights = np.full(len(points), _WEIGHT) if weights is None else weights
    keys, hits = keys_of_points(points, voxel_m), np.ones(len(points), np.int32)
    total = float(weights.sum(dtype=np.float64))
    x, y, z, offset = (value * total for value in behind or NO_PLANE[:4])
    points, colors, plane = points.astype(np.float32), colors.astype(np.float32), (x, y, z, offset, total)
    cloud = Cloud(keys=keys, points=points, colors=colors, hits=hits, weights=weights, behind=plane)
    # Lifted masks are voxel means: they have one point per voxel already.
    return cloud if (keys[1:] > keys[:-1]).all() else _of_equal_keys(cloud)


def _of_equal_keys(cloud: Cloud) -> Cloud:
    # Points that fall into one voxel become one mean; `keys` need not be sorted. Their errors are common.
    order = np.argsort(cloud.keys, kind="stable")
    unique, starts = np.unique(cloud.keys[order], return_index=True)
    weights = cloud.weights[order].astype(np.float64)
    totals = np.add.reduceat(weights, starts)

    def mean(values: NDArray[Any]) -> NDArray[np.float32]:
        return (np.add.reduceat(values[order] * weights[:, None], starts) / totals[:, None]).astype(np.float32)

    return Cloud(
        keys=unique,
        points=on_steps(mean(cloud.points)),
        colors=mean(cloud.colors),
        hits=np.maximum.reduceat(cloud.hits[order], starts),
        weights=np.maximum.reduceat(cloud.weights[order], starts),
        behind=cloud.behind,
    )


def fuse(a: Cloud, b: Cloud) -> Cloud:
    """Return the union of two clouds: means weighted by information."""
    arrays = _fused(*(getattr(cloud, name) for cloud in (a, b) for name in NAMES))
    return Cloud(**dict(zip(NAMES, arrays, strict=True)), behind=_sum(a.behind, b.behind))


def _sum(a: tuple[float, ...], b: tuple[float, ...], sign: float = 1.0) -> Any:
    return tuple(x + sign * y for x, y in zip(a, b, strict=True))


def moved_cloud(cloud: Cloud, new_from_old: NDArray[np.float64], voxel_m: float) -> Cloud:
    """Return the cloud in another frame, on the lattice there: points that fall into one voxel become one mean."""
    points = on_steps(apply(new_from_old, cloud.points))
    normal = portable.matmul(new_from_old[:3, :3], np.array(cloud.behind[:3])[:, None])[:, 0]
    offset = cloud.behind[3] + portable.dot(normal, new_from_old[:3, 3])
    behind = (*normal.tolist(), float(offset), cloud.behind[4])
    return _of_equal_keys(replace(cloud, keys=keys_of_points(points, voxel_m), points=points, behind=behind))


def grown_since(now: Cloud, then: Cloud, voxel_m: float) -> Cloud:
    """Return the voxels of a cloud that were hit since `then`, with the means of these hits."""
    known = contains(then.keys, now.keys)
    at = places(then.keys, now.keys[known])
    before, weight = np.zeros(len(now.keys), dtype=np.int64), np.zeros(len(now.keys))
    before[known], weight[known] = then.hits[at], then.weights[at]
    means = np.concatenate([now.points, now.colors], axis=1).astype(np.float64)
    sums = means * now.weights[:, None]
    sums[known] -= np.concatenate([then.points, then.colors], axis=1)[at].astype(np.float64) * weight[known][:, None]
    gained, worth = now.hits - before, now.weights - weight
    is_new = (gained > 0) & (worth > 0)
    values = (sums[is_new] / worth[is_new][:, None]).astype(np.float32)
    values[:, :3] = on_steps(values[:, :3])
    keys = now.keys[is_new]
    # A mean that rounding, or a cloud that was trimmed in between, has taken out of its voxel is none.
    is_off = keys_of_points(np.ascontiguousarray(values[:, :3]), voxel_m) != keys
    values[is_off] = means[is_new][is_off]
    return Cloud(
        keys=keys,
        points=np.ascontiguousarray(values[:, :3]),
        colors=np.ascontiguousarray(np.clip(values[:, 3:], 0, 255)),
        hits=gained[is_new].astype(np.int32),
        weights=worth[is_new].astype(np.float32),
        behind=_sum(now.behind, then.behind, -1.0),
    )


def without(cloud: Cloud, drop: NDArray[np.bool_]) -> Cloud:
    """Return the cloud without the marked voxels."""
    kept = np.flatnonzero(~drop)
    return replace(cloud, **{name: getattr(cloud, name).take(kept, axis=0) for name in NAMES})


def solid_part(cloud: Cloud, sightings: int) -> Cloud:
    """Return the voxels that were seen in more than one frame: a voxel seen only once is likely to be noise.

    Where this would remove more than half of the voxels, the cloud is new or far away. Then only an outlying tail is
    removed: cells of eight voxels without one that was seen again, if the cloud is much smaller without them.
    """
    if sightings < 4:
        return cloud
    once = cloud.hits < (2 if sightings < 12 else 3)
    if once.mean() <= 0.5:
        return without(cloud, once)
    if sightings < SETTLED_SIGHTINGS:
        return cloud
    cells = coarse_keys(cloud.keys, 3)
    alone = sums_of_equal(cells, (~once).astype(np.int64)) == 0
    is_tail = 0 < alone.mean() <= _MOST_TAIL and _volume(cloud.points[~alone]) < _MUCH_SMALLER * _volume(cloud.points)
    return without(cloud, alone) if is_tail else cloud


def _volume(points: NDArray[np.float32]) -> float:
    return float(np.prod(extent_of(points)))


def is_near(keys: NDArray[np.int64], cloud: Cloud) -> NDArray[np.bool_]:
    """Return (N,) for each voxel key whether the voxel or one of its 26 neighbours is in the cloud."""
    return are_near(cloud.keys, keys)


def share_near(keys: NDArray[np.int64], cloud: Cloud, halvings: int = 0) -> float:
    """Return the share of voxels that lie on a cloud, from an even sample of about 400 voxels.

    Both are compared in cells of 2^halvings voxels a side.
    """
    if len(keys) == 0:
        return 0.0
    some, there = keys[:: max(1, len(keys) // 400)], cloud.keys
    if halvings > 0:
        some, there = (keys_of_cells(cells_of_keys(own) >> halvings) for own in (some, there))
        there = sorted_unique(there)
    return float(are_near(there, some).mean())


def sigma_of(cloud: Cloud) -> float:
    """Return the median standard deviation of depth in a single frame, in metres, from about 400 voxels."""
    step = max(1, len(cloud.keys) // 400)
    return float(np.median(np.sqrt(cloud.hits[::step] / cloud.weights[::step])))


@kernel
def _fused(a_keys, a_points, a_colors, a_hits, a_weights, b_keys, b_points, b_colors, b_hits, b_weights):
    size = len(a_keys) + len(b_keys)
    keys = np.empty(size, dtype=np.int64)
    points = np.empty((size, 3), dtype=np.float32)
    colors = np.empty((size, 3), dtype=np.float32)
    hits, weights = np.empty(size, dtype=np.int32), np.empty(size, dtype=np.float32)
    i, j, n = 0, 0, 0
    while i < len(a_keys) or j < len(b_keys):
        takes_a = j == len(b_keys) or (i < len(a_keys) and a_keys[i] <= b_keys[j])
        takes_b = i == len(a_keys) or (j < len(b_keys) and b_keys[j] <= a_keys[i])
        if takes_a and takes_b:
            own, new = np.float64(a_weights[i]), np.float64(b_weights[j])
            for k in range(3):
                point = np.float64(a_points[i, k]) * own + np.float64(b_points[j, k]) * new
                color = np.float64(a_colors[i, k]) * own + np.float64(b_colors[j, k]) * new
                points[n, k] = (np.rint(point / (own + new) * STEPS_PER_M) + 0.0) / STEPS_PER_M
                colors[n, k] = color / (own + new)
            keys[n], hits[n], weights[n] = a_keys[i], a_hits[i] + b_hits[j], own + new
        elif takes_a:
            keys[n], hits[n], weights[n] = a_keys[i], a_hits[i], a_weights[i]
            for k in range(3):  # several times as fast as assigning whole rows
                points[n, k], colors[n, k] = a_points[i, k], a_colors[i, k]
        else:
            keys[n], hits[n], weights[n] = b_keys[j], b_hits[j], b_weights[j]
            for k in range(3):
                points[n, k], colors[n, k] = b_points[j, k], b_colors[j, k]
        i += takes_a
        j += takes_b
        n += 1
    return keys[:n].copy(), points[:n].copy(), colors[:n].copy(), hits[:n].copy(), weights[:n].copy()
