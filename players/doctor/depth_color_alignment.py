"""Registration of colour and depth: with a good calibration, edges of depth coincide with edges of colour.

The colour camera is shifted in steps of 5 mm. A larger intensity gradient at the depth edges shows a wrong calibration.
A shifted camera moves near edges by more pixels than far ones, unlike a shifted image.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.rigid import rotation_of_vector, rotation_vector
from hickory_stream.records import Frame

_STEP_M, _REACH_M = 0.005, 0.06
_NEAR_M, _FAR_M = 0.3, 4.0
_JUMP = 0.08
_BORDER_PX = 5
_MAX_PIXELS, _MIN_PIXELS = 2000, 150
_MIN_FRAMES = 4
_FULL_PERCENTILE = 95.0
# Smaller errors are within the residual of a fitted calibration, or below the resolution of the images.
_OFF_M, _OFF_PX = 0.0125, 1.5
_GAIN, _SHARE = 1.12, 0.75
_COARSEST_M = 0.01
_SURE_FRAMES, _SURE_PERCENT, _SURE_SHARE = 6, 95.0, 0.64
# Lags of depth behind colour; at the longest an edge must have moved so far.
_LAG_STEP_S = 0.02
LAGS_S = np.round(np.arange(-15, 16) * _LAG_STEP_S, 3)
_LEAST_MOTION_PX, _LAG_GAIN, _LEAST_LAG_S, _RESAMPLES = 12.0, 1.12, 0.04, 40


@dataclass(frozen=True, kw_only=True, slots=True)
class ColorAlignment:
    """The best position of the colour camera."""

    #: (x, y) from the calibrated position, in the camera's own frame.
    offset_m: tuple[float, float]
    #: The offset at the median depth of the edges.
    offset_px: float
    #: Intensity gradient there over the gradient without an offset.
    gain: float
    #: Share of the frames whose gain is greater than 1.
    share: float
    num_frames: int
    #: The gains of near and of far edges: chance does not follow the parallax.
    gains: tuple[float, float] = (np.inf, np.inf)
    #: Of samples of the frames, 95 % have an offset so near.
    error_m: float = 0.0

    @property
    def is_off(self) -> bool:
        """Whether the calibration error exceeds the uncertainty of its estimate from the images."""
        distance_m = float(np.hypot(*self.offset_m))
        is_peak = max(abs(value) for value in self.offset_m) < _REACH_M - _STEP_M / 2
        is_sure = self.num_frames >= _SURE_FRAMES and self.error_m <= _SURE_SHARE * distance_m
        is_clear = (
            is_peak
            and is_sure
            and min(self.gains) >= 1 + (_GAIN - 1) / 2
            and self.gain >= _GAIN
            and self.share >= _SHARE
        )
        return is_clear and distance_m >= _OFF_M and self.offset_px >= _OFF_PX


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class BorderScores:
    """Scores of one frame: gradients (near and far edges, y steps, x steps); the edges' median depth."""

    change: NDArray[np.float64]
    depth_m: float
    focal_px: float


@dataclass(frozen=True, kw_only=True, slots=True)
class ColorLag:
    """How late the stamps of depth are for those of colour, with three standard deviations, of `num_steps` motions."""

    lag_s: float
    error_s: float
    #: Intensity gradient at the depth edges without the lag, over the one with it.
    gain: float
    num_steps: int

    @property
    def is_off(self) -> bool:
        """Whether depth and colour were certainly taken at other times than their stamps say."""
        return self.gain >= _LAG_GAIN and abs(self.lag_s) >= max(_LEAST_LAG_S, self.error_s + _LAG_STEP_S)


def lag_scores(frame: Frame, before_from_after: NDArray[np.float64], seconds: float) -> NDArray[np.float64] | None:
    """Return the gradient along depth edges if they are late by each of `LAGS_S`; None if the edges hardly move.

    The camera moves by `before_from_after` (4, 4) within some seconds after the frame.
    """
    v, u, z = _borders(frame.depth_m)
    if len(z) < _MIN_PIXELS:
        return None
    camera, change = frame.camera, _change_of_light(frame.rgb)
    points = np.column_stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z])
    turn = rotation_vector(before_from_after[:3, :3])
    scores = np.empty(len(LAGS_S))
    for i, lag_s in enumerate(LAGS_S):
        share = -lag_s / seconds
        moved = points @ rotation_of_vector(share * turn).T + share * before_from_after[:3, 3]
        column = camera.fx * moved[:, 0] / moved[:, 2] + camera.cx
        row = camera.fy * moved[:, 1] / moved[:, 2] + camera.cy
        if i == 0 and np.median(np.hypot(column - u, row - v)) < _LEAST_MOTION_PX:
            return None
        inside = np.clip(np.rint(row), 0, camera.height - 1), np.clip(np.rint(column), 0, camera.width - 1)
        scores[i] = change[inside[0].astype(np.int64), inside[1].astype(np.int64)].mean()
    return scores


def color_lag(scores: Sequence[NDArray[np.float64]]) -> ColorLag | None:
    """Return the lag of depth behind colour; None for too few motions, or images without edges."""
    if len(scores) < _MIN_FRAMES:
        return None
    each = np.stack(scores)
    rng = np.random.default_rng(0)
    picked = [each[rng.integers(0, len(each), len(each))].sum(axis=0) for _ in range(_RESAMPLES)]
    total, at_rest = each.sum(axis=0), len(LAGS_S) // 2
    best = int(np.argmax(total))
    if total[at_rest] <= 0 or best in (0, len(LAGS_S) - 1):
        return None
    spread_s = float(np.std([LAGS_S[int(np.argmax(one))] for one in picked]))
    error_s = 3.0 * float(np.hypot(spread_s, _LAG_STEP_S / 2))
    gain = float(total[best] / total[at_rest])
    return ColorLag(lag_s=float(LAGS_S[best]), error_s=round(error_s, 4), gain=round(gain, 3), num_steps=len(each))


_STEPS_M = np.arange(-round(_REACH_M / _STEP_M), round(_REACH_M / _STEP_M) + 1) * _STEP_M


def border_scores(frame: Frame) -> BorderScores | None:
    """Return the scores of one frame; None if it has too few depth edges."""
    v, u, z = _borders(frame.depth_m)
    if len(z) < _MIN_PIXELS:
        return None
    change = _change_of_light(frame.rgb)
    height, width = change.shape
    is_near = np.argsort(np.argsort(z, kind="stable")) < len(z) // 2
    scores = np.empty((2, len(_STEPS_M), len(_STEPS_M)))
    columns = [np.clip(np.rint(u + frame.camera.fx * x / z).astype(np.int64), 0, width - 1) for x in _STEPS_M]
    for i, y in enumerate(_STEPS_M):
        rows = np.clip(np.rint(v + frame.camera.fy * y / z).astype(np.int64), 0, height - 1)
        found = [change[rows, column] for column in columns]
        scores[:, i] = [[value[chosen].mean() for value in found] for chosen in (is_near, ~is_near)]
    return BorderScores(change=scores, depth_m=float(np.median(z)), focal_px=float(frame.camera.fx))


def color_alignment(frames: Sequence[BorderScores]) -> ColorAlignment | None:
    """Return the registration of colour and depth, None for too few frames, coarse pixels, or images without edges."""
    if len(frames) < _MIN_FRAMES:
        return None
    halves = np.stack([frame.change for frame in frames])
    scores = halves.mean(axis=1)
    total = scores.sum(axis=0)
    middle = len(_STEPS_M) // 2
    at_rest = scores[:, middle, middle]
    pixels_per_m = frames[0].focal_px / float(np.median([frame.depth_m for frame in frames]))
    if at_rest.sum() <= 0 or pixels_per_m * _COARSEST_M < 1:
        return None
    row, column = (int(i) for i in np.unravel_index(int(np.argmax(total)), total.shape))
    rng, best = np.random.default_rng(0), _peak(total)
    picked = [scores[rng.integers(0, len(scores), len(scores))].sum(axis=0) for _ in range(_RESAMPLES)]
    distances_m = [np.hypot(*(_peak(one) - best)) for one in picked]
    sums = halves.sum(axis=0)
    gains = [round(float(gain), 3) for gain in sums[:, row, column] / np.maximum(sums[:, middle, middle], 1e-9)]
    offset_m = (round(float(_STEPS_M[column]), 4), round(float(_STEPS_M[row]), 4))
    return ColorAlignment(
        offset_m=offset_m,
        offset_px=round(float(np.hypot(*offset_m)) * pixels_per_m, 2),
        gain=round(float(total[row, column] / at_rest.sum()), 3),
        gains=(gains[0], gains[1]),
        error_m=round(max(_STEP_M, float(np.percentile(distances_m, _SURE_PERCENT))), 4),
        share=round(float((scores[:, row, column] > at_rest).mean()), 3),
        num_frames=len(frames),
    )


def _peak(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    row, column = np.unravel_index(int(np.argmax(scores)), scores.shape)
    return np.array([_STEPS_M[column], _STEPS_M[row]])


def _borders(depth_m: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    # Rows, columns and near depths (N,) of occluding edges; small gaps without depth, as of stereo, are bridged.
    is_seen = np.isfinite(depth_m)
    kernel = np.ones((_BORDER_PX, _BORDER_PX), dtype=np.uint8)
    nearest = cv2.erode(np.where(is_seen, depth_m, 1e6).astype(np.float32), kernel)
    farthest = cv2.dilate(np.where(is_seen, depth_m, 0.0).astype(np.float32), kernel)
    jump = (farthest > nearest * (1 + _JUMP)) & (nearest > _NEAR_M) & (nearest < _FAR_M)
    margin = 2 * _BORDER_PX
    jump[:margin], jump[-margin:], jump[:, :margin], jump[:, -margin:] = False, False, False, False
    v, u = np.nonzero(jump)
    every = max(1, len(v) // _MAX_PIXELS)
    v, u = v[::every], u[::every]
    return v.astype(np.float64), u.astype(np.float64), nearest[v, u].astype(np.float64)


def _change_of_light(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    # (H, W) in 0..1, saturated so that a few very strong edges do not dominate.
    gray = cv2.GaussianBlur(cv2.cvtColor(np.ascontiguousarray(rgb), cv2.COLOR_RGB2GRAY), (5, 5), 0).astype(np.float32)
    change = np.hypot(cv2.Sobel(gray, cv2.CV_32F, 1, 0), cv2.Sobel(gray, cv2.CV_32F, 0, 1))
    full = max(float(np.percentile(change, _FULL_PERCENTILE)), 1e-6)
    return np.minimum(change / full, 1.0).astype(np.float32)
