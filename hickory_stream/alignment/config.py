"""The configuration of alignment and of each of its steps."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.affinity import AffinityConfig
from hickory_stream.alignment.consensus import ConsensusConfig
from hickory_stream.alignment.contradiction import ContradictionConfig
from hickory_stream.alignment.refinement import RefinementConfig
from hickory_stream.base.ranges import Ranged, number

_NUM_SCALES = 4


@dataclass(frozen=True, kw_only=True, slots=True)
class AcceptanceConfig(Ranged):
    """When an alignment is accepted.

    Attributes:
        max_log10_chance: maximum log10 of the expected number of false alarms: of sets of pairs as good as these
            between two unrelated maps.
        min_margin: minimum significance, in decades, of the evidence that separates the best from any rival.
        min_pairs: minimum number of pairs.
        min_spread_m: minimum standard deviation of the pairs across their main horizontal direction.
        max_turn_deg: maximum standard deviation of the rotation.
        tilt_price: a tilt between the maps adds this to log10 of the false alarms, since robots measure gravity.
        max_tilt_deg: maximum angle between the verticals of two maps.
        least_tilt_deg, most_tilt_deg: what the tilt between two maps is expected to be about each level axis, as a
            standard deviation: any scale from the least to the most is as likely.
        distinct_m, distinct_deg: transforms closer than this are the same.
        num_rivals: maximum number of distinct transforms to search for ...
        num_insignificant: ... and maximum number of insignificant ones among them.
    """

    max_log10_chance: float = number(-2.0, -1000, 1000, "log10")
    min_margin: float = number(2.0, 0, 1000, "log10")
    min_pairs: int = number(4, 1, 1_000_000, "pairs")
    min_spread_m: float = number(0.3, 0, 1000, "m")
    max_turn_deg: float = number(2.0, 0, 180, "deg")
    tilt_price: float = number(4.0, 0, 1000, "log10")
    max_tilt_deg: float = number(25.0, 0, 180, "deg")
    least_tilt_deg: float = number(0.1, 0.0001, 90, "deg")
    most_tilt_deg: float = number(10.0, 0.0001, 90, "deg")
    distinct_m: float = number(0.5, 0, 1000, "m")
    distinct_deg: float = number(5.0, 0, 180, "deg")
    num_rivals: int = number(12, 1, 1000, "transforms")
    num_insignificant: int = number(4, 1, 1000, "transforms")

    @property
    def tilt_sigmas_rad(self) -> NDArray[np.float64]:
        """The scales (S,) that the tilt may have, as standard deviations about each level axis, ascending."""
        return np.radians(np.geomspace(self.least_tilt_deg, self.most_tilt_deg, _NUM_SCALES))


@dataclass(frozen=True, kw_only=True, slots=True)
class AlignConfig:
    """Everything that alignment is configured by."""

    affinity: AffinityConfig = field(default_factory=AffinityConfig)
    consensus: ConsensusConfig = field(default_factory=ConsensusConfig)
    acceptance: AcceptanceConfig = field(default_factory=AcceptanceConfig)
    contradiction: ContradictionConfig = field(default_factory=ContradictionConfig)
    refinement: RefinementConfig = field(default_factory=RefinementConfig)
