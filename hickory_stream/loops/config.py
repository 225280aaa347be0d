"""How loops are searched, and when they are believed."""

from __future__ import annotations

from dataclasses import dataclass

from hickory_stream.base.ranges import Ranged, number


@dataclass(frozen=True, kw_only=True, slots=True)
class LoopConfig(Ranged):
    """How loops are searched, and when one is believed.

    Attributes:
        least_apart: a submap is not searched in those before it that are fewer than this away.
        most_candidates: a submap is registered to so many earlier ones at most, those that it overlaps most.
        least_overlap: the share of a submap's surface that must lie in the other one for them to be a candidate.
        most_sigma_m: where the graph is less sure than this of where two submaps lie, only their objects can tell.
        least_points: so many points of upright surface must have met.
        least_agreement: of the points of which the other submap knows what is there, the share that must have met.
        rival_share: another place nearby with more than this share of the best one's support makes a loop ambiguous.
        correct_m, correct_deg: a solution of the graph that moves no submap by more than this, against those around
            it, is no correction: the map resolves no less.
    """

    least_apart: int = number(2, 1, 1000, "submaps")
    most_candidates: int = number(4, 1, 1000, "submaps")
    least_overlap: float = number(0.15, 0, 1, "share")
    most_sigma_m: float = number(0.7, 0.01, 100, "m")
    least_points: int = number(150, 10, 1_000_000, "points")
    least_agreement: float = number(0.8, 0, 1, "share")
    rival_share: float = number(0.85, 0, 1, "share")
    correct_m: float = number(0.02, 0, 1, "m")
    correct_deg: float = number(0.3, 0, 90, "deg")
