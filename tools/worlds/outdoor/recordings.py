"""What records a street: a depth camera of short range, carried at a slow walk."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from hickory_stream.worlds.depth_camera import D455

if TYPE_CHECKING:
    from tools.worlds.recording_config import RecordingConfig


def outdoors(config: RecordingConfig) -> RecordingConfig:
    """Return a config with the camera and the walk of a street: a D455 at 0.7 m/s, which looks a little downwards."""
    walk = replace(config.walk, speed_mps=0.7, pitch_deg=(-28.0, -10.0))
    return replace(config, depth=D455, walk=walk)
