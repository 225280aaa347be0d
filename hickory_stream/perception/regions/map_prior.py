"""The map as a prior of region merging: fragments on two different map objects are less likely to be one object.

A frame often under-segments a small object on its support surface; Bayes' rule adds the log-odds of earlier frames. To
keep the map from confirming itself, fragments that the frame alone would join count as seen together (`Joined.alone`),
and one map object is no evidence for joining fragments on it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.base.ranges import Ranged, number
from hickory_stream.geometry import portable
from hickory_stream.geometry.bounds import bounds_of
from hickory_stream.geometry.voxels import STEP_X, STEP_Y, STEP_Z, first_not_below, keys_of_points
from hickory_stream.perception.surface import Surface
from hickory_stream.records import MapPrior, Phase, TrackedObject

_STRIDE_PX = 2
_SURE = 1e-6
# Objects with fewer sightings are ignored.
_MIN_SIGHTINGS = 4
# A region lies on an object if at least this share of its pixels does.
_MIN_SHARE = 0.5


@dataclass(frozen=True, kw_only=True, slots=True)
class MapPriorConfig(Ranged):
    """How map objects lower the probability that two regions are one object."""

    #: Log-odds against a merge for regions on two different objects; 0: no prior.
    apart_odds: float = number(3.0, 0, 8, "log-odds")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FragmentOwners:
    """The number of sampled `pixels` (n,) of each fragment, and the number `on_object` (n, objects) on each object."""

    pixels: NDArray[np.int64]
    on_object: NDArray[np.int64]
    config: MapPriorConfig

    def against(
        self, probability: NDArray[np.float64], pairs: NDArray[np.int64], numbers: NDArray[np.int64], count: int
    ) -> NDArray[np.float64]:
        """Return the probabilities (K,) of pairs (K, 2) of `count` regions after the prior; `numbers` as in `Round`."""
        owner = self._owners(numbers, count)
        a, b = owner[pairs[:, 0]], owner[pairs[:, 1]]
        differ = (a >= 0) & (b >= 0) & (a != b)
        likely = np.clip(probability, _SURE, 1 - _SURE)
        odds = portable.log(likely) - portable.log(1 - likely) - self.config.apart_odds
        return np.where(differ, 1 / (1 + portable.exp(-odds)), probability)

    def _owners(self, numbers: NDArray[np.int64], count: int) -> NDArray[np.int64]:
        # (count,) the object on which each region lies, -1 for none.
        pixels = np.zeros(count, dtype=np.int64)
        on_object = np.zeros((count, self.on_object.shape[1]), dtype=np.int64)
        np.add.at(pixels, numbers, self.pixels)
        np.add.at(on_object, numbers, self.on_object)
        most = on_object.max(axis=1, initial=0)
        lies = (most > 0) & (most >= _MIN_SHARE * pixels)
        return np.where(lies, on_object.argmax(axis=1), -1)


def fragment_owners(
    labels: NDArray[np.int32], surface: Surface, prior: MapPrior | None, config: MapPriorConfig
) -> FragmentOwners | None:
    """Return the map objects on which the fragments `labels` (h, w) lie; None if fewer than two are near."""
    if prior is None or config.apart_odds == 0:
        return None
    sampled = labels[::_STRIDE_PX, ::_STRIDE_PX]
    points = surface.points_world[::_STRIDE_PX, ::_STRIDE_PX][sampled > 0]
    sampled = sampled[sampled > 0]
    is_known = np.isfinite(points[:, 2])
    points, sampled = points[is_known], sampled[is_known]
    near = _objects_near(points, prior)
    if len(near) < 2:
        return None
    owners = _owners_of_points(points, near, prior.points_m)
    count = int(labels.max()) + 1
    on_object = np.zeros((count, len(near)), dtype=np.int64)
    owned = owners >= 0
    np.add.at(on_object, (sampled[owned], owners[owned]), 1)
    return FragmentOwners(pixels=np.bincount(sampled, minlength=count), on_object=on_object, config=config)


def _objects_near(points: NDArray[np.float32], prior: MapPrior) -> list[TrackedObject]:
    # The smallest first.
    if len(points) == 0:
        return []
    low, high = bounds_of(points)
    low, high = low - prior.points_m, high + prior.points_m
    near = []
    for item in prior.objects:
        if item.phase is Phase.TENTATIVE or item.sightings < _MIN_SIGHTINGS:
            continue
        corners = item.box.corners_world()
        if (corners.min(axis=0) <= high).all() and (corners.max(axis=0) >= low).all():
            near.append(item)
    return sorted(near, key=lambda item: (len(item.points_world), item.id))


def _owners_of_points(
    points: NDArray[np.float32], objects: Sequence[TrackedObject], voxel_m: float
) -> NDArray[np.int64]:
    # (N,) the first object with a voxel at each point, else with one beside it; -1 for none.
    # Points are nearly sorted by voxel: a stable sort is fast on them.
    keys = [np.sort(keys_of_points(item.points_world, voxel_m), kind="stable") for item in objects]
    ends = np.cumsum([len(own) for own in keys])
    return np.asarray(_first_owners(keys_of_points(points, voxel_m), np.concatenate(keys), ends, _STEPS))


# A point's voxel, then its six face neighbours: what they add to its key.
_STEPS = np.array([0, STEP_Z, -STEP_Z, STEP_Y, -STEP_Y, STEP_X, -STEP_X])


@kernel
def _first_owners(points, keys, ends, steps):
    # `keys` are those of one object after the other, each sorted, up to its end.
    owners, waiting, count = np.full(len(points), np.int64(-1)), np.arange(len(points)), len(points)
    for step in steps:
        start = 0
        for i in range(len(ends)):
            of_object, at, left = keys[start : ends[i]], np.int64(0), 0
            start = ends[i]
            for n in range(count):
                key = points[waiting[n]] + step
                at = first_not_below(of_object, key, at)
                if at < len(of_object) and of_object[at] == key:
                    owners[waiting[n]] = i
                else:
                    waiting[left] = waiting[n]
                    left += 1
            count = left
    return owners
