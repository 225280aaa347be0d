"""Hand-eye calibration: the camera's pose on the body, from motions of the pose topic and of depth odometry.

It serves logs without TF, for which the profile can only assume that pose.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.errors import CalibrationError, RecordingError
from hickory_stream.geometry.rigid import compose, invert
from hickory_stream.ports import NotRegistered
from hickory_stream.poses.camera_odometry import CameraOdometry
from hickory_stream.poses.hand_eye import HandEye, NoHandEye, hand_eye
from players.poses.camera_poses import body_from_camera_of, with_extrinsics

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from players.logs.log_source import LogSource

_MAX_FRAMES = 400
"""The number of frames that are examined; about a minute of walking suffices."""

_LEAST_STEP_NS = 90_000_000
_MOTION_NS = 1_000_000_000
"""The time between two poses of a motion: large compared with pose noise, small compared with odometry drift."""


def are_assumed(source: LogSource) -> bool:
    """Return whether the camera's pose on the body comes from the profile rather than from the log."""
    plan = source.setup.plan
    is_turned = source.setup.corrections.frame_from_optical is not None
    return plan.stream is not None and plan.is_static and plan.extrinsics.startswith("profile") and not is_turned


def estimated_extrinsics(source: LogSource, most_frames: int = _MAX_FRAMES) -> HandEye | NoHandEye:
    """Return the camera's pose on the body, from the beginning of a log; undetermined directions stay the log's."""
    plan = source.setup.plan
    if plan.stream is None or not plan.is_static:
        return NoHandEye(reason="the poses of the log are not those of one body")
    assumed = body_from_camera_of(plan)
    bodies = source.with_plan(replace(plan, links=()))
    odometry = CameraOdometry()
    track: list[tuple[int, NDArray[np.float64], NDArray[np.float64]]] = []
    num_seen = 0
    last_ns: int | None = None
    for raw in bodies.frames():
        if not raw.is_posed or (last_ns is not None and 0 <= raw.stamp_ns - last_ns < _LEAST_STEP_NS):
            continue
        last_ns = raw.stamp_ns
        num_seen += 1
        if num_seen > most_frames:
            break
        try:
            found = odometry.register(raw.decode())
        except RecordingError:
            continue
        if not isinstance(found, NotRegistered) and not len(found.degenerate):
            track.append((raw.stamp_ns, raw.world_from_camera, found.start_from_sensor))
    bodies.close()
    pairs = _motions(track)
    if not pairs:
        return NoHandEye(reason=f"of {num_seen} frames none has another one a second later")
    return hand_eye([body for body, _ in pairs], [camera for _, camera in pairs], assumed)


def with_estimated_extrinsics(source: LogSource) -> LogSource:
    """Return the log with the estimated pose of its camera on the body.

    Raises `CalibrationError`: the motion does not determine that pose.
    """
    if source.setup.corrections.frame_from_optical is not None:
        found_axes = "found camera_axes in the profile with --extrinsics estimate, which estimates them too"
        raise CalibrationError(f"{source.info.uri}: {found_axes}; leave one of them out")
    found = estimated_extrinsics(source)
    if isinstance(found, NoHandEye):
        raise CalibrationError(
            f"{source.info.uri}: where the camera sits cannot be estimated: {found.reason}. Play it with "
            "--extrinsics log, or name a --profile with the links of this robot"
        )
    origin = f"estimated by the motion: {extrinsics_text(found)}"
    if found.open_names():
        origin += f"; as assumed where the motion leaves it open ({', '.join(found.open_names())})"
    return source.with_plan(with_extrinsics(source.setup.plan, found.body_from_camera, origin))


def extrinsics_text(found: HandEye) -> str:
    """Return the camera's pose on the body and its uncertainty in words, in the body's axes."""
    place = ", ".join(f"{value:+.3f}" for value in found.body_from_camera[:3, 3])
    sigma = np.sqrt(np.maximum(np.diag(found.covariance), 0.0))
    return (
        f"at ({place}) m, +- {sigma[3:].max():.3f} m and {np.degrees(sigma[:3]).max():.2f} degrees, "
        f"by {found.num_motions} motions"
    )


def _motions(
    track: list[tuple[int, NDArray[np.float64], NDArray[np.float64]]],
) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    # Motions over a second each; consecutive motions overlap by half.
    motions = []
    next_ns, last = None, 0
    for stamp_ns, body, camera in track:
        if next_ns is not None and stamp_ns < next_ns:
            continue
        next_ns = stamp_ns + _MOTION_NS // 2
        while last < len(track) and track[last][0] < stamp_ns + _MOTION_NS:
            last += 1
        if last == len(track):
            break
        after_ns, body_after, camera_after = track[last]
        if after_ns - stamp_ns <= 2 * _MOTION_NS:
            motions.append((compose(invert(body), body_after), compose(invert(camera), camera_after)))
    return motions
