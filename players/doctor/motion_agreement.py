"""Comparison of poses with the motion that the images show: scale of depth, axes of the camera, lag, foreign poses.

Corners of one image are found in the next; their depth and the pinhole camera give the motion of the camera (P3P), in
the units of the depth and in the axes of the image. Each fault is a hypothesis on the poses; the sound one comes first.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import permutations, product
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import RecordingError
from hickory_stream.geometry.rigid import compose, invert, rotation_of_vector, rotation_vector
from hickory_stream.poses.hand_eye import FLU_FROM_OPTICAL
from hickory_stream.records import Frame, RawFrame
from players.doctor.depth_color_alignment import lag_scores

Matrix = NDArray[np.float64]
Poses = Literal["sound", "inverted", "applied twice", "foreign"]

_CORNERS, _APART_PX, _LEAST_CORNERS, _WINDOW_PX, _BACK_PX, _SAME_DEPTH = 400, 7, 15, 21, 0.5, 0.05
# A step ends with this motion by the poses, or after this time: the poses may be wrong.
_STEP_M, _STEP_RAD, _STEP_NS, _LOST_NS = 0.06, 0.05, 400_000_000, 1_000_000_000
STEPS = 24
# A camera moves that moves by more, in metres or radians; the motion is right that is off by less than a share more.
_MOVES_M, _MOVES_RAD, _OFF_M, _OFF_RAD, _OFF_SHARE, _LEVER_M = 0.02, 0.02, 0.01, 0.01, 0.3, 0.1
_LEAST_MOVING, _LEAST_TRANSLATIONS = 6, 5
# Shares of the steps that a hypothesis explains: it holds, and it fails.
_HOLDS, _SURE, _FAILS, _BETTER = 0.75, 0.9, 0.4, 0.3
_COARSE_NS, _STEP_OF_LAG_NS = np.arange(-80, 81) * 50e6, 5e6
_FINE_NS, _MOST_SPREAD_NS = np.arange(-40, 41) * _STEP_OF_LAG_NS, 1e8
_LAG_S, _MOST_LAG_S, _RESAMPLES = 0.03, 0.1, 40
# The scale is at least so unsure: corners lie at edges, where depth errs.
_SCALE_ERROR = 0.02
# How far from the camera, by one sigma, poses may be that claim to be its own; rounds of the least squares for both.
_UNSTATED_M, _ROUNDS, _LEAST_SPREAD = 0.5, 10, 0.1
_SCALE_OFF = 1.08


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CameraStep:
    """A motion (4, 4) of the camera between two stamps, in units of the depth, and the median depth of its corners."""

    start_ns: int
    end_ns: int
    before_from_after: Matrix
    depth_m: float


@dataclass(frozen=True, kw_only=True, slots=True)
class MotionAgreement:
    """How poses and images agree; an error is three standard deviations wide, None stands for an open number."""

    num_steps: int
    num_moving: int
    #: Share of the moving steps on which the poses as they are, and those with the fault named here, agree.
    share: float
    mended_share: float
    poses: Poses = "sound"
    #: The image's right, down and forward in the axes of the frame that the poses have.
    axes: str = "x y z"
    is_mirrored: bool = False
    #: The depth is too large by this factor.
    scale: float | None = None
    scale_error: float | None = None
    #: The stamps of the poses are late by this.
    lag_s: float | None = None
    lag_error_s: float | None = None
    depth_m: float = 0.0

    @property
    def has_other_scale(self) -> bool:
        """Whether depth and poses certainly have different units."""
        if self.scale is None or self.scale_error is None or self.poses == "foreign":
            return False
        low, high = self.scale / (1 + self.scale_error), self.scale * (1 + self.scale_error)
        return low > _SCALE_OFF or high < 1 / _SCALE_OFF

    @property
    def has_lag(self) -> bool:
        """Whether the stamps of the poses are certainly late or early."""
        known = self.lag_s is not None and self.lag_error_s is not None and self.poses != "foreign"
        return known and abs(self.lag_s or 0.0) > _LAG_S + (self.lag_error_s or 0.0)

    @property
    def is_surely_sound(self) -> bool:
        """Whether no scale or lag within the errors would be a fault if both were as well known as they can be."""
        is_known = self.scale is not None and self.lag_s is not None
        if not is_known or self.poses != "sound" or self.axes != "x y z" or self.share < _SURE:
            return False
        off = max(self.scale or 1.0, 1 / (self.scale or 1.0)) * (1 + (self.scale_error or 0.0))
        late_s = abs(self.lag_s or 0.0) + (self.lag_error_s or 0.0)
        return off < _SCALE_OFF * (1 + 3 * _SCALE_ERROR) and late_s < _LAG_S + 3 * _STEP_OF_LAG_NS / 1e9

    @property
    def is_worthless(self) -> bool:
        """Whether a map with these poses and depths would be worthless."""
        is_late = self.has_lag and abs(self.lag_s or 0.0) > _MOST_LAG_S
        # Foreign poses are only suspected: a robot that is carried, or images that repeat themselves, look alike.
        return self.poses not in ("sound", "foreign") or self.axes != "x y z" or self.has_other_scale or is_late


def step_between(before: Frame, after: Frame) -> CameraStep | None:
    """Return the motion of the camera between two frames; None without enough corners that have a depth.

    An image that is repeated shows no motion, whatever the camera did.
    """
    if np.array_equal(before.rgb, after.rgb):
        return None
    old, new = (cv2.cvtColor(np.ascontiguousarray(frame.rgb), cv2.COLOR_RGB2GRAY) for frame in (before, after))
    corners = cv2.goodFeaturesToTrack(old, _CORNERS, 0.01, _APART_PX)
    if corners is None or len(corners) < _LEAST_CORNERS:
        return None
    window: dict[str, Any] = {"winSize": (_WINDOW_PX, _WINDOW_PX), "maxLevel": 4}
    there, is_there, _ = cv2.calcOpticalFlowPyrLK(old, new, corners, None, **window)
    back, is_back, _ = cv2.calcOpticalFlowPyrLK(new, old, there, None, **window)
    is_found = ((is_there == 1) & (is_back == 1))[:, 0] & (np.linalg.norm(corners - back, axis=2)[:, 0] < _BACK_PX)
    pixels, there = corners[is_found, 0].astype(np.float64), there[is_found, 0].astype(np.float64)
    height, width = before.depth_m.shape
    columns, rows = np.rint(pixels).astype(np.int64).T
    z = before.depth_m[rows.clip(0, height - 1), columns.clip(0, width - 1)].astype(np.float64)
    has_depth = np.isfinite(z) & (z > 0)
    if has_depth.sum() < _LEAST_CORNERS:
        return None
    pixels, there, z, camera = pixels[has_depth], there[has_depth], z[has_depth], before.camera
    # The unit does not matter to the projection, but to the solver's thresholds.
    unit = float(np.median(z))
    rays = np.column_stack([(pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones(len(z))])
    points = rays * (z / unit)[:, None]
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    cv2.setRNGSeed(0)
    found, turn, shift, chosen = cv2.solvePnPRansac(
        points, there, matrix, None, reprojectionError=2.0, flags=cv2.SOLVEPNP_EPNP
    )
    if not found or chosen is None or len(chosen) < max(_LEAST_CORNERS, len(z) // 2):
        return None
    turn, shift = cv2.solvePnPRefineLM(points[chosen[:, 0]], there[chosen[:, 0]], matrix, None, turn, shift)
    after_from_before = np.eye(4)
    after_from_before[:3, :3], after_from_before[:3, 3] = cv2.Rodrigues(turn)[0], shift[:, 0] * unit
    # The depth of the second image is a witness that the motion did not come from.
    columns, rows = np.rint(there[chosen[:, 0]]).astype(np.int64).T
    seen = after.depth_m[rows.clip(0, height - 1), columns.clip(0, width - 1)]
    expected = unit * (points[chosen[:, 0]] @ after_from_before[2, :3]) + after_from_before[2, 3]
    is_seen = np.isfinite(seen) & (seen > 0)
    if is_seen.sum() < _LEAST_CORNERS or np.median(np.abs(seen[is_seen] / expected[is_seen] - 1)) > _SAME_DEPTH:
        return None
    return CameraStep(
        start_ns=before.stamp_ns, end_ns=after.stamp_ns, before_from_after=invert(after_from_before), depth_m=unit
    )


@dataclass(slots=True)
class MotionSampler:
    """Takes the frames of a source in order, and decodes those of about 24 steps, which spread over the log."""

    #: Whether `lag_scores` are wanted.
    compares_colors: bool = False
    #: Frames from one step to the next; it doubles where the log is longer than expected.
    every: int = 1
    #: From the end of a step to the next one.
    rest_ns: int = 0
    steps: list[CameraStep] = field(default_factory=list)
    #: Of the steps in which edges move: where depth lies on colour.
    lag_scores: list[NDArray[np.float64]] = field(default_factory=list)
    stamps_ns: list[int] = field(default_factory=list)
    poses: list[Matrix] = field(default_factory=list)
    _begun: RawFrame | None = None
    #: the last step's second frame, with which the next step often begins
    _decoded: Frame | None = None
    _next: int = 0
    _rests_until_ns: int = 0
    _has_ended: bool = False

    @property
    def num_moving(self) -> int:
        """The number of steps in which the camera moves by the images."""
        return sum(_moves(step.before_from_after, step.depth_m) for step in self.steps)

    def add(self, raw: RawFrame) -> None:
        """Take a frame; a step back in time, or a jump of the poses, ends the comparison."""
        self._has_ended |= bool(self.stamps_ns) and (
            raw.stamp_ns <= self.stamps_ns[-1] or raw.after_from_before is not None
        )
        if self._has_ended or not raw.is_posed:
            return
        number = len(self.stamps_ns)
        self.stamps_ns.append(raw.stamp_ns)
        self.poses.append(raw.world_from_camera)
        if self._begun is None or raw.stamp_ns - self._begun.stamp_ns > _LOST_NS:
            is_next = number >= self._next and raw.stamp_ns >= self._rests_until_ns
            self._begun, self._decoded = raw if is_next else None, None
            return
        motion = compose(invert(self._begun.world_from_camera), raw.world_from_camera)
        is_far = np.linalg.norm(motion[:3, 3]) > _STEP_M or np.linalg.norm(rotation_vector(motion[:3, :3])) > _STEP_RAD
        if not is_far and raw.stamp_ns - self._begun.stamp_ns < _STEP_NS:
            return
        with suppress(RecordingError, cv2.error):
            before, self._decoded = self._decoded or self._begun.decode(), None
            after = raw.decode()
            if (step := step_between(before, after)) is not None:
                self.steps.append(replace(step, start_ns=self._begun.stamp_ns, end_ns=raw.stamp_ns))
                if self.compares_colors:
                    seconds = (raw.stamp_ns - self._begun.stamp_ns) / 1e9
                    scores = lag_scores(before, step.before_from_after, seconds)
                    self.lag_scores += [scores] if scores is not None else []
            self._decoded = after
        if len(self.steps) > 2 * STEPS:
            self.steps, self.every = self.steps[::2], 2 * self.every
        self._next = max(number, self._next + self.every)
        self._rests_until_ns = raw.stamp_ns + self.rest_ns
        if number >= self._next and not self.rest_ns:
            self._begun = raw
        else:
            self._begun = self._decoded = None

    def agreement(self, body_from_camera: Matrix | None = None) -> MotionAgreement | None:
        """Return the comparison; None if too little moves, or too few images show how.

        `body_from_camera` (4, 4) is the static link after the poses of the log, if there is one.
        """
        if len(self.stamps_ns) < 2 or len(self.steps) < _LEAST_MOVING:
            return None
        seen, track = _Seen(self.steps), _Track(np.array(self.stamps_ns), np.array(self.poses))
        sound = best = seen.fit(track)
        if sound.num_moving < _LEAST_MOVING:
            return None
        poses: Poses = "sound"
        lag_s, lag_error_s = _lag_of(seen, track, np.eye(3))
        if lag_s is not None and lag_error_s is not None and abs(lag_s) > _LAG_S + lag_error_s:
            best = seen.fit(track, 1e9 * lag_s)
        if best.share < _HOLDS:
            least = max(_HOLDS, sound.share + _BETTER)
            found = next((one for one in _trials(seen, track, body_from_camera) if one[1].share >= least), None)
            if found is not None:
                poses, best, track = found
                lag_s, lag_error_s = _lag_of(seen, track, best.axes)
            elif max(sound.share, best.share) > _FAILS or sound.num_moving < 2 * _LEAST_MOVING:
                return None
            else:
                poses, best, lag_s, lag_error_s = "foreign", sound, None, None
        scale, scale_error = _scale_of(seen, track, best)
        return MotionAgreement(
            num_steps=len(self.steps),
            num_moving=best.num_moving,
            share=round(sound.share, 3),
            mended_share=round(best.share, 3),
            poses=poses,
            axes=_axes_text(best.axes),
            is_mirrored=bool(np.linalg.det(best.axes) < 0),
            scale=scale,
            scale_error=scale_error,
            lag_s=lag_s,
            lag_error_s=lag_error_s,
            depth_m=round(float(np.median(seen.units)), 3),
        )


def _order(axes: Matrix) -> tuple[bool, bool, bool]:
    return bool(np.linalg.det(axes) < 0), bool(np.trace(axes) < 1), not np.array_equal(axes, FLU_FROM_OPTICAL)


# The image's axes as columns in the frame of the poses. The likely ones come first: of those that fit alike, the first
# counts.
_AXES = sorted(
    (np.eye(3)[:, list(order)] * signs for order in permutations(range(3)) for signs in product((1.0, -1.0), repeat=3)),
    key=_order,
)


def _axes_text(axes: Matrix) -> str:
    return " ".join(f"{'-' * int(column.sum() < 0)}{'xyz'[int(np.argmax(np.abs(column)))]}" for column in axes.T)


def _trials(seen: "_Seen", track: "_Track", link: Matrix | None) -> "Iterator[tuple[Poses, _Fit, _Track]]":
    yield "sound", max((seen.fit(track, 0.0, axes) for axes in _AXES), key=lambda fit: fit.share), track
    for body_from_camera in (np.eye(4), *([] if link is None else [link])):
        camera_from_body = invert(body_from_camera)
        inverted = [body_from_camera @ invert(pose) @ body_from_camera for pose in track.poses]
        once = _roots(track.poses @ camera_from_body) @ body_from_camera
        for name, poses in (("inverted", inverted), ("applied twice", once)):
            other = _Track(track.stamps_ns, np.array(poses))
            yield name, seen.fit(other), other  # type: ignore[misc]
    late = [seen.fit(track, lag_ns, axes) for lag_ns in _COARSE_NS[20:-20:2] for axes in _AXES[:24]]
    # Of so many hypotheses one may fit by chance.
    sure = [
        fit for fit in late if fit.share >= _SURE and fit.num_moving >= max(2 * _LEAST_MOVING, len(seen.units) // 2)
    ]
    if sure:
        yield "sound", max(sure, key=lambda fit: fit.share), track


def _roots(poses: Matrix) -> Matrix:
    # The poses whose squares these are; of the two turns that have the same square, the one that continues.
    roots = np.tile(np.eye(4), (len(poses), 1, 1))
    for i, pose in enumerate(poses):
        half = 0.5 * rotation_vector(pose[:3, :3])
        other = half * (1 - np.pi / max(float(np.linalg.norm(half)), 1e-9))
        turns = [rotation_of_vector(half), rotation_of_vector(other)]
        turn = max(turns, key=lambda one: np.trace(one @ roots[max(i - 1, 0), :3, :3].T))
        roots[i, :3, :3], roots[i, :3, 3] = turn, np.linalg.pinv(np.eye(3) + turn) @ pose[:3, 3]
    return roots


def _moves(motion: Matrix, unit_m: float) -> bool:
    # In shares of the depth, whatever its unit.
    turned = float(np.linalg.norm(rotation_vector(motion[:3, :3])))
    return turned > _MOVES_RAD or float(np.linalg.norm(motion[:3, 3])) > _MOVES_M * unit_m


_Motions = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]


class _Track:
    # Poses of frames, interpolated, and their motions by the lag.

    def __init__(self, stamps_ns: NDArray[np.int64], poses: Matrix) -> None:
        self.stamps_ns, self.poses, self._motions = stamps_ns, poses, dict[bytes, _Motions]()
        self._times = (stamps_ns - stamps_ns[0]).astype(np.float64)
        self._turns = _vectors_of(poses[:-1, :3, :3].swapaxes(-1, -2) @ poses[1:, :3, :3])

    def motions(self, ends_ns: NDArray[np.int64], lags_ns: NDArray[Any]) -> _Motions:
        # Turns and shifts (L, N, 3) between ends (2, N) by the poses of the lags later, and which of them are known.
        key = lags_ns.tobytes()
        if key not in self._motions:
            self._motions[key] = self._motions_at(ends_ns, lags_ns)
        return self._motions[key]

    def _motions_at(self, ends_ns: NDArray[np.int64], lags_ns: NDArray[Any]) -> _Motions:
        times = (ends_ns - self.stamps_ns[0])[:, None] + lags_ns[:, None]
        known = (times >= 0) & (times <= self._times[-1])
        after = np.clip(np.searchsorted(self._times, times), 1, len(self._times) - 1)
        known &= self._times[after] - self._times[after - 1] <= _LOST_NS
        share = (np.clip(times, 0, self._times[-1]) - self._times[after - 1]) / np.diff(self._times)[after - 1]
        share, before = share[..., None], self.poses[after - 1]
        start, end = before[..., :3, :3] @ _rotations_of(share * self._turns[after - 1])
        first, last = before[..., :3, 3] + share * (self.poses[after, :3, 3] - before[..., :3, 3])
        back = start.swapaxes(-1, -2)
        return _vectors_of(back @ end), (back @ (last - first)[..., None])[..., 0], known.all(axis=0)


def _vectors_of(rotations: Matrix) -> Matrix:
    # The rotation vectors (..., 3) of rotations (..., 3, 3).
    skew = (rotations - rotations.swapaxes(-1, -2))[..., (2, 0, 1), (1, 2, 0)]
    sine = np.linalg.norm(skew, axis=-1, keepdims=True)
    angle = np.arctan2(sine, np.trace(rotations, axis1=-2, axis2=-1)[..., None] - 1)
    return np.asarray(skew * angle / np.maximum(sine, 1e-12))


def _rotations_of(vectors: Matrix) -> Matrix:
    # Rodrigues' formula.
    cross = np.cross(np.eye(3), vectors[..., None, :])
    half = np.linalg.norm(vectors, axis=-1)[..., None, None] / (2 * np.pi)
    return np.asarray(np.eye(3) + np.sinc(2 * half) * cross + 0.5 * np.sinc(half) ** 2 * (cross @ cross))


@dataclass(frozen=True, slots=True)
class _Fit:
    share: float
    num_moving: int
    axes: Matrix
    lag_ns: float
    #: (N,) whether each step moves and agrees
    agrees: NDArray[np.bool_]


class _Seen:
    # The steps as arrays.

    def __init__(self, steps: Sequence[CameraStep]) -> None:
        self.ends_ns = np.array([[step.start_ns for step in steps], [step.end_ns for step in steps]])
        self.turns = np.array([rotation_vector(step.before_from_after[:3, :3]) for step in steps])
        self.shifts = np.array([step.before_from_after[:3, 3] for step in steps])
        self.units = np.array([step.depth_m for step in steps])

    def off(self, track: _Track, lags_ns: NDArray[Any], axes: Matrix) -> tuple[NDArray[Any], ...]:
        # (L, N) by lag and step: whether it is known, the differences of turn and shift, and their lengths.
        turns, shifts, known = track.motions(self.ends_ns, lags_ns)
        seen_turns, seen_shifts = np.linalg.det(axes) * self.turns @ axes.T, self.shifts @ axes.T
        moved_m, seen_m = np.linalg.norm(shifts, axis=-1), np.linalg.norm(seen_shifts, axis=-1)
        has_shift = known & (moved_m > _MOVES_M)
        # The median ratio of each lag; without any, the scale is 1.
        ratios = np.sort(np.where(has_shift, seen_m / np.maximum(moved_m, _MOVES_M), np.inf), axis=-1)
        count = has_shift.sum(axis=-1, keepdims=True)
        low, high = (np.take_along_axis(ratios, np.maximum(count - i, 0) // 2, axis=-1) for i in (1, 0))
        scale = np.where(count > 0, np.maximum((low + high) / 2, 1e-6), 1.0)
        turned = np.maximum(np.linalg.norm(seen_turns, axis=-1), np.linalg.norm(turns, axis=-1))
        off_m = np.linalg.norm(shifts - seen_shifts / scale[..., None], axis=-1)
        off_rad = np.linalg.norm(turns - seen_turns, axis=-1)
        return known, off_rad, off_m, turned, np.maximum(moved_m, seen_m / scale)

    def fit(self, track: _Track, lag_ns: float = 0.0, axes: Matrix = np.eye(3)) -> _Fit:  # noqa: B008 # not changed
        off = self.off(track, np.array([lag_ns]), axes)
        known, off_rad, off_m, turned, longest_m = (values[0] for values in off)
        seen_m = np.linalg.norm(self.shifts, axis=1)
        moving = known & ((turned > _MOVES_RAD) | (longest_m > _MOVES_M) | (seen_m > _MOVES_M * self.units))
        agrees = moving & (off_rad < _OFF_RAD + _OFF_SHARE * turned)
        agrees &= off_m < _OFF_M + _OFF_SHARE * longest_m + _LEVER_M * turned
        return _Fit(float(agrees.sum() / max(moving.sum(), 1)), int(moving.sum()), axes, lag_ns, agrees)


def _scale_of(seen: _Seen, track: _Track, fit: _Fit) -> tuple[float | None, float | None]:
    turns, shifts, _ = (values[0] for values in track.motions(seen.ends_ns, np.array([fit.lag_ns])))
    moved_m = np.linalg.norm(shifts, axis=1)
    chosen = fit.agrees & (moved_m > _MOVES_M)
    if chosen.sum() < _LEAST_TRANSLATIONS:
        return None, None
    # Where the poses are those of a place l beside the camera, seen = scale (shift + (turn - 1) l): linear in scale and
    # in scale l, which few robots state. The noise is that of what was seen.
    turned, shifts = _rotations_of(turns[chosen]) - np.eye(3), shifts[chosen]
    shown, moved_m = seen.shifts[chosen] @ fit.axes.T, moved_m[chosen]
    rows = np.concatenate([shifts[:, :, None], turned], axis=2)
    scale, weights = float(np.median((shown * shifts).sum(axis=1) / moved_m**2)), np.ones(len(shown))
    for _ in range(_ROUNDS):
        if scale <= 0:
            return None, None
        sigma_m, prior = scale * (0.004 + 0.05 * moved_m), np.diag([0.0, *[(_UNSTATED_M * scale) ** -2] * 3])
        information = np.einsum("nij,n,nik->jk", rows, weights * sigma_m**-2, rows) + prior
        found = np.linalg.solve(information, np.einsum("nij,n,ni->j", rows, weights * sigma_m**-2, shown))
        off, scale = np.linalg.norm(rows @ found - shown, axis=1) / sigma_m, float(found[0])
        # The median of the length of three normal numbers is 1.54 sigma; Huber's weights.
        spread = max(float(np.median(off)) / 1.54, _LEAST_SPREAD)
        weights = np.minimum(1.0, 1.5 * 1.54 * spread / np.maximum(off, 1e-9)) / spread**2
    error = np.sqrt(np.linalg.inv(information)[0, 0]) / scale
    return round(scale, 4), round(3.0 * float(np.hypot(error, _SCALE_ERROR)), 4)


def _lag_of(seen: _Seen, track: _Track, axes: Matrix) -> tuple[float | None, float | None]:
    # The lag where the motions differ least, and its spread over samples of the steps.
    lags = _COARSE_NS
    for _ in range(2):
        known, off_rad, off_m, turned, longest_m = seen.off(track, lags, axes)
        off = np.square(off_rad / (0.004 + 0.05 * turned)) + np.square(off_m / (0.01 + 0.1 * longest_m))
        if known[len(lags) // 2].sum() < _LEAST_MOVING:
            return None, None
        known = known & (known.sum(axis=1) >= max(_LEAST_MOVING, len(seen.units) // 4))[:, None]
        rng = np.random.default_rng(0)
        picked = [np.arange(len(seen.units)), *rng.integers(0, len(seen.units), (_RESAMPLES, len(seen.units)))]
        numbers = known[:, picked].sum(axis=-1)
        sums = np.where(known, np.log1p(off), 0.0)[:, picked].sum(axis=-1)
        means = np.divide(sums, numbers, out=np.full(sums.shape, np.inf), where=numbers > 0)
        found = lags[np.argmin(means, axis=0)]
        if np.std(found) > _MOST_SPREAD_NS:
            return None, None
        lags = found[0] + _FINE_NS
    # Samples of few steps are too much alike.
    spread_ns = float(np.std(found)) * (1 + 3 / len(seen.units))
    return float(found[0]) / 1e9, round(3.0 * float(np.hypot(spread_ns, _STEP_OF_LAG_NS)) / 1e9, 4)
