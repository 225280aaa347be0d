"""Estimates of a log's depth camera: noise on flat surfaces, and a constant bias.

Noise: the residual of a plane in inverse depth, on patches larger than the windows of stereo matching.
Bias: a constant added to depth lowers the floor at near points by more than at far ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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
_LEVEL, _LEAST_FALL, _FALL_RATIO, _SAME_FLOOR_M, _MIN_COPLANAR = 0.95, 0.1, 1.5, 0.12, 6
_MIN_FRAMES = 3
# A smaller bias cannot be distinguished from the effect of lens distortion and drift on a floor.
_OFF_M, _OFF_SIGMAS = 0.02, 3.0
_OTHER_RATIO = 2.0


@dataclass(frozen=True, kw_only=True, slots=True)
class DepthNoise:
    """sigma(z) = noise_m + noise_per_m z^2, as fitted to `num_patches` flat patches from `near_m` to `far_m` away."""

    noise_m: float
    noise_per_m: float
    num_patches: int
    near_m: float
    far_m: float

    def sigma_m(self, depth_m: float) -> float:
        """Return the standard deviation at a depth."""
        return self.noise_m + self.noise_per_m * depth_m * depth_m

    def ratio_to(self, sensor: DepthSensor) -> float:
        """Return the ratio of this noise to that of a sensor model, in the middle of the observed range."""
        middle_m = float(np.sqrt(self.near_m * self.far_m))
        return self.sigma_m(middle_m) / float(sensor.sigma_m(np.array([middle_m], dtype=np.float32))[0])

    def is_other_than(self, sensor: DepthSensor) -> bool:
        """Whether the noise differs from that of a sensor model by a factor of two or more, in either direction."""
        return not 1 / _OTHER_RATIO <= self.ratio_to(sensor) <= _OTHER_RATIO


@dataclass(frozen=True, kw_only=True, slots=True)
class DepthBias:
    """The constant by which depth is too large, its standard error, and the number of frames that showed a floor."""

    bias_m: float
    error_m: float
    num_frames: int

    @property
    def is_off(self) -> bool:
        """Whether the depth error exceeds the uncertainty of its estimate from the floors."""
        return abs(self.bias_m) >= _OFF_M and abs(self.bias_m) >= _OFF_SIGMAS * self.error_m


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
    )


def depth_noise(frames: Sequence[FlatPatches]) -> DepthNoise | None:
    """Return the depth noise estimated from the flat patches of some frames; None if there are too few."""
    depth_m = np.concatenate([patches.depth_m for patches in frames]) if frames else np.zeros(0)
    sigma_m = np.concatenate([patches.sigma_m for patches in frames]) if frames else np.zeros(0)
    if len(depth_m) < _MIN_PATCHES:
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


def depth_bias(frames: Sequence[FlatPatches]) -> DepthBias | None:
    """Return the constant bias of depth; None if too few frames show a floor over a sufficient range of depths.

    A bias b puts a ray's end below the floor by b times its descent per metre of depth: least squares over all patches.
    A tilt of the floor (gravity) and a height per frame (poses) are estimated too.
    """
    floors = [floor for patches in frames if (floor := _floor_of(patches)) is not None]
    if len(floors) < _MIN_FRAMES:
        return None
    points, falls = np.concatenate([f[0] for f in floors]), np.concatenate([f[1] for f in floors])
    frame = np.repeat(np.arange(len(floors)), [len(f[1]) for f in floors])

    def beside_mean(values: NDArray[np.float64], weight: NDArray[np.float64]) -> NDArray[np.float64]:
        means = np.bincount(frame, values * weight) / np.maximum(np.bincount(frame, weight), 1e-9)
        return np.asarray(values - means[frame])

    weight = np.ones(len(falls))
    for _ in range(4):
        known = [beside_mean(values, weight) for values in (falls, points[:, 0], points[:, 1])]
        height = beside_mean(points[:, 2], weight)
        normal = np.array([[float((weight * a * b).sum()) for b in known] for a in known])
        right = np.array([float((weight * a * height).sum()) for a in known])
        if np.linalg.matrix_rank(normal) < len(known):
            return None
        found = np.linalg.solve(normal, right)
        off = height - sum(value * column for value, column in zip(found, known, strict=True))
        scale = 1.4826 * float(np.median(np.abs(off))) + 1e-6
        weight = (np.abs(off) < 3 * scale).astype(np.float64)
    freedom = max(float(weight.sum()) - len(floors) - 3, 1.0)
    variance = float((weight * off * off).sum()) / freedom * float(np.linalg.inv(normal)[0, 0])
    return DepthBias(bias_m=float(found[0]), error_m=float(np.sqrt(variance)), num_frames=len(floors))


def _floor_of(patches: FlatPatches) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    # (N, 3) centres of patches on the floor, and the descent of their rays per metre of depth.
    if len(patches.depth_m) < _MIN_COPLANAR:
        return None
    points, falls = patches.points_world, patches.rays_world[:, 2]
    is_level = (np.abs(patches.normals_world[:, 2]) > _LEVEL) & (falls < -_LEAST_FALL)
    if is_level.sum() < _MIN_COPLANAR:
        return None
    heights = points[is_level, 2]
    near = np.abs(heights[:, None] - heights[None]) < _SAME_FLOOR_M
    floor = float(np.median(heights[near[int(np.argmax(near.sum(axis=1)))]]))
    chosen = is_level & (np.abs(points[:, 2] - floor) < _SAME_FLOOR_M)
    enough = chosen.sum() >= _MIN_COPLANAR and falls[chosen].min() < _FALL_RATIO * falls[chosen].max()
    return (points[chosen], falls[chosen]) if enough else None


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
