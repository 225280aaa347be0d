"""Estimate of the noise of a log's depth camera on flat surfaces.

It is the residual of a plane in inverse depth, on patches larger than the windows of stereo matching.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.depth_sensor import DepthSensor
from hickory_stream.records import Frame

_ACROSS, _LEAST_SIDE_PX, _SAMPLED_PX = 13, 8, 2
_FILLED = 0.85
_MIN_PATCHES, _BINS = 40, 6
_WORST_SHARE = 0.03
# Expected ratio of residual to noise after fitting three parameters to about twenty independent errors.
_LEFT = 0.92
_OTHER_RATIO, _SIGMAS = 2.0, 3.0
# Every third frame makes an estimate of its own; patches are chosen by their flatness, which biases it.
_PARTS, _LEAST_ERROR = 3, 0.05


@dataclass(frozen=True, kw_only=True, slots=True)
class DepthNoise:
    """sigma(z) = noise_m + noise_per_m z^2, as fitted to `num_patches` flat patches from `near_m` to `far_m` away."""

    noise_m: float
    noise_per_m: float
    num_patches: int
    near_m: float
    far_m: float
    #: Relative standard error of the noise.
    error: float = 0.0

    def sigma_m(self, depth_m: float) -> float:
        """Return the standard deviation at a depth."""
        return self.noise_m + self.noise_per_m * depth_m * depth_m

    def ratio_to(self, sensor: DepthSensor) -> float:
        """Return the ratio of this noise to that of a sensor model, in the middle of the observed range."""
        middle_m = float(np.sqrt(self.near_m * self.far_m))
        return self.sigma_m(middle_m) / float(sensor.sigma_m(np.array([middle_m], dtype=np.float32))[0])

    def is_other_than(self, sensor: DepthSensor) -> bool:
        """Whether the noise certainly differs from that of a sensor model by a factor of two or more, either way."""
        margin = _OTHER_RATIO * (1 + _SIGMAS * self.error)
        return not 1 / margin <= self.ratio_to(sensor) <= margin


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FlatPatches:
    """The patches of a frame on which a plane fits, N of them."""

    #: (N,) depth of the centre.
    depth_m: NDArray[np.float64]
    #: (N,) residual of the plane.
    sigma_m: NDArray[np.float64]
    points_world: NDArray[np.float64]
    normals_world: NDArray[np.float64]
    #: (N, 3) from the camera to the centre, per metre of depth.
    rays_world: NDArray[np.float64]
    #: (N,) depth of the plane at the centre.
    reach_m: NDArray[np.float64]
    #: (3,) the direction of view.
    forward_world: NDArray[np.float64]


def flat_patches(frame: Frame) -> FlatPatches:
    """Return the (nearly) flat patches of a frame."""
    camera = frame.camera
    side = max(camera.width // _ACROSS, _LEAST_SIDE_PX)
    rows, columns = camera.height // side, camera.width // side
    step = _SAMPLED_PX if side >= 2 * _LEAST_SIDE_PX else 1

    def cut(image: NDArray[np.float64]) -> NDArray[np.float64]:
        whole = image[: rows * side, : columns * side].reshape(rows, side, columns, side).transpose(0, 2, 1, 3)
        return np.ascontiguousarray(whole[:, :, ::step, ::step].reshape(rows * columns, -1))

    depth = cut(frame.depth_m.astype(np.float64))
    u, v = np.meshgrid(
        (np.arange(camera.width) - camera.cx) / camera.fx, (np.arange(camera.height) - camera.cy) / camera.fy
    )
    u, v = cut(u), cut(v)
    is_filled = np.isfinite(depth).mean(axis=1) >= _FILLED
    depth, u, v = depth[is_filled], u[is_filled], v[is_filled]
    inverse = 1.0 / depth
    planes = _planes(u, v, inverse, np.isfinite(inverse))
    off = inverse - _on(planes, u, v)
    # Fitted again without outliers such as the rim of a hole or a switch on the wall.
    close = np.abs(off) <= 4.0 * 1.4826 * np.nanmedian(np.abs(off), axis=1, keepdims=True) + 1e-9
    planes = _planes(u, v, inverse, close)
    off = np.where(close, inverse - _on(planes, u, v), np.nan)
    middle_m = np.nanmedian(depth, axis=1) if len(depth) else np.zeros(0)
    sigma_m = np.sqrt(np.nanmean(off * off, axis=1)) * middle_m**2 / _LEFT if len(depth) else np.zeros(0)
    is_flat = (close.mean(axis=1) >= _FILLED) & (sigma_m <= _WORST_SHARE * middle_m)
    planes, middle_u, middle_v = planes[is_flat], u[is_flat].mean(axis=1), v[is_flat].mean(axis=1)
    rotation, origin = frame.world_from_camera[:3, :3], frame.world_from_camera[:3, 3]
    rays_world = np.stack([middle_u, middle_v, np.ones(len(planes))], axis=1) @ rotation.T
    reach_m = 1.0 / _on(planes, middle_u[:, None], middle_v[:, None])
    normals = planes / np.linalg.norm(planes, axis=1, keepdims=True)
    return FlatPatches(
        depth_m=middle_m[is_flat],
        sigma_m=sigma_m[is_flat],
        points_world=origin + reach_m * rays_world,
        normals_world=normals @ rotation.T,
        rays_world=rays_world,
        reach_m=reach_m[:, 0],
        forward_world=rotation[:, 2],
    )


def depth_noise(frames: Sequence[FlatPatches]) -> DepthNoise | None:
    """Return the depth noise estimated from the flat patches of some frames; None if there are too few."""
    noise = _noise_of(frames)
    parts = [part for i in range(_PARTS) if (part := _noise_of(frames[i::_PARTS])) is not None]
    if noise is None or len(parts) < _PARTS:
        return None
    middle_m = float(np.sqrt(noise.near_m * noise.far_m))
    spread = float(np.std([part.sigma_m(middle_m) for part in parts], ddof=1)) / noise.sigma_m(middle_m)
    return replace(noise, error=round(float(np.hypot(spread / np.sqrt(_PARTS), _LEAST_ERROR)), 3))


def _noise_of(frames: Sequence[FlatPatches]) -> DepthNoise | None:
    depth_m = np.concatenate([patches.depth_m for patches in frames]) if frames else np.zeros(0)
    sigma_m = np.concatenate([patches.sigma_m for patches in frames]) if frames else np.zeros(0)
    if len(depth_m) < _MIN_PATCHES // _PARTS:
        return None
    bins = np.array_split(np.argsort(depth_m, kind="stable"), _BINS)
    z = np.array([np.median(depth_m[chosen]) for chosen in bins])
    # The flatter half of the patches: others may contain a crease or an object.
    sigma = np.array([np.quantile(sigma_m[chosen], 0.4) for chosen in bins])
    constant, quadratic = _law_of(z, sigma)
    return DepthNoise(
        noise_m=constant,
        noise_per_m=quadratic,
        num_patches=len(depth_m),
        near_m=float(np.quantile(depth_m, 0.05)),
        far_m=float(np.quantile(depth_m, 0.95)),
    )


def _law_of(z: NDArray[np.float64], sigma: NDArray[np.float64]) -> tuple[float, float]:
    # Non-negative (constant, quadratic) coefficients with the least relative error.
    # Rendered depth may have no noise at all.
    weight = 1.0 / np.maximum(sigma * sigma, 1e-12)
    z2 = z * z
    a, b, c = weight.sum(), (weight * z2).sum(), (weight * z2 * z2).sum()
    p, q = (weight * sigma).sum(), (weight * z2 * sigma).sum()
    determinant = a * c - b * b
    constant = (c * p - b * q) / determinant if determinant > 1e-9 * a * c else 0.0
    if constant <= 0:
        return 0.0, float(q / c)
    quadratic = (a * q - b * p) / determinant
    return (float(p / a), 0.0) if quadratic < 0 else (float(constant), float(quadratic))


def _planes(
    u: NDArray[np.float64], v: NDArray[np.float64], inverse: NDArray[np.float64], used: NDArray[np.bool_]
) -> NDArray[np.float64]:
    # (N, 3) least-squares planes of (N, P) pixels, NaN where they do not span one.
    w = used.astype(np.float64)
    n = np.maximum(w.sum(axis=1), 1.0)
    d = np.where(used, inverse, 0.0)
    mean_u, mean_v, mean_d = ((w * x).sum(axis=1) / n for x in (u, v, d))
    du, dv, dd = u - mean_u[:, None], v - mean_v[:, None], d - mean_d[:, None]
    uu, uv, vv = (w * du * du).sum(axis=1), (w * du * dv).sum(axis=1), (w * dv * dv).sum(axis=1)
    ud, vd = (w * du * dd).sum(axis=1), (w * dv * dd).sum(axis=1)
    determinant = uu * vv - uv * uv
    safe = np.where(determinant > 0, determinant, np.nan)
    a, b = (ud * vv - vd * uv) / safe, (vd * uu - ud * uv) / safe
    return np.stack([a, b, mean_d - a * mean_u - b * mean_v], axis=1)


def _on(planes: NDArray[np.float64], u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    # (N, P) inverse depths of planes at pixels.
    return planes[:, 0:1] * u + planes[:, 1:2] * v + planes[:, 2:3]
