"""Configuration of the search for loops."""

from dataclasses import dataclass

from hickory_stream.base.ranges import Ranged, number

# Minimum number of points of upright surface that agree.
MIN_AGREEING_POINTS = 150


@dataclass(frozen=True, kw_only=True, slots=True)
class LoopConfig(Ranged):
    """How loops are searched, and when one is accepted."""

    #: A submap is registered to at most this many earlier ones, those that it overlaps most.
    max_candidates: int = number(4, 1, 1000, "submaps")
    #: Minimum share of agreeing points, of those whose place the other submap has observed.
    min_agreement: float = number(0.8, 0, 1, "share")
