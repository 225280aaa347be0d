"""What the pose graph is configured by."""

from __future__ import annotations

from dataclasses import dataclass

from hickory_stream.base.ranges import Ranged, number


@dataclass(frozen=True, kw_only=True, slots=True)
class GraphConfig(Ranged):
    """How far odometry is trusted, and when a loop is.

    The sigma of an edge of odometry is the root of the summed squares of a floor, a part that grows with the way (a
    wrong scale or a turning heading, which stay alike over some metres) and a part that grows with its root (noise).

    Attributes:
        floor_m, floor_rad: no edge is known better than this.
        way_share: of the place, for each metre of the way.
        way_noise: of the place, for the root of the way.
        turn_drift_per_m: of the angle, for each metre of the way, in radians.
        turn_noise: of the angle, for the root of the way.
        turn_share: of the angle, for each radian turned.
        registered_times: where every keyframe was registered to the surface of those before, the covariance that this
            gave counts so many times: what it was registered to errs alike.
        degenerate_share: error of the place (and angle), as a share of the way (and the turn) along which scans did not
            say where it went.
        jump_m, jump_rad: what is left open where the odometry jumped.
        gate_chi2: a loop is impossible whose squared Mahalanobis distance from what odometry predicts is above this
            (chi-squared with 6 degrees of freedom: 22.46 is 99.9 %).
        inlier_chi2: a loop is contradicted if its residual in the solution is above this (16.81 is 99 %).
    """

    floor_m: float = number(0.01, 1e-4, 10, "m")
    floor_rad: float = number(0.002, 1e-5, 1, "rad")
    way_share: float = number(0.003, 0, 1, "share")
    way_noise: float = number(0.05, 0, 1, "m/sqrt(m)")
    turn_drift_per_m: float = number(0.0003, 0, 1, "1/m")
    turn_noise: float = number(0.0045, 0, 1, "rad/sqrt(m)")
    turn_share: float = number(0.005, 0, 1, "share")
    registered_times: float = number(4.0, 1, 1000, "ratio")
    degenerate_share: float = number(0.3, 0, 1, "share")
    jump_m: float = number(30.0, 0.01, 1e4, "m")
    jump_rad: float = number(3.0, 0.001, 10, "rad")
    gate_chi2: float = number(22.46, 1, 1e6, "chi2")
    inlier_chi2: float = number(16.81, 1, 1e6, "chi2")
