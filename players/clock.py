"""The choice of a log's time base: header stamps, unless they are unusable, else the recorder's.

Headers say when an image was taken; the log time, when a recorder got it. A header time that was never set (all zero,
or one value) or that puts colour and depth far apart is of no use, and then all streams take the log time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from collections.abc import Sequence

    from players.options import Clock
    from players.probe import Probe
    from players.rig import PosePlan, RigReader

_APART_NS = 60_000_000_000
"""Streams that begin so far from each other by header and not by log time have clocks of their own."""


def choose_clock(
    asked: Clock, color: Probe, depth: Probe, reader: RigReader, plan: PosePlan
) -> tuple[Literal["header", "log"], str]:
    """Return which clock counts, and why in words."""
    if asked == "log":
        return "log", "log time, as asked"
    if asked == "header":
        return "header", "header stamps, as asked"
    for probe in (color, depth):
        if _is_unset(probe.stamps_ns):
            return "log", f"log time: the header stamps of {probe.topic.name} are not set (all {probe.stamps_ns[0]})"
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


def _is_unset(stamps_ns: Sequence[int]) -> bool:
    return len(stamps_ns) > 0 and (max(stamps_ns) == 0 or (len(stamps_ns) > 2 and len(set(stamps_ns)) == 1))
