"""Configuration of the pose graph."""

from dataclasses import dataclass

from hickory_stream.base.ranges import Ranged, number


@dataclass(frozen=True, kw_only=True, slots=True)
class GraphConfig(Ranged):
    """How far odometry is trusted.

    The sigma of an edge of odometry is the root of the summed squares of a floor, a part that grows with the path (a
    wrong scale or a turning heading, which stay alike over some metres) and a part that grows with its root (noise).
    """

    #: Error in position, for each metre of the path.
    drift_share: float = number(0.003, 0, 1, "share")
    #: Noise of position, for the root of the path.
    path_noise: float = number(0.05, 0, 1, "m/sqrt(m)")
    #: Error in rotation, for each metre of the path.
    turn_drift_per_m: float = number(0.0003, 0, 1, "1/m")
