"""Faults of single transforms and poses, each with its link, for reports."""

import math
from collections import Counter
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import compose, invert, rotation_angle_rad
from players.messages.records import StampedPose
from players.poses.tracks import GrowingTrack

_UNIT_TOLERANCE = 0.01
"""Difference of a squared quaternion from 1 beyond which tf2 rejects a transform."""

_SAME_M, _SAME_RAD = 1e-4, 1e-4
_LEAST_RIVALS, _RIVAL_SHARE = 10, 0.05


class LinkFaults:
    """Counts the faults of links; the kind and the link are the key."""

    def __init__(self) -> None:
        self._counts: Counter[tuple[str, str, str, str]] = Counter()
        self._again: dict[tuple[str, str, str], tuple[str, float, float]] = {}

    def count(self, kind: str, topic: str, pose: StampedPose) -> None:
        """Count a pose with a fault."""
        self._counts[kind, topic, pose.parent, pose.child] += 1

    def is_usable(self, topic: str, pose: StampedPose) -> bool:
        """Return whether a pose is finite with a quaternion other than 0; count what is wrong with it."""
        if not all(map(math.isfinite, pose.row)):
            self.count("nan", topic, pose)
            return False
        x, y, z, w = pose.row[3:]
        squared = x * x + y * y + z * z + w * w
        if abs(squared - 1.0) > _UNIT_TOLERANCE:
            self.count("zero" if squared <= 1e-6 else "length", topic, pose)
        return squared > 1e-6

    def is_changed(
        self, topic: str, pose: StampedPose, now: NDArray[np.float64], before: tuple[str, NDArray[np.float64]]
    ) -> bool:
        """Return whether a static link differs from the one before it, and note the difference."""
        difference = compose(invert(before[1]), now)
        off_m, off_rad = portable.norm(difference[:3, 3]), rotation_angle_rad(difference[:3, :3])
        if before[0] == pose.parent and off_m < _SAME_M and off_rad < _SAME_RAD:
            return False
        self.count("again", topic, pose)
        self._again[topic, pose.parent, pose.child] = (before[0], off_m, math.degrees(off_rad))
        return True

    def texts(self, tracks: Iterable[tuple[tuple[str, str, str], GrowingTrack]]) -> dict[str, bool]:
        """Return one line per fault and link, and whether it does harm."""
        lines = {}
        tracks = sorted(tracks, key=lambda entry: entry[0])
        for (kind, topic, parent, child), number in sorted(self._counts.items()):
            parent_before, off_m, off_deg = self._again.get((topic, parent, child), (parent, 0.0, 0.0))
            change = f"{1e3 * off_m:.0f} mm and {off_deg:.1f} degrees from the one before"
            change = f"in place of {parent_before}" if parent_before != parent else change
            times = f"{number} times, " if number > 1 else ""
            text = {
                "again": f"was published again ({times}{change}): the latest is used from then on",
                "self": f"is left out ({number} times): a frame cannot be its own parent",
                "length": f"has quaternions of another length than 1 ({number}), which are normalised",
                "zero": f"is left out ({number} times): found a quaternion of length 0, expected 1; mend its publisher",
                "nan": f"is left out ({number} times): found numbers that are not finite; mend its publisher",
            }
            lines[f"{topic}: {child or '(no child frame)'} in {parent} {text[kind]}"] = kind in ("nan", "zero")
        for (topic, parent, child), track in tracks:
            parents = sorted({p for (t, p, c), _ in tracks if (t, c) == (topic, child)}) if child else []
            if len(parents) > 1:
                named = f"{topic}: {child} has the parents {' and '.join(parents)}"
                lines[f"{named}: the one with more poses is used; see that one node publishes it"] = False
            if track.num_rivals >= max(_LEAST_RIVALS, _RIVAL_SHARE * track.num_added):
                lines[
                    f"{topic}: {child or 'the pose'} in {parent} goes back and forth ({track.num_rivals} of "
                    f"{track.num_added} poses): two nodes publish it, or a clock was set back; record one of them"
                ] = True
        return lines
