"""Diagnosis of a log before it is mapped: contents, flaws, and the number of usable frames.

One pass plays like `play`, counts every message, and decodes a few frames. Of a long log, it reads a few parts.
"""

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.config import MapperConfig
from hickory_stream.errors import InputError, NoPosesError, RecordingError, UnknownLogError
from hickory_stream.geometry.depth_sensor import DepthSensor
from hickory_stream.mapping.rules.keyframes import Keyframe, KeyframeConfig, keyframe_reason, motion
from hickory_stream.ports import Source
from hickory_stream.poses.hand_eye import NoHandEye
from players.doctor.depth_bias import DepthBias, ViewSampler, depth_bias
from players.doctor.depth_color_alignment import (
    BorderScores,
    ColorAlignment,
    ColorLag,
    border_scores,
    color_alignment,
    color_lag,
)
from players.doctor.depth_noise import DepthNoise, FlatPatches, depth_noise, flat_patches
from players.doctor.gravity import SeenFloor, floor_in, gravity_notes
from players.doctor.light_and_rain import DARK, GREY, RAIN, Conditions, conditions_of, median_conditions
from players.doctor.motion_agreement import STEPS, MotionAgreement, MotionSampler
from players.doctor.motion_mends import ANYWAY, DepthUnit, depth_unit_of, link_of, mend_of
from players.doctor.stream_stats import CountedLog, StreamStats, clock_steps, nearest_ms
from players.logs.containers import Log
from players.logs.layouts.folder import FolderSource
from players.logs.layouts.table import opener_of
from players.logs.log_damage import Flaws
from players.logs.log_opening import open_log, read_opening
from players.logs.log_parts import Parts, divide, parts_of
from players.logs.log_source import LogSource
from players.opening import open_container, open_source
from players.options import SourceOptions
from players.poses.camera_poses import body_from_camera_of
from players.poses.extrinsics import are_assumed, estimated_extrinsics, extrinsics_text
from players.poses.odometry_source import OdometrySource, with_odometry
from players.poses.pose_gaps import PoseGaps

SOUND, UNUSABLE, WITH_LOSSES = 0, 2, 3

_ENDS_S, _OWN_CLOCK_S = 2.0, 1e9
_SAMPLES = 12
# A frame with a larger share of missing depth is not examined for a floor.
_NO_DEPTH = 0.9
# So many frames are registered by odometry, which takes most of the time where a log lacks poses or links.
_REGISTERED = 120
_UNPAIRED, _LOST_AT_ENDS = ("color_without_depth", "depth_without_color"), 4
_OTHER_M, _OTHER_RAD = 0.4, 0.26
_KEYFRAME_S, _MEGAPIXEL_S, _SHAPE_S = 0.12, 0.9, 0.05
_BASE_MB, _MEGAPIXEL_MB, _KEYFRAME_MB = 550.0, 260.0, 0.35
"""Time and memory of `play` on two shared cores without a GPU, for a rough estimate."""


# For a walking camera, a log of 5 Hz has about 0.62 of the keyframes that an unlimited rate would give, 2 Hz half.
_DUE_SHARE, _LEAST_DUE = 0.55, 8.0


@dataclass(slots=True)
class Diagnosis:
    """The findings. `problems` cost messages or frames, `notes` do not; `refusal` is why the log cannot be mapped."""

    uri: str
    kind: str = ""
    num_bytes: int = 0
    checksum: str = ""
    streams: dict[str, str] = field(default_factory=dict)
    topics: dict[str, dict[str, Any]] = field(default_factory=dict)
    tf: dict[str, Any] = field(default_factory=dict)
    images: dict[str, Any] = field(default_factory=dict)
    sync: dict[str, Any] = field(default_factory=dict)
    frames: dict[str, Any] = field(default_factory=dict)
    ledger: dict[str, Any] = field(default_factory=dict)
    damage: list[dict[str, Any]] = field(default_factory=list)
    damaged_bytes: int = 0
    estimate: dict[str, float] = field(default_factory=dict)
    live: dict[str, Any] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    #: Lines of a profile that mend what was found.
    fixes: dict[str, Any] = field(default_factory=dict)
    refusal: str | None = None

    @property
    def status(self) -> int:
        """The exit status: 0 sound, 3 usable with losses, 2 unusable."""
        return UNUSABLE if self.refusal is not None else WITH_LOSSES if self.problems else SOUND

    def as_dict(self) -> dict[str, Any]:
        """Return everything, for machines."""
        verdict = {SOUND: "sound", UNUSABLE: "unusable", WITH_LOSSES: "usable with losses"}[self.status]
        return {"verdict": verdict, "status": self.status, **asdict(self)}


def examine(
    uris: Sequence[str | Path], options: SourceOptions, progress: Callable[[str], None] = lambda stage: None
) -> Diagnosis:
    """Return the diagnosis of a log or an image folder; faults of the log are part of the result, not exceptions."""
    paths = [Path(uri) for uri in uris]
    found = Diagnosis(uri=" ".join(str(path) for path in paths))
    try:
        if len(paths) == 1 and opener_of(paths[0]) is not None:
            source = open_source(list(paths), options)
            progress("reading as play does")
            found.kind, found.streams = source.info.kind, dict(source.info.streams)
            if isinstance(source, FolderSource):
                found.num_bytes = source.num_bytes()
                found.notes += source.content.flaws
            examine_frames(found, source, {})
            return found
        log = open_container(*paths)
    except UnknownLogError as error:
        found.refusal, found.notes = error.found, list(error.nearest)
        return found
    except InputError as error:
        found.refusal = str(error)
        return found
    return examine_log(found, log, options, progress)


def examine_log(
    found: Diagnosis, log: Log, options: SourceOptions, progress: Callable[[str], None], *, is_heard: bool = False
) -> Diagnosis:
    """Complete a diagnosis with the contents of a log; `is_heard`: it was just recorded from a live route."""
    found.kind, found.checksum = log.kind, log.checksum
    found.num_bytes = sum(file.stat().st_size for file in log.files)
    found.problems += getattr(log, "unreadable", ())
    found.notes += getattr(log, "notes", ())
    divide(log)
    parts, counted, flaws = parts_of(log), CountedLog(log), log.flaws
    try:
        source = _as_play_opens(found, counted, options, is_heard=is_heard)
        progress("reading as play does")
        examine_frames(found, source, counted.stats, parts)
        played = source.played if isinstance(source, OdometrySource) else source
        flaws = played.flaws if isinstance(played, LogSource) else flaws
        if isinstance(source, LogSource) and not is_heard and options.extrinsics == "log":
            progress("looking where the camera sits")
            judge_extrinsics(found, source)
    except InputError as error:
        found.refusal = str(error)
        found.fixes |= error.fixes if isinstance(error, RecordingError) else {}
    if not counted.stats:
        progress("reading every message")
        deque(counted.messages(()), maxlen=0)
    found.topics = {name: counted.stats[name].as_dict(parts) for name in sorted(counted.stats)}
    _note_stamps(found, is_heard=is_heard)
    if parts is not None:
        found.notes += clock_steps(counted.stats, parts)
        found.notes.append(
            f"a long log: {parts.number} parts of it were read, {parts.share:.0%} of its time; damage elsewhere is not "
            "seen (`play` reads all), and numbers of frames are scaled up"
        )
    _note_damage(found, flaws)
    if not found.checksum and not is_heard:
        found.notes.append(f"{found.kind} has no checksums: altered bytes within a message cannot be seen")
    return found


def _as_play_opens(found: Diagnosis, log: Log, options: SourceOptions, *, is_heard: bool) -> Source:
    try:
        _examine_opening(found, log, options)
        source = open_log(log, options)
    except NoPosesError as error:
        if options.odometry != "auto" or is_heard:
            raise
        found.notes.append(f"{error}, as play will do (--odometry)")
        estimating = replace(options, odometry="depth")
        _examine_opening(found, log, estimating)
        return with_odometry(open_log(log, estimating), "auto")
    return with_odometry(source, options.odometry) if options.estimates_poses else source


def _examine_opening(found: Diagnosis, log: Log, options: SourceOptions) -> None:
    opening = read_opening(log, options)
    for role, probe in (("color", opening.color), ("depth", opening.depth)):
        first = probe.first
        found.images[role] = {
            "topic": probe.topic.name,
            "encoding": first.encoding if first else None,
            "size": list(first.size) if first and first.size else None,
            "frame": first.frame if first else None,
        }
    tree = opening.reader.tree()
    found.tf = {
        "edges": [
            {"parent": e.parent, "child": e.child, "static": isinstance(e.parent_from_child, np.ndarray)}
            for _, e in sorted(tree.edges.items())
        ],
        "pose_streams": [
            {"topic": s.topic, "parent": s.parent, "child": s.child, "poses": s.num_poses}
            for s in opening.reader.streams()
        ],
    }
    if opening.profile.name:
        found.streams["profile"] = opening.profile.name + (" (guessed)" if opening.is_profile_guessed else "")
        found.streams["profile_title"] = opening.profile.title


def examine_frames(
    found: Diagnosis, source: Source, stats: Mapping[str, StreamStats], parts: Parts | None = None
) -> None:
    """Play the source without mapping it; decode a few frames. `stats` is complete at the end of the source."""
    found.streams |= dict(source.info.streams)
    config = MapperConfig()
    share = parts.share if parts is not None else 1.0
    expected = max(1, round(share * (source.info.num_frames or 100)))
    step = max(1, expected // _SAMPLES)
    last: Keyframe | None = None
    num_frames, num_keyframes, num_at_rest, num_torn, jumps = 0, 0, 0, 0, 0
    due, first_ns, last_ns = 0.0, 0, 0
    invalid: list[float] = []
    borders: list[BorderScores] = []
    seen_from: list[NDArray[np.float64]] = []
    patches, views, wanted = list[FlatPatches](), list[FlatPatches](), ViewSampler(expected)
    lights: list[Conditions] = []
    floors: list[SeenFloor] = []
    sensor = DepthSensor()
    # An odometry's poses come from the images themselves.
    is_estimated = isinstance(source, OdometrySource)
    motions = None if is_estimated else MotionSampler(compares_colors=True, every=max(1, expected // STEPS))
    started_s = time.perf_counter()
    for raw in islice(source.frames(), None if motions is not None else _REGISTERED):
        num_frames += 1
        if motions is not None:
            motions.add(raw)
        jumps += raw.after_from_before is not None
        first_ns, last_ns = first_ns or raw.stamp_ns, raw.stamp_ns
        if reason := keyframe_reason(last, raw.stamp_ns, raw.world_from_camera, config.keyframes):
            num_keyframes += 1
            num_at_rest += reason == "at_rest"
            keyframe = Keyframe(stamp_ns=raw.stamp_ns, world_from_camera=raw.world_from_camera)
            is_next_part = last is not None and parts is not None and raw.stamp_ns - last.stamp_ns > parts.pause_ns // 2
            if last is not None and raw.after_from_before is None and not is_next_part:
                due += _keyframes_due(last, keyframe, config.keyframes)
            last = keyframe
        is_sample, is_view = raw.index % step == 0 and len(invalid) < 2 * _SAMPLES, wanted.wants(raw)
        if is_view:
            with suppress(RecordingError):
                views.append(flat_patches(raw.decode()))
        if is_sample:
            try:
                frame = raw.decode()
                invalid.append(float(1.0 - np.isfinite(frame.depth_m).mean()))
                sensor = config.sensor.over(frame.sensor)
                patches.append(flat_patches(frame))
                lights.append(conditions_of(frame))
                if invalid[-1] < _NO_DEPTH:
                    floors.append(floor_in(frame))
                # The same edges are one witness, however often they are seen.
                is_other = all(
                    moved_m > _OTHER_M or turned_rad > _OTHER_RAD
                    for moved_m, turned_rad in (motion(pose, frame.world_from_camera) for pose in seen_from)
                )
                if is_other and (scores := border_scores(frame)) is not None:
                    borders.append(scores)
                    seen_from.append(frame.world_from_camera)
            except RecordingError as error:
                num_torn += 1
                found.notes.append(str(error))
    source.close()
    if num_frames == _REGISTERED and motions is None:
        share = min(share, num_frames / max(num_frames, source.info.num_frames or 0))
    num_frames, num_keyframes, due = round(num_frames / share), round(num_keyframes / share), due / share
    ledger, played = dict(source.ledger()), source.played if isinstance(source, OdometrySource) else source
    camera = source.info.camera
    agreement = color_alignment(borders)
    agreed = motions.agreement(link_of(source)) if motions is not None else None
    lag = color_lag(motions.lag_scores) if motions is not None else None
    noise, bias, light = depth_noise(patches), depth_bias(views), median_conditions(lights)
    found.frames = {
        "frames": num_frames,
        "keyframes": num_keyframes,
        "keyframes_at_rest": round(num_at_rest / share),
        "keyframes_due": round(due, 1),
        "color_on_depth": {"is_off": agreement.is_off, **asdict(agreement)} if agreement is not None else None,
        "depth_noise": {"ratio": round(noise.ratio_to(sensor), 3), **asdict(noise)} if noise is not None else None,
        "depth_bias": {"is_off": bias.is_off, **asdict(bias)} if bias is not None else None,
        "motion": asdict(agreed) if agreed is not None else None,
        "color_lag": {"is_off": lag.is_off, **asdict(lag)} if lag is not None else None,
        "sensor": asdict(sensor),
        "light": asdict(light) if light is not None else None,
        "size": [camera.width, camera.height],
        "intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy],
        "pose_jumps": jumps,
        "sampled": len(invalid) + num_torn,
        "torn": num_torn,
        "depth_invalid_median": round(float(np.median(invalid)), 3) if invalid else None,
        "depth_invalid": [round(share, 3) for share in invalid],
        "read_s": round(time.perf_counter() - started_s, 2),
    }
    _estimate(found, camera.width * camera.height / 1e6, num_keyframes)
    _refuse_empty(found, num_torn, invalid)
    found.ledger = played.account().as_dict() if isinstance(played, LogSource | FolderSource) else {}
    gaps = played.gaps if isinstance(played, LogSource | FolderSource) else PoseGaps()
    _note_frames(found, _of_parts(ledger, parts), played.reasons() if isinstance(played, LogSource) else {}, gaps)
    judge_keyframes(found, num_keyframes, due, (last_ns - first_ns) / 1e9, config.mapping.lifecycle.confirm_s)
    judge_motion(found, agreed, depth_unit_of(played))
    judge_color(found, agreement, lag)
    if agreed is None or not agreed.is_worthless:
        judge_depth(found, noise, bias, sensor)
        found.notes += gravity_notes(floors)
    judge_conditions(found, light)
    if isinstance(played, LogSource | FolderSource):
        findings = played.findings()
        found.problems += [text for text, is_harmful in findings.items() if is_harmful]
        found.notes[:0] = [text for text, is_harmful in findings.items() if not is_harmful]
    if isinstance(played, LogSource):
        setup = played.setup
        topics = (setup.topics.color, setup.topics.depth)
        color, depth = (stats[topic.name].stamps(uses_log_time=setup.uses_log_time) for topic in topics)
        judge_ends(found, color, depth)
        apart_ms = nearest_ms(color, depth)
        counts, edges = np.histogram(np.clip(apart_ms, -250, 250), bins=50)
        within = np.abs(apart_ms) <= setup.tolerance_ns / 1e6
        found.sync = {
            "tolerance_ms": setup.tolerance_ns / 1e6,
            "within": round(float(within.mean()), 4) if len(within) else 0.0,
            "median_ms": round(float(np.median(np.abs(apart_ms))), 3) if len(apart_ms) else None,
            "p95_ms": round(float(np.percentile(np.abs(apart_ms), 95)), 3) if len(apart_ms) else None,
            "histogram": {"edges_ms": [round(float(edge), 3) for edge in edges], "counts": counts.tolist()},
        }


def _of_parts(ledger: dict[str, int], parts: Parts | None) -> dict[str, int]:
    # At the ends of parts, images have lost their partners.
    return {
        name: number
        for name, number in ledger.items()
        if parts is None or number > _LOST_AT_ENDS * parts.number or name not in _UNPAIRED
    }


def _refuse_empty(found: Diagnosis, num_torn: int, invalid: Sequence[float]) -> None:
    if num_torn and not invalid:
        found.refusal = f"none of {num_torn} sampled frames can be decoded: {found.notes[-1]}"
    elif invalid and min(invalid) == 1.0:
        found.refusal = f"none of {len(invalid)} sampled depth images has a return: all is NaN, 0, or out of range"


def _keyframes_due(last: Keyframe, now: Keyframe, config: KeyframeConfig) -> float:
    if now.stamp_ns <= last.stamp_ns:
        return 0.0
    elapsed = (now.stamp_ns - last.stamp_ns) / 1e9 / config.min_interval_s
    distance_m, turned_rad = motion(last.world_from_camera, now.world_from_camera)
    moved = max(distance_m / config.min_distance_m, float(np.rad2deg(turned_rad)) / config.min_angle_deg)
    return max(1.0, min(elapsed, moved))


def judge_keyframes(found: Diagnosis, number: int, due: float, seconds: float, confirm_s: float) -> None:
    """Report too few keyframes for the motion of the camera, or for any object to be confirmed."""
    if number < 2 or seconds < confirm_s:
        found.problems.append(
            f"{number} keyframes in {seconds:.1f} s: what is seen for {confirm_s:g} s is mapped; record for longer"
        )
    elif due >= _LEAST_DUE and number - 1 < _DUE_SHARE * due:
        found.problems.append(
            f"{number} keyframes in {seconds:.1f} s, {due:.0f} would be due at this motion: frames come too seldom. "
            f"A thing is mapped that is seen for {confirm_s:g} s; record at 5 Hz or more, or move slower"
        )


def judge_ends(found: Diagnosis, color_ns: NDArray[np.int64], depth_ns: NDArray[np.int64]) -> None:
    """Report a camera that stops long before the other: nothing is mapped from then on."""
    if len(color_ns) == 0 or len(depth_ns) == 0:
        return
    early_s = (int(color_ns.max()) - int(depth_ns.max())) / 1e9
    if abs(early_s) > _ENDS_S:
        name, other = ("depth", "colour") if early_s > 0 else ("colour", "depth")
        found.problems.append(
            f"{name} stops {abs(early_s):.1f} s before {other} does: what comes then cannot be mapped; see why the "
            "camera stopped"
        )


def judge_motion(found: Diagnosis, motion: MotionAgreement | None, depth: DepthUnit = DepthUnit()) -> None:  # noqa: B008
    """Report poses that do not move as the images do; without use, `play` refuses them."""
    if motion is None:
        return
    reasons, fixes = mend_of(motion, depth)
    found.fixes |= fixes
    if motion.is_worthless and reasons:
        found.refusal = "; ".join(reasons) + f". {ANYWAY}"
    else:
        found.problems += reasons


def judge_color(found: Diagnosis, agreement: ColorAlignment | None, lag: ColorLag | None = None) -> None:
    """Report a wrong registration of colour and depth, by their times or by the calibration."""
    if lag is not None and lag.is_off:
        late, offset_ms = "late" if lag.lag_s > 0 else "early", round(-1e3 * lag.lag_s)
        found.problems.append(
            f"depth is stamped {abs(lag.lag_s):.2f} +- {lag.error_s:.2f} s too {late} for colour: without it, they lie "
            f"on each other while the camera moves; put depth_offset_ms = {offset_ms} under [time] of a profile"
        )
        found.fixes["time"] = {**found.fixes.get("time", {}), "depth_offset_ms": offset_ms}
        return
    if agreement is None or not agreement.is_off:
        return
    x_mm, y_mm = (1e3 * value for value in agreement.offset_m)
    found.problems.append(
        f"colour does not lie on depth: it fits best {x_mm:+.0f} mm to the right and {y_mm:+.0f} mm down of where the "
        f"calibration has it ({agreement.offset_px:.1f} pixels), to {1e3 * agreement.error_m:.0f} mm; correct the link "
        "between the two cameras"
    )


def judge_depth(found: Diagnosis, noise: DepthNoise | None, bias: DepthBias | None, sensor: DepthSensor) -> None:
    """Report a constant bias of depth, or a noise that differs much from that of the sensor model."""
    if bias is not None and bias.is_off:
        long = "long" if bias.bias_m > 0 else "short"
        found.problems.append(
            f"depth is {1e3 * abs(bias.bias_m):.0f} +- {3e3 * bias.error_m:.0f} mm too {long} at every distance: "
            f"{bias.num_frames} views agree best without it; map with --set "
            f"mapper.sensor.bias_m={sensor.bias_m + bias.bias_m:.3f}, or put bias_m under [sensor] in a profile"
        )
        found.fixes["sensor"] = {"bias_m": round(sensor.bias_m + bias.bias_m, 3)}
    if noise is not None and noise.is_other_than(sensor):
        ratio = noise.ratio_to(sensor)
        found.notes.append(
            f"depth has {ratio:.2g} +- {3 * noise.error * ratio:.1g} times the noise of the sensor's model; map with "
            f"--set mapper.sensor.noise_per_m={noise.noise_per_m:.4f} --set mapper.sensor.noise_m={noise.noise_m:.4f}, "
            f"or put them under [sensor] in a profile"
        )


def judge_extrinsics(found: Diagnosis, source: LogSource) -> None:
    """Report a camera pose on the body that differs from the profile's; one from TF is not checked."""
    if not are_assumed(source):
        return
    estimated = estimated_extrinsics(source, _REGISTERED)
    unchecked = "the camera's pose on the body is the profile's, and cannot be checked:"
    if isinstance(estimated, NoHandEye):
        found.notes.append(f"{unchecked} {estimated.reason}")
        return
    off = estimated.disagrees_with(body_from_camera_of(source.setup.plan))
    left_open = f" (its motion leaves open: {', '.join(estimated.open_names())})" if estimated.open_names() else ""
    if off is None and len(estimated.open_directions) == len(estimated.covariance):
        found.notes.append(f"{unchecked} the motion leaves every direction of it open")
    elif off is None:
        found.notes.append(f"by its motion the camera sits where the profile has it{left_open}")
    else:
        found.problems.append(
            f"by its motion the camera sits {off[0]:.2f} m and {np.degrees(off[1]):.1f} degrees from where the profile "
            f"has it{left_open}: {extrinsics_text(estimated)}; map with --extrinsics estimate, or put it into a profile"
        )
        rig = source.setup.rig
        if rig is not None and [(link.parent, link.child) for link in rig.links] == [(rig.body, rig.color)]:
            matrix = estimated.body_from_camera.round(5).tolist()
            found.fixes["rig"] = {"links": [{"parent": rig.body, "child": rig.color, "matrix": matrix}]}


def judge_conditions(found: Diagnosis, seen: Conditions | None) -> None:
    """Report images that are dark or without colour, and depth of drops in the air."""
    if seen is None:
        return
    if seen.brightness < DARK:
        found.problems.append(
            f"colour is black or nearly so (half of the pixels are below {seen.brightness:.0f} of 255): only depth "
            "separates things, and those of one surface become one; record with light, or check the exposure"
        )
    elif seen.color < GREY:
        found.notes.append("the camera has no colour: only brightness and depth separate things")
    if seen.specks > RAIN:
        found.problems.append(
            f"{seen.specks:.1%} of the depth are specks in the air, nearer than all around them; without rain or snow "
            f"at most {RAIN:.1%} are: things behind are seen less. Record when it is dry, or clean the camera's window"
        )


def _estimate(found: Diagnosis, megapixels: float, num_keyframes: int) -> None:
    found.estimate = {
        "map_s": round(num_keyframes * (_KEYFRAME_S + _MEGAPIXEL_S * megapixels + _SHAPE_S), 0),
        "memory_mb": round(_BASE_MB + _MEGAPIXEL_MB * megapixels + _KEYFRAME_MB * num_keyframes, -1),
    }


def _note_stamps(found: Diagnosis, *, is_heard: bool) -> None:
    late: dict[float, list[str]] = {}
    for name, figures in found.topics.items():
        if figures.get("unset_stamps"):
            found.notes.append(f"{name}: {figures['unset_stamps']} of {figures['messages']} header stamps are zero")
        if figures.get("worst_step_back_s", 0) > 1.0:
            found.notes.append(
                f"{name}: stamps go back by {figures['worst_step_back_s']} s: a looped log or a set clock"
            )
        # How far a robot's clock is from ours is one figure, which its status has.
        # Some recorders count from zero.
        if 1.0 < abs(figures.get("log_offset_s") or 0) < _OWN_CLOCK_S and not (
            figures.get("unset_stamps") or is_heard or name.endswith("tf_static")
        ):
            late.setdefault(round(figures["log_offset_s"], 1), []).append(name)
        if figures["type"] == "":
            found.notes.append(f"{name}: its type is not known; it is skipped")
    for offset_s, names in late.items():
        found.notes.append(f"recorded {offset_s} s after the header stamps: {', '.join(names)}")


def _note_frames(found: Diagnosis, fates: dict[str, int], reasons: Mapping[str, str], gaps: PoseGaps) -> None:
    total = found.frames["frames"] + sum(
        fates.get(name, 0) for name in ("no_pose", "color_without_depth", "frame_of_other_size", "late_color")
    )
    for name in sorted(fates):
        number = fates[name]
        if name in ("frames", "odometry_scans") or not number:
            continue
        if name in ("color_without_depth", "depth_without_color"):
            found.notes.append(f"{number} {name.replace('_', ' ')} within the tolerance")
        elif name == "no_pose" and number <= max(3.0, 0.02 * total):
            found.notes.append(f"{number} of {total} frames have no pose (the ends of the poses)")
        elif name == "no_pose" and (gaps.finding() or gaps.num_moving <= max(3.0, 0.02 * total)):
            standing = number - gaps.num_moving
            found.notes += [f"{standing} of {total} frames have no pose while the camera stands"] if standing else []
        elif name == "odometry_degenerate":
            found.notes.append(
                f"{number} of {fates['odometry_scans']} scans do not determine the motion along some direction (a bare "
                "wall, a corridor): there it is taken to go on as before"
            )
        elif name in ("depth_without_returns", "pose_jumps", "duplicate_pose"):
            found.notes.append(f"{number} {name.replace('_', ' ')}")
        else:
            reason = f": {reasons[name]}" if name in reasons else ""
            found.problems.append(f"{number} {name.replace('_', ' ')}{reason}")
    if found.streams.get("stamps", "").startswith("log time:"):
        found.problems.append(found.streams["stamps"])


def _note_damage(found: Diagnosis, flaws: Flaws) -> None:
    found.damage = [
        {"file": f.file, "offset": f.offset, "what": f.what, "bytes": f.num_bytes, "messages": f.num_lost}
        for f in flaws
    ]
    found.damaged_bytes = flaws.num_bytes
    if len(flaws):
        lost = sum(flaw.num_lost for flaw in flaws)
        share = f"{flaws.num_bytes} of {found.num_bytes} bytes"
        found.problems.append(f"{len(flaws)} damaged places, {share}; {lost} messages known to be lost")
