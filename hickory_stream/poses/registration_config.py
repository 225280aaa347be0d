"""Configuration of the registration of keyframes."""

from dataclasses import dataclass

from hickory_stream.base.ranges import Ranged, number


@dataclass(frozen=True, kw_only=True, slots=True)
class RegistrationConfig(Ranged):
    """How keyframes are registered to the surface of those before, and which of them are kept out of the map."""

    #: Whether keyframes are registered at all.
    enabled: bool = True
    #: Standard deviation of the odometry's error in position, as a share of the path.
    drift_share: float = number(0.02, 0, 1, "share")
    #: Standard deviation of the odometry's error in rotation, as a share of the angle turned.
    turn_share: float = number(0.01, 0, 1, "share")
    #: Number of earlier keyframes that are remembered; the oldest are forgotten first.
    max_anchors: int = number(300, 1, 100_000, "keyframes")
