"""Evidence for the existence of an object; the unit is one more sighting from the same viewpoint.

Errors of a segmenter are correlated between nearby viewpoints, so only a new viewpoint gives independent evidence. It
adds up as log-odds do (occupancy grids: Moravec and Elfes, ICRA 1985).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.geometry import portable
from hickory_stream.records import Observation

# Maximum number of stored viewpoints: an object seen from this many was confirmed long ago.
_MOST_PLACES = 12
# Viewing directions that differ by this angle are independent, and so are viewing distances with this ratio; less
# counts in proportion.
_APART_RAD = 0.6
_APART_RATIO = 2.0
# Sightings of objects that subtend less than this solid angle are weaker evidence, in proportion.
_FULL_SR = 0.004


@dataclass(frozen=True, kw_only=True, slots=True)
class ExistenceConfig(Ranged):
    """How much evidence one sighting contributes."""

    #: Evidence of a sighting from an independent viewpoint.
    new_view_gain: float = number(2.0, 0, 1000, "sightings")
    #: Evidence of one more sighting from the same viewpoint.
    same_view_gain: float = number(0.7, 0, 1000, "sightings")
    #: Small objects give weaker evidence, down to this share.
    min_gain: float = number(0.5, 0, 1, "share")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Existence:
    """The `evidence` for an object, and the independent `places` (N, 3) of the camera from which it was seen."""

    evidence: float
    places: NDArray[np.float64]


def no_evidence() -> Existence:
    """Return the existence of an object without sightings."""
    return Existence(evidence=0.0, places=np.zeros((0, 3)))


def sighted(known: Existence, seen: Observation, camera: NDArray[np.float64], config: ExistenceConfig) -> Existence:
    """Return the existence after one more sighting from a camera at (3,), in the world."""
    novelty = _novelty(known.places, seen.box.center, camera)
    weight = config.same_view_gain + (config.new_view_gain - config.same_view_gain) * novelty
    sharpness = _sharpness(seen, portable.norm(seen.box.center - camera), config)
    is_place = novelty >= 1.0 and len(known.places) < _MOST_PLACES
    places = np.concatenate([known.places, camera[None]]) if is_place else known.places
    return Existence(evidence=known.evidence + weight * sharpness, places=places)


def united(a: Existence, b: Existence) -> Existence:
    """Return the existence of a merged track: the one with more evidence."""
    return a if a.evidence >= b.evidence else b


def plus_since(known: Existence, now: Existence, then: Existence) -> Existence:
    """Return the existence of a track, plus the gain of another one from `then` to `now`."""
    gained = max(now.evidence - then.evidence, 0.0)
    places = np.concatenate([known.places, now.places[len(then.places) :]])[:_MOST_PLACES]
    return Existence(evidence=known.evidence + gained, places=places)


def with_evidence_against(known: Existence) -> Existence:
    """Return the existence after a keyframe saw through the place."""
    return Existence(evidence=max(known.evidence - 1.0, 0.0), places=known.places)


def _novelty(places: NDArray[np.float64], middle: NDArray[np.float64], camera: NDArray[np.float64]) -> float:
    # 0: the same viewpoint as a stored one, 1: an independent one.
    way = middle - camera
    reach_m = max(portable.norm(way), 1e-6)
    novelty = 1.0
    for place in places:
        other = middle - place
        other_m = max(portable.norm(other), 1e-6)
        cosine = min(max(portable.dot(way, other) / (reach_m * other_m), -1.0), 1.0)
        # The chord between two unit directions: approximately the angle where that is small.
        turned = float(np.sqrt(2.0 - 2.0 * cosine)) / _APART_RAD
        nearer = (max(reach_m, other_m) / min(reach_m, other_m) - 1.0) / (_APART_RATIO - 1.0)
        novelty = min(novelty, max(turned, nearer))
    return novelty


def _sharpness(seen: Observation, distance_m: float, config: ExistenceConfig) -> float:
    x, y, z = (float(side) for side in 2 * seen.box.half_extents_m)
    # The visible area is approximated by the mean area of the faces of the observed box.
    solid_angle = (x * y + y * z + z * x) / 3 / max(distance_m * distance_m, 1e-6)
    return max(min(solid_angle / _FULL_SR, 1.0) * seen.r_depth, config.min_gain)
