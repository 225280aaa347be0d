"""Estimate of a constant bias of depth: views from different places agree only without it.

A bias shifts a surface along the rays of each view. Flat patches of two frames are compared after taking off a bias,
with a small error of the pose between them left free; the bias for which all pairs agree best is the camera's.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.records import RawFrame
from players.doctor.depth_noise import FlatPatches

# A smaller bias cannot be distinguished from the effect of lens distortion.
_OFF_M, _OFF_SIGMAS, _LEAST_GAIN = 0.02, 3.0, 1.15
_MOST_M, _STEP_M = 0.2, 0.02
_MIN_FRAMES, _MIN_PAIRS, _MIN_COMMON, _MOST_COMMON, _NEXT, _PARTS = 4, 8, 12, 40, 4, 6
# Patches are of one plane whose normals differ by less than this cosine, and whose places differ by less across it.
_LEVEL, _ACROSS_M, _ALONG_M = 0.97, 0.2, 0.4
_FLAT_M, _INDEPENDENT, _POSE_M, _POSE_RAD = 0.004, 10.0, 0.01, 0.005
# No estimate is better than this. Few frames make it worse, and so does this share of the bias that doubles what is
# left of the disagreement: a real camera has faults that no view shows.
_LEAST_ERROR_M, _UNKNOWN_SHARE, _CLEAR_M = 0.004, 0.15, 0.08
# Views for an estimate: bursts of frames at this distance in time, which begin at quarters of a log.
_BURSTS, _BURST, _MOST_VIEWS, _APART_NS, _SHARE_APART = 4, 6, 30, 350_000_000, 12

_Matrix = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True)
class DepthBias:
    """The constant by which depth is too large, its standard error, and the number of frames that were compared."""

    bias_m: float
    error_m: float
    num_frames: int
    #: Disagreement of the views with the bias, over the one without it.
    gain: float = np.inf

    @property
    def is_off(self) -> bool:
        """Whether the depth error certainly exceeds the uncertainty of its estimate."""
        is_certain = self.gain >= _LEAST_GAIN and abs(self.bias_m) >= _OFF_M
        return is_certain and abs(self.bias_m) >= _OFF_SIGMAS * self.error_m


def depth_bias(frames: Sequence[FlatPatches]) -> DepthBias | None:
    """Return the constant bias of depth; None if too few views share surfaces, or it is beyond 0.2 m."""
    grid = np.arange(-_MOST_M, _MOST_M + _STEP_M / 2, _STEP_M)
    shifted = [[_without(patches, bias_m) for patches in frames] for bias_m in grid]
    pairs, costs = list[tuple[int, int]](), list[_Matrix]()
    for i in range(len(frames)):
        for j in range(i + 1, min(i + _NEXT + 1, len(frames))):
            found = [_disagreement(frames[i], frames[j], at[i], at[j]) for at in shifted]
            if np.isfinite(found).all():
                pairs.append((i, j))
                costs.append(np.array(found))
    ends = np.array(pairs).reshape(-1, 2)
    used = np.unique(ends)
    if len(pairs) < _MIN_PAIRS or len(used) < _MIN_FRAMES:
        return None
    each = np.array(costs)
    total = each.sum(axis=0)
    bias_m, doubling_m = _least(grid, total)
    # Neighbours err alike: they are left out together.
    parts = [~np.isin(ends, part).any(axis=1) for part in np.array_split(used, min(_PARTS, len(used)))]
    left_out = [_least(grid, each[kept].sum(axis=0))[0] for kept in parts if kept.any()]
    if bias_m is None or any(one is None for one in left_out) or len(left_out) < _MIN_FRAMES:
        return None
    number = len(left_out)
    spread_m = float(np.sqrt((number - 1) * np.var(np.array(left_out, dtype=np.float64)))) * (1 + 3 / number)
    error_m = float(
        np.linalg.norm([spread_m, _UNKNOWN_SHARE * doubling_m * max(1.0, doubling_m / _CLEAR_M), _LEAST_ERROR_M])
    )
    gain = round(float(total[len(grid) // 2] / max(total.min(), 1e-9)), 3)
    return DepthBias(bias_m=bias_m, error_m=error_m, num_frames=len(used), gain=gain)


class ViewSampler:
    """Chooses the frames for an estimate: neighbours that show the same surfaces, from all parts of a log."""

    def __init__(self, expected_frames: int) -> None:
        self._expected = expected_frames
        self._last: tuple[int, int] | None = None
        self._burst = self._left = self._taken = 0

    def wants(self, raw: RawFrame) -> bool:
        """Return whether to take a frame; it is then taken."""
        if raw.index >= self._burst * self._expected // _BURSTS:
            self._burst, self._left = self._burst + 1, _BURST
        is_apart = self._last is None or (
            raw.index - self._last[0] >= max(1, self._expected // _SHARE_APART)
            or abs(raw.stamp_ns - self._last[1]) >= _APART_NS
        )
        if not (is_apart and self._left and self._taken < _MOST_VIEWS):
            return False
        self._left, self._taken, self._last = self._left - 1, self._taken + 1, (raw.index, raw.stamp_ns)
        return True


def _without(patches: FlatPatches, bias_m: float) -> tuple[_Matrix, _Matrix]:
    # Places and normals without a bias. With q = 1/z = P (u, v, 1), the slope of q grows by (z / z')^2.
    z = patches.reach_m
    if not len(z):
        return patches.points_world, patches.normals_world
    inverse, new = 1.0 / z, 1.0 / np.maximum(z - bias_m, 0.05)
    planes = patches.normals_world * (inverse / (patches.normals_world * patches.rays_world).sum(axis=1))[:, None]
    grown = (new / inverse) ** 2
    planes = planes * grown[:, None] + (new - grown * inverse)[:, None] * patches.forward_world
    return patches.points_world - bias_m * patches.rays_world, planes / np.linalg.norm(planes, axis=1, keepdims=True)


def _disagreement(
    a: FlatPatches, b: FlatPatches, at_a: tuple[_Matrix, _Matrix], at_b: tuple[_Matrix, _Matrix]
) -> float:
    # Robust sum over patches of a plane that both frames see; NaN for too few.
    if len(a.depth_m) < _MIN_COMMON or len(b.depth_m) < _MIN_COMMON:
        return np.nan
    off = at_b[0][None] - at_a[0][:, None]
    across = (off * at_a[1][:, None]).sum(axis=-1)
    along = np.sqrt(np.maximum((off * off).sum(axis=-1) - across * across, 0))
    is_same = (at_a[1] @ at_b[1].T > _LEVEL) & (np.abs(across) < _ACROSS_M) & (along < _ALONG_M)
    along = np.where(is_same, along, np.inf)
    nearest = along.argmin(axis=1)
    i = np.flatnonzero(np.isfinite(along.min(axis=1)))
    j = nearest[i]
    if len(i) < _MIN_COMMON:
        return np.nan
    normals = at_a[1][i] + at_b[1][j]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    error = (off[i, j] * normals).sum(axis=1)
    variance = _FLAT_M**2 + (a.sigma_m[i] ** 2 + b.sigma_m[j] ** 2) / _INDEPENDENT
    motion = np.hstack([normals, np.cross(at_a[0][i] - at_a[0][i].mean(axis=0), normals)])
    prior = np.diag(np.repeat([_POSE_M**-2, _POSE_RAD**-2], 3))
    weight = 1.0 / variance
    for _ in range(4):
        moved = np.linalg.solve(motion.T @ (weight[:, None] * motion) + prior, motion.T @ (weight * error))
        square = (error - motion @ moved) ** 2 / variance
        weight = 1.0 / variance / (1 + square / 4)
    return float(np.log1p(square / 4).mean() * min(len(i), _MOST_COMMON) + 0.5 * (moved @ prior @ moved))


def _least(grid: _Matrix, cost: _Matrix) -> tuple[float | None, float]:
    # The place of the minimum by a parabola, None at an end of the grid, and how far from it the cost is doubled.
    i = int(np.argmin(cost))
    if i in (0, len(grid) - 1):
        return None, 0.0
    before, least, after = cost[i - 1 : i + 2]
    bend = float(before - 2 * least + after)
    return float(grid[i] + 0.5 * (before - after) / max(bend, 1e-12) * _STEP_M), float(
        _STEP_M * np.sqrt(least / max(bend, 1e-12))
    )
