"""Mends of poses and depth that do not fit each other: in words, and as lines of a profile; a check before `play`."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cache
from itertools import islice
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.errors import InputError
from hickory_stream.ports import SourceAround
from players.doctor.motion_agreement import STEPS, MotionAgreement, MotionSampler
from players.logs.layouts.folder import FolderSource
from players.logs.log_source import LogSource
from players.playback import PlaybackClock, PlayedSource
from players.poses.camera_poses import body_from_camera_of
from players.poses.odometry_source import OdometrySource

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from hickory_stream.ports import Source
    from hickory_stream.records import Frame, RawFrame

logger = logging.getLogger(__name__)

ANYWAY = "`play --anyway` maps it all the same"
# `play` looks at so many frames of the beginning at most, until the camera has moved enough.
_MOST_FRAMES = 1500
# Of most logs, so few steps show that they are sound.
_FIRST_STEPS = 8
_MOST_LIVE_FRAMES = 20_000
# So many frames wait for the comparison of a live run, and after a step it rests: mapping wants the processors.
_MOST_BEHIND, _LIVE_REST_NS = 64, 250_000_000

# Units in which depth is recorded: numbers a metre, and the unit's name.
_UNITS = {
    1.0: "metres", 100.0: "centimetres", 1000.0: "millimetres", 2000.0: "0.5 mm", 4000.0: "0.25 mm", 5000.0: "0.2 mm",
    8000.0: "0.125 mm", 10000.0: "0.1 mm", 1000 / 304.8: "feet", 1000 / 25.4: "inches",
}  # fmt: skip
# Usual distances; where those by the poses' unit are not, the poses are in another unit.
_USUAL_M = (0.15, 30.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class DepthUnit:
    """The unit by which depth is read, and the line of a profile that changes it."""

    units_per_m: float = 1000.0
    key: str = "depth_units_per_m"


def depth_unit_of(source: Source) -> DepthUnit:
    """Return the unit of a source: floating-point images are metres, and a folder may know its own."""
    if isinstance(source, FolderSource):
        return DepthUnit(units_per_m=source.depth_units_per_m, key="depth_scale")
    if not isinstance(source, LogSource):
        return DepthUnit()
    is_float, scale = source.setup.has_float_depth, source.setup.corrections.depth_scale
    return DepthUnit(
        units_per_m=1.0 / scale if is_float else source.setup.depth_units_per_m,
        key="depth_scale" if is_float else "depth_units_per_m",
    )


def link_of(source: Source) -> NDArray[np.float64] | None:
    """Return the static link (4, 4) from the body of the poses to the camera; None if there is none."""
    plan = source.setup.plan if isinstance(source, LogSource) else None
    return body_from_camera_of(plan) if plan is not None and plan.stream is not None and plan.is_static else None


def check_motion(source: Source, note: Mapping[str, Any], *, anyway: bool = False) -> list[str]:
    """Return what is certainly wrong by the beginning of a source that was opened from a note (`open_from_note`).

    The source is not opened again: its log is read in a pass before the one that is mapped. Raises `InputError`: a map
    would be worthless, unless `anyway`.
    """
    while isinstance(source, SourceAround) and not isinstance(source, OdometrySource):
        source = source.played
    start_s, end_s = note.get("start_s") or 0.0, note.get("end_s")
    reasons, is_worthless = motion_warnings(source, start_s, end_s, note.get("first_frames") or _MOST_FRAMES)
    if is_worthless and not anyway:
        raise InputError(
            f"{note['uris'][0]}: {'; '.join(reasons)} (`doctor --fix PROFILE` writes it), or map it --anyway"
        )
    return reasons


def motion_warnings(
    source: Source, start_s: float = 0.0, end_s: float | None = None, most_frames: int = _MOST_FRAMES
) -> tuple[list[str], bool]:
    """Return what is certainly wrong by the beginning of a source, and whether a map would be worthless."""
    if isinstance(source, OdometrySource):
        return [], False
    motions = MotionSampler()
    with closing(PlayedSource(source, PlaybackClock(), start_s=start_s, end_s=end_s).frames()) as frames:
        is_sound = _is_surely_sound(motions, islice(frames, min(most_frames, _MOST_FRAMES)), source)
    return ([], False) if is_sound else warnings_of(motions, source)


def _is_surely_sound(motions: MotionSampler, frames: Iterable[RawFrame], source: Source) -> bool:
    # Takes frames until the camera has moved enough.
    for raw in frames:
        num_steps = len(motions.steps)
        motions.add(raw)
        num_moving = motions.num_moving if len(motions.steps) > num_steps else 0
        if num_moving == _FIRST_STEPS and (motion := motions.agreement(link_of(source))) and motion.is_surely_sound:
            return True
        if num_moving >= STEPS:
            break
    return False


def watched(source: Source, frames: Iterator[RawFrame], reasons: list[str]) -> Iterator[RawFrame]:
    """Yield the frames of a running source; `reasons` gets what is certainly wrong, once, while the frames go on.

    A thread compares some of the frames. None waits for it: those that come while it is behind are left out.
    """
    compared: SimpleQueue[RawFrame | None] = SimpleQueue()
    thread = threading.Thread(target=_watch, args=(compared, source, reasons), name="motion-watch", daemon=True)
    thread.start()
    try:
        for number, frame in enumerate(frames):
            raw = frame
            if number >= _MOST_LIVE_FRAMES:
                compared.put(None)
            elif thread.is_alive() and compared.qsize() < _MOST_BEHIND:
                raw = replace(frame, decode=_once(frame.decode))
                compared.put(raw)
            yield raw
    finally:
        compared.put(None)
        thread.join()


def _watch(compared: SimpleQueue[RawFrame | None], source: Source, reasons: list[str]) -> None:
    motions = MotionSampler(rest_ns=_LIVE_REST_NS)
    if _is_surely_sound(motions, iter(compared.get, None), source):
        return
    for reason in warnings_of(motions, source)[0]:
        reasons.append(reason)
        logger.warning("%s", reason)


def _once(decode: Callable[[], Frame]) -> Callable[[], Frame]:
    # Two threads want the frame; the second waits for what the first decodes.
    decoded, lock = cache(decode), threading.Lock()

    def locked() -> Frame:
        with lock:
            return decoded()

    return locked


def warnings_of(motions: MotionSampler, source: Source) -> tuple[list[str], bool]:
    """Return what is certainly wrong by some frames of a source, and whether a map would be worthless."""
    motion = motions.agreement(link_of(source))
    if motion is None:
        return [], False
    reasons, _ = mend_of(motion, depth_unit_of(source))
    return reasons, motion.is_worthless and bool(reasons)


def mend_of(motion: MotionAgreement, depth: DepthUnit) -> tuple[list[str], dict[str, Any]]:
    """Return what is wrong by the motion with what mends it, in words, and as lines of a profile."""
    agree = f"{motion.mended_share:.0%} of {motion.num_moving} motions"
    if motion.poses == "foreign":
        return [
            f"poses do not move as the images do: they agree on {agree}; they may be another robot's, or another "
            "clock's: name others with --pose-topic, or estimate them with --odometry depth"
        ], {}
    reasons, fixes = [], dict[str, Any]()
    if motion.poses != "sound":
        reasons.append(
            f"poses are {motion.poses}: so read, {agree} agree with the images, as recorded {motion.share:.0%}; "
            "record world_from_body, or estimate poses with --odometry depth"
        )
    if motion.is_mirrored:
        reasons.append(f"images or poses are mirrored: {agree} agree so; record without mirroring")
    elif motion.axes != "x y z":
        right, down, forward = motion.axes.split()
        body = " (a body's axes, not an optical frame's)" if motion.axes == "-y -z x" else ""
        reasons.append(
            f"the camera's axes do not fit the motion: the image's right, down and forward are {right}, {down} and "
            f'{forward} of its frame{body}, by {agree}; put camera_axes = "{motion.axes}" into a profile'
        )
        fixes["camera_axes"] = motion.axes
    if motion.has_other_scale:
        reason, line = _scale_mend(motion, depth)
        reasons.append(reason)
        fixes |= line
    if motion.has_lag and motion.lag_s is not None and motion.lag_error_s is not None:
        late, offset_ms = "late" if motion.lag_s > 0 else "early", round(-1e3 * motion.lag_s)
        reasons.append(
            f"poses are stamped {abs(motion.lag_s):.3f} +- {motion.lag_error_s:.3f} s too {late} for the images; put "
            f"pose_offset_ms = {offset_ms} under [time] of a profile"
        )
        fixes["time"] = {"pose_offset_ms": offset_ms}
    return reasons, fixes


def _scale_mend(motion: MotionAgreement, depth: DepthUnit) -> tuple[str, dict[str, Any]]:
    assert motion.scale is not None and motion.scale_error is not None
    scale, error = motion.scale, motion.scale_error
    factor = scale if scale > 1 else 1 / scale
    times = (
        f"{factor:.3g} +- {factor * error:.2g} times too {'far' if scale > 1 else 'near'} for the motion of the poses"
    )
    low_m, high_m = _USUAL_M
    if low_m < motion.depth_m < high_m and not low_m < motion.depth_m / scale < high_m:
        return f"poses are in another unit: depth is {times}, but usual by itself; record them in metres", {}
    right = depth.units_per_m * scale
    named = [unit for unit in _UNITS if abs(np.log(unit / right)) < max(error, 0.1)]
    if named:
        right = min(named, key=lambda unit: abs(np.log(unit / right)))
    unit = f": it is in {_UNITS[right]}" if named else ""
    value = float(f"{right if depth.key == 'depth_units_per_m' else depth.units_per_m / right:.6g}")
    return f"depth is {times}{unit}; put {depth.key} = {value:g} into a profile", {depth.key: value}
