"""How sure it is that there is a thing: evidence from sightings, in units of one more sighting from the same place.

A segmenter that is wrong from one place is wrong again from there, so that sightings from places near each other say
nearly the same; one from elsewhere is a new witness. What is seen small, or has little sure depth, is a weaker one, and
a keyframe that looked through the place speaks against. With independent witnesses evidence is a log-odds that adds up
(as in occupancy grids: Moravec and Elfes, ICRA 1985).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry import portable
from hickory_stream.ranges import Ranged, number

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.records import Observation

# More places tell nothing new of a thing that was confirmed long ago.
_MOST_PLACES = 12


@dataclass(frozen=True, kw_only=True, slots=True)
class ExistenceConfig(Ranged):
    """What a sighting is worth.

    Attributes:
        apart_rad: directions to a thing that differ by this are witnesses of their own; less, in proportion.
        apart_ratio: so are distances of this ratio: what is seen from close by is seen anew.
        fresh: what a sighting from a place of its own is worth.
        again: what one more from the same place is worth.
        full_sr: a thing that fills less of the view than this solid angle is a weaker witness ...
        least: ... but none is weaker than this share.
    """

    apart_rad: float = number(0.6, 0.001, 3.15, "rad")
    apart_ratio: float = number(2.0, 1.001, 1000, "ratio")
    fresh: float = number(2.0, 0, 1000, "sightings")
    again: float = number(0.7, 0, 1000, "sightings")
    full_sr: float = number(0.004, 0, 12.6, "sr")
    least: float = number(0.5, 0, 1, "share")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Existence:
    """The `evidence` for a thing, and the `places` (N, 3) of the camera from which it was seen as another witness."""

    evidence: float
    places: NDArray[np.float64]


def no_evidence() -> Existence:
    """Return what is known of what nobody has seen."""
    return Existence(evidence=0.0, places=np.zeros((0, 3)))


def sighted(known: Existence, seen: Observation, camera: NDArray[np.float64], config: ExistenceConfig) -> Existence:
    """Return what is known after one more sighting from a camera at (3,), in the world."""
    way = seen.box.center - camera
    novelty = _novelty(known.places, seen.box.center, camera, config)
    worth = config.again + (config.fresh - config.again) * novelty
    is_place = novelty >= 1.0 and len(known.places) < _MOST_PLACES
    return Existence(
        evidence=known.evidence + worth * _sharpness(seen, portable.norm(way), config),
        places=np.concatenate([known.places, camera[None]]) if is_place else known.places,
    )


def united(a: Existence, b: Existence) -> Existence:
    """Return what is known of one thing that was two."""
    return a if a.evidence >= b.evidence else b


def doubted(known: Existence) -> Existence:
    """Return what is known after a keyframe looked through the place."""
    return Existence(evidence=max(known.evidence - 1.0, 0.0), places=known.places)


def _novelty(
    places: NDArray[np.float64], middle: NDArray[np.float64], camera: NDArray[np.float64], config: ExistenceConfig
) -> float:
    """Return how far a place is from every other one, as seen from the thing: 0 for the same, 1 for another witness."""
    way = middle - camera
    reach_m = max(portable.norm(way), 1e-6)
    novelty = 1.0
    for place in places:
        other = middle - place
        other_m = max(portable.norm(other), 1e-6)
        cosine = min(max(portable.dot(way, other) / (reach_m * other_m), -1.0), 1.0)
        # The chord between two directions; for small angles the angle itself.
        turned = float(np.sqrt(2.0 - 2.0 * cosine)) / config.apart_rad
        nearer = (max(reach_m, other_m) / min(reach_m, other_m) - 1.0) / (config.apart_ratio - 1.0)
        novelty = min(novelty, max(turned, nearer))
    return novelty


def _sharpness(seen: Observation, distance_m: float, config: ExistenceConfig) -> float:
    """Return what a sighting is worth by the solid angle that it fills and the share of it with sure depth."""
    x, y, z = (float(side) for side in 2 * seen.box.half_extents_m)
    # The mean face of the box that was seen, as one looks at it.
    solid_angle = (x * y + y * z + z * x) / 3 / max(distance_m * distance_m, 1e-6)
    share = min(solid_angle / config.full_sr, 1.0) if config.full_sr > 0 else 1.0
    return max(share * seen.r_depth, config.least)
