"""Accounts of a run: metrics, ledgers of messages, frames and jobs, and timings.

A source counts the images of all frames as used; the run moves those of unused frames to their own buckets.
"""

from collections.abc import Mapping
from typing import Any

import psutil

from hickory_stream.ports import Source, account_of

_PROCESS = psutil.Process()
_IMAGES_PER_FRAME = 2


def message_ledger(source: Source, frames: Mapping[str, int]) -> dict[str, Any]:
    """Return the account of a source's messages, {} if it keeps none.

    `frames` are the run's counts: `read`, `keyframes`, `keyframes_kept_out`, `keyframes_failed`, `frames_undecodable`.
    After several rounds of a log, the account is of the last round, and images are not divided by use.
    """
    kept = account_of(source)
    if kept is None:
        return {}
    account = kept.as_dict()
    found = source.ledger().get("frames", 0)
    if frames.get("read", 0) != found:
        return account
    torn = frames.get("frames_undecodable", 0)
    # Rejected keyframes were decoded too.
    needed = sum(frames.get(name, 0) for name in ("keyframes", "keyframes_kept_out", "keyframes_failed"))
    skipped = _IMAGES_PER_FRAME * max(0, found - needed - torn)
    account["not_keyframe"] = skipped
    account["not_needed"] += skipped
    account["unreadable"] += _IMAGES_PER_FRAME * torn
    account["used"] -= skipped + _IMAGES_PER_FRAME * torn
    return account


def run_ledger(
    source: Source,
    *,
    num_frames: int,
    num_keyframes: int,
    counts: Mapping[str, int],
    shapes: dict[str, int],
    num_not_shown: int,
) -> dict[str, dict[str, Any]]:
    """Return the use of every message, frame and job; `counts` are frames by outcome."""
    outcomes = {name: count for name, count in counts.items() if count}
    read = outcomes.pop("read", num_frames + outcomes.get("frames_late", 0))
    frames = {"read": read, "keyframes": num_keyframes, **outcomes}
    if num_not_shown:
        frames["reports_not_shown"] = num_not_shown
    kept = {"source": dict(source.ledger()), "frames": frames, "shapes": shapes}
    messages = message_ledger(source, frames)
    return {**kept, "messages": messages} if messages else kept


def run_timings(
    times_s: Mapping[str, float], shape_times_s: Mapping[str, float], loop_delay_s: float
) -> dict[str, float]:
    """Return seconds of work: by layer as in the paper's table of storage and time, and by stage."""
    layers = {
        "layer1_s": times_s.get("perceive", 0.0) + times_s.get("decide", 0.0),
        "layer2_s": shape_times_s["reconstruct"],
        "layer3_s": shape_times_s["fit"],
        "layer4_s": shape_times_s["inflate"],
    }
    stages = {f"{stage}_s": seconds for stage, seconds in sorted(times_s.items())}
    return {**layers, **stages, "loop_delay_p99_ms": 1e3 * loop_delay_s}


def engine_metrics(
    times_s: Mapping[str, float],
    *,
    queues: Mapping[str, int],
    loop_delay_s: float,
    num_workers: int,
    source_ledger: Mapping[str, int],
    num_dropped: int,
) -> tuple[tuple[str, float], ...]:
    """Return the engine's metrics of a keyframe: stages, queues, memory, ledger."""
    return (
        *((f"time/{name}", seconds) for name, seconds in times_s.items()),
        *((f"queue/{name}", float(length)) for name, length in queues.items()),
        ("engine/loop_delay_ms", 1e3 * loop_delay_s),
        ("engine/workers", float(num_workers)),
        ("engine/memory_mb", _PROCESS.memory_info().rss / 1e6),
        *((f"ledger/{bucket}", float(number)) for bucket, number in source_ledger.items()),
        ("engine/frames_dropped", float(num_dropped)),
    )
