"""Choice of a log's time base: header stamps, unless they are unusable, else log times.

Header stamps (exposure) are unusable if all are zero or equal, or if colour, depth and poses are far apart by them.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from players.messages.images import Probe
    from players.options import Clock
    from players.poses.camera_poses import PosePlan, PoseReader

_APART_NS = 60_000_000_000
"""Streams whose first header stamps all differ by more than this, but whose log times do not, have different clocks."""


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
    # Constant links are valid at any time; a robot that stands still has no others.
    tracks = {key: track for key in plan.keys if (track := reader.track(key, 0)) is not None}
    keys = [key for key, track in tracks.items() if not track.is_constant] or [*tracks][: 1 if plan.stream else None]
    probes = {probe.topic.name: [*zip(probe.stamps_ns, probe.log_ns, strict=True)] for probe in (color, depth)}
    images = probes[color.topic.name]
    for name, times in (*probes.items(), *((key[0], reader.first_ns.get(key, ())) for key in keys)):
        if times and images:
            header_ns, log_ns = (min(abs(a[i] - b[i]) for a, b in product(times, images)) for i in (0, 1))
            if header_ns > _APART_NS > log_ns:
                apart = f"{abs(times[0][0] - images[0][0]) / 1e9:.0f} s apart"
                return "log", f"log time: the header stamps of {color.topic.name} and {name} are {apart}"
    for key in keys:
        if tracks[key].num_added == 1 and tracks[key].num_duplicates > 20:
            return "log", f"log time: the header stamps of {key[0]} are not set"
    return "header", "header stamps"
