"""Scores of views: the S-score, its upper bound, alternative strategies, and the choice of one view per direction.

    S = ln(1 + n^2 sigma^2) * R_area^alpha * R_depth^beta                    (paper, Eq. of the S-score)

Patch features have unit norm, so sigma^2, the trace of their covariance, is at most 1; n^2 scales it to the paper's
features. Features are computed only if the bound with sigma^2 = 1 beats the best view. A cut view scores less.
"""

import math
from dataclasses import dataclass
from typing import Literal, assert_never

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.geometry.portable_kernels import arctan2, log1p, power
from hickory_stream.records import Observation, View

Strategy = Literal["s_score", "initial", "max_area", "max_box", "max_volume"]

_SECTORS = 8
# Factor on S for a view that touches the image border.
CUT_FACTOR = 0.7
# A kept view of a direction is replaced by one that is more useful by this factor.
_BETTER_BY = 1.4


@dataclass(frozen=True, kw_only=True, slots=True)
class ViewConfig(Ranged):
    """How views are chosen."""

    #: `s_score`, or a baseline of the paper: the initial view, the largest mask, 2D box or 3D box.
    strategy: Strategy = "s_score"
    #: Exponent of the projected area in S.
    alpha: float = number(0.3, 0, 10, "exponent")
    #: Exponent of the depth coverage in S.
    beta: float = number(0.5, 0, 10, "exponent")
    #: n^2 of S: DINOv2 normalises its features to about unit variance in each of their 768 dimensions, so that
    #: ln(1 + n^2 sigma^2) separates textured from textureless views. With n^2 = 1 it is almost linear in sigma^2, and a
    #: small mask with a colourful edge would beat a whole one.
    feature_norm2: float = number(768.0, 0.001, 1e6, "ratio")


def s_score(variance: float, r_area: float, r_depth: float, config: ViewConfig) -> float:
    """Return S of a view that the image border does not cut, from the variance of features of unit norm."""
    return float(log1p(config.feature_norm2 * variance) * power(r_area, config.alpha) * power(r_depth, config.beta))


def score_bound(view: View, config: ViewConfig) -> float:
    """Return the upper bound of a view's score, without features."""
    return score(view, 1.0, config)


def score(view: View, variance: float, config: ViewConfig) -> float:
    """Return the score of a view by the chosen strategy; the best view has the highest."""
    x0, y0, x1, y1 = view.box_px
    match config.strategy:
        case "s_score":
            weight = CUT_FACTOR if view.is_cut else 1.0
            return weight * s_score(variance, view.r_area, view.r_depth, config)
        case "initial":
            return -float(view.frame_index)
        case "max_area":
            return view.r_area
        case "max_box":
            return float((x1 - x0) * (y1 - y0))
        case "max_volume":
            return view.box_volume_m3
        case _:
            assert_never(config.strategy)


def better(a: View | None, b: View | None) -> View | None:
    """Return the view with the higher score; the earlier one if they are equal."""
    if a is None or b is None:
        return a or b
    a_key, b_key = (-(a.score or 0.0), a.frame_index, a.box_px), (-(b.score or 0.0), b.frame_index, b.box_px)
    if a.score is None or b.score is None:
        return a if b.score is None else b
    return a if a_key <= b_key else b


def sector_of(view: View, center: np.ndarray[tuple[int], np.dtype[np.float64]]) -> int:
    """Return the index of the sector, one of eight around the object, of a view."""
    dx, dy = view.world_from_camera[:2, 3] - center[:2]
    return math.floor((arctan2(float(dy), float(dx)) + math.pi) / (2 * math.pi) * _SECTORS) % _SECTORS


def usefulness(view: View) -> float:
    """Return how much a view shows of its side of the object: large, with depth, and not cut by the border."""
    return math.sqrt(view.r_area) * view.r_depth * (0.35 if view.is_cut else 1.0)


def covers_better(view: View, incumbent: View | None) -> bool:
    """Return whether a view should take the place of the one kept for its sector."""
    return incumbent is None or usefulness(view) > _BETTER_BY * usefulness(incumbent)


def view_of(
    observation: Observation, track_id: int, *, frame_index: int, stamp_ns: int, world_from_camera: NDArray[np.float64]
) -> View:
    """Return an observation of a track as a view without a score."""
    return View(
        object_id=track_id,
        frame_index=frame_index,
        stamp_ns=stamp_ns,
        box_px=observation.box_px,
        world_from_camera=world_from_camera,
        r_area=observation.r_area,
        r_depth=observation.r_depth,
        box_volume_m3=observation.box.volume_m3,
        score=None,
        variance=None,
        feature=None,
        is_cut=observation.is_cut,
        observation_index=observation.index,
    )
