"""Choice of a log's time base: header stamps, unless they are unusable, else log times.

Header stamps (exposure) are unusable if all are zero or equal, or if colour and depth are far apart by them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from players.messages.images import Probe
    from players.options import Clock
    from players.poses.camera_poses import PosePlan, PoseReader

_APART_NS = 60_000_000_000
"""Streams whose first header stamps differ by more than this, but whose log times do not, have different clocks."""


def choose_clock(
    asked: Clock, color: Probe, depth: Probe, reader: PoseReader, plan: PosePlan
) -> tuple[Literal["header", "log"], str]:
    """Return which clock is used, and the reason in words."""
    if asked == "log":
        return "log", "log time, as asked"
    if asked == "header":
        return "header", "header stamps, as asked"
    for probe in (color, depth):
        stamps_ns = probe.stamps_ns
        if stamps_ns and (max(stamps_ns) == 0 or (len(stamps_ns) > 2 and len(set(stamps_ns)) == 1)):
            return "log", f"log time: the header stamps of {probe.topic.name} are not set (all {stamps_ns[0]})"
    if color.stamps_ns and depth.stamps_ns:
        header_ns = abs(color.stamps_ns[0] - depth.stamps_ns[0])
        log_ns = abs(color.log_ns[0] - depth.log_ns[0])
        if header_ns > _APART_NS > log_ns:
            apart = f"{header_ns / 1e9:.0f} s"
            return "log", f"log time: the header stamps of {color.topic.name} and {depth.topic.name} are {apart} apart"
    for key in plan.keys:
        track = reader.track(key, 0)
        if track is not None and track.num_added == 1 and track.num_duplicates > 20:
            return "log", f"log time: the header stamps of {key[0]} are not set"
    return "header", "header stamps"
