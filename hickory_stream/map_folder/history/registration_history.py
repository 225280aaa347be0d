"""State of keyframe registration after a step, from the journal, and its summary."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hickory_stream.errors import MapFolderError
from hickory_stream.events import FrameObserved, KeyframeRegistered
from hickory_stream.geometry import portable
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import rotation_angle_rad
from hickory_stream.journal.reader import Journal
from hickory_stream.records import CoarseFrame

# More than half of the keyframes are most.
_MOST = 0.5


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RegisteredKeyframe:
    """A keyframe to which later ones may be registered; `number` counts registered ones from 0."""

    event: KeyframeRegistered
    coarse: CoarseFrame
    camera: Camera
    number: int


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RegistrationHistory:
    """The last registered keyframe, the number of registered ones, and those remembered, in order."""

    last: KeyframeRegistered
    num_placed: int
    remembered: tuple[RegisteredKeyframe, ...]


def registration_history(journal: Journal, num_steps: int, *, num_recent: int) -> RegistrationHistory | None:
    """Return the state after `num_steps` steps, None without a registered keyframe.

    `num_recent` keyframes are remembered beside the anchors. Raises `MapFolderError`: the journal is damaged.
    """
    events = ((i, event) for i in steps_behind(journal, num_steps) for event in journal.events(i, "KeyframeRegistered"))
    found = [(i, event) for i, event in events if isinstance(event, KeyframeRegistered)]
    if not found:
        return None
    begun = max(i for i, (_, event) in enumerate(found) if event.how in ("first", "begun anew") or i == 0)
    remembered = []
    for number, (index, event) in enumerate(found):
        if number < begun or not (event.is_anchor or number >= len(found) - num_recent):
            continue
        for observed in journal.events(index, "FrameObserved", has_points=False):
            assert isinstance(observed, FrameObserved)
            if observed.frame_index == event.frame_index and observed.coarse is not None:
                camera = journal.step(index).camera
                remembered.append(RegisteredKeyframe(event=event, coarse=observed.coarse, camera=camera, number=number))
    return RegistrationHistory(last=found[-1][1], num_placed=len(found), remembered=tuple(remembered))


def steps_behind(journal: Journal, num_steps: int) -> list[int]:
    """Return the steps that led to the state after `num_steps`, without those that a seek went back from."""
    way = []
    index = num_steps - 1
    while index >= 0:
        way.append(index)
        goes_back_to = journal.step(index).goes_back_to
        index = index - 1 if goes_back_to is None else goes_back_to - 1
    return way[::-1]


@dataclass(frozen=True, kw_only=True, slots=True)
class RegistrationSummary:
    """Numbers of a run's keyframes by outcome of registration."""

    keyframes: int
    #: Mapped at another pose than the odometry's.
    corrected: int
    kept_out: int
    #: Sudden moves that the odometry missed.
    carried_away: int
    #: Correction of the last keyframe, like `turned_deg`.
    moved_m: float
    turned_deg: float

    def text(self) -> str:
        """Return one line, "" if every keyframe is at the odometry's pose."""
        if not self.corrected and not self.kept_out:
            return ""
        text = (
            f"odometry: of {self.keyframes + self.kept_out} keyframes {self.corrected} were moved to fit the map, "
            f"{self.keyframes - self.corrected} stayed at their odometry's pose, {self.kept_out} did not fit and were "
            f"left out; in the end the correction is {self.moved_m:.3f} m and {self.turned_deg:.2f} degrees"
        )
        if self.carried_away:
            times = "once" if self.carried_away == 1 else f"{self.carried_away} times"
            text += f"; {times} the robot was suddenly elsewhere than its odometry says, and a submap begins there"
        return text

    def warning(self) -> str:
        """Return a line where most keyframes did not fit, else ""."""
        share = self.kept_out / max(1, self.keyframes + self.kept_out)
        if share <= _MOST:
            return ""
        return (
            f"most keyframes ({share:.0%}) did not fit the map and were left out, expected few; "
            "`hickory-stream doctor LOG` compares depth, poses and calibration"
        )


def registration_summary(path: Path, ledger: Mapping[str, Any]) -> RegistrationSummary | None:
    """Return the summary of a run with this `ledger`; None without registration in its journal."""
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
