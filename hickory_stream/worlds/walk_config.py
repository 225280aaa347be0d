"""The configuration of a person's walk through a world."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class WalkConfig:
    """The speed, height, clearance and gaze of a walk."""

    speed_mps: float = 0.52
    eye_height_m: float = 1.38
    clearance_m: float = 0.28
    """The least distance from the camera's path to anything below 1.8 m."""
    max_yaw_rate_dps: float = 36.0
    bob_m: float = 0.012
    step_hz: float = 1.7
    pitch_deg: tuple[float, float] = (-30.0, -8.0)
    """The limits of pitch; negative is down."""
