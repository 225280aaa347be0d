"""What the registration of keyframes came to in a run, in numbers and in one line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.engine.journal import Journal
from hickory_stream.errors import MapFolderError
from hickory_stream.events import KeyframeRegistered
from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import rotation_angle_rad

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


@dataclass(frozen=True, kw_only=True, slots=True)
class RegistrationSummary:
    """Of the keyframes of a run, how many were mapped elsewhere than the odometry has them, and were kept out.

    `carried_away`: how often the robot was found elsewhere than its odometry says. `moved_m`, `turned_deg`: how far the
    last keyframe is mapped from where the odometry has it.
    """

    keyframes: int
    corrected: int
    kept_out: int
    carried_away: int
    moved_m: float
    turned_deg: float

    def text(self) -> str:
        """Return it as one line, "" where every keyframe is mapped where the odometry has it."""
        if not self.corrected and not self.kept_out:
            return ""
        told = (
            f"odometry: {self.corrected} of {self.keyframes} keyframes were registered to the map, in the end by "
            f"{self.moved_m:.3f} m and {self.turned_deg:.2f} degrees"
        )
        if self.kept_out:
            told += f"; {self.kept_out} did not fit and were kept out"
        if self.carried_away:
            told += (
                f"; {self.carried_away} time(s) the robot was elsewhere than its odometry says: a submap begins there"
            )
        return told


def registration_summary(path: Path, ledger: Mapping[str, Any]) -> RegistrationSummary | None:
    """Return what registration came to in a run with this `ledger`; None where its journal tells of none."""
    frames = ledger.get("frames", {})
    last = _last_registered(path)
    if last is None:
        return None
    odometry, placed = last.odometry_from_camera, last.map_from_camera
    turn = portable.matmul(placed[:3, :3], odometry[:3, :3].T)
    return RegistrationSummary(
        keyframes=frames.get("keyframes", 0),
        corrected=frames.get("keyframes_corrected", 0),
        kept_out=frames.get("keyframes_kept_out", 0),
        carried_away=frames.get("carried_away", 0),
        moved_m=portable.norm(placed[:3, 3] - odometry[:3, 3]),
        turned_deg=float(np.degrees(rotation_angle_rad(turn))),
    )


def _last_registered(path: Path) -> KeyframeRegistered | None:
    try:
        with Journal(path) as journal:
            for index in range(len(journal) - 1, -1, -1):
                for event in journal.events(index, "KeyframeRegistered"):
                    assert isinstance(event, KeyframeRegistered)
                    return event
    except MapFolderError:
        return None
    return None
