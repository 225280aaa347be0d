"""Alignment of a keyframe's surface with patches of surface from earlier keyframes, under a prior of its pose.

Projective association (Blais and Levine 1995; Newcombe et al., KinectFusion, 2011); distances along the mean of both
normals (symmetric point-to-plane: Rusinkiewicz 2019); Geman and McClure's kernel with a narrowing scale against moving
things; Gauss-Newton steps. A Gaussian prior keeps the expected pose along what the surface does not determine.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.portable_kernels import solve_in_place
from hickory_stream.geometry.rigid import (
    compose,
    from_rotation_translation,
    invert,
    rotation_of_vector,
    rotation_vector,
)
from hickory_stream.poses.surface_image import SurfaceImage

_NEAREST_M = 0.2
# A point this much nearer than the keyframe's surface is seen through.
_THROUGH_M = 0.1
_NUM_PROBES = 40
# The least cosine to the vertical of a level surface's normal.
_LEVEL = 0.9

# Added to the noise of each point: surfaces are no smoother than this.
_SURFACE_NOISE_M = 0.005
# The points of a keyframe count as at most this many independent measurements: neighbours err alike.
_NUM_INDEPENDENT = 200.0
# The scale of the robust kernel in the first and in the last step, and the number of steps.
_FIRST_SCALE_M = 0.06
_LAST_SCALE_M = 0.015
_NUM_ITERATIONS = 6
# Surfaces whose normals have a smaller cosine are not the same.
_MIN_COSINE = 0.85


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Patch:
    """Surface elements of a keyframe: `points`, `normals` (N, 3) in its camera, `sigma_m` (N,), and its pose."""

    map_from_camera: NDArray[np.float64]
    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    sigma_m: NDArray[np.float64]
    #: (K, 3) a few of the points, to test which cameras see the patch
    probes: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PosePrior:
    """The expected pose and its certainty."""

    map_from_camera: NDArray[np.float64]
    #: (6, 6) of a rotation vector about the camera, then a translation, along the map's axes
    information: NDArray[np.float64]
    #: (2,) turn about the map's x and y against the odometry's vertical, rad
    tilt: NDArray[np.float64]
    tilt_information: float


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Aligned:
    """The most likely pose."""

    map_from_camera: NDArray[np.float64]
    #: (6,) its difference to the expected one
    off: NDArray[np.float64]
    #: (6, 6) of the surface alone
    information: NDArray[np.float64]
    #: points of patches on the keyframe's surface
    num_on: int
    #: points of patches that are seen through
    num_through: int
    #: the same of surfaces that are not level
    num_upright_on: int
    num_upright_through: int

    def fit(self, least_points: int) -> float | None:
        """Return the share of points on the surface; None if fewer than `least_points` can be compared."""
        # Upright surfaces alone must have as large a share: a robot is on a floor everywhere.
        pairs = ((self.num_on, self.num_through), (self.num_upright_on, self.num_upright_through))
        shares = [on / (on + through) for on, through in pairs if on + through >= least_points]
        return min(shares) if self.num_on + self.num_through >= least_points else None


def patch_of(image: SurfaceImage, map_from_camera: NDArray[np.float64], *, odd: bool) -> Patch:
    """Return a quarter of the surface elements of a keyframe: every second row and column, `odd` ones or even."""
    first = int(odd)
    has = ~np.isnan(image.sigma_m[first::2, first::2])
    points = image.points[first::2, first::2][has]
    return Patch(
        map_from_camera=map_from_camera,
        points=points,
        normals=image.normals[first::2, first::2][has],
        sigma_m=image.sigma_m[first::2, first::2][has],
        probes=points[:: max(1, len(points) // _NUM_PROBES)],
    )


def share_seen(patch: Patch, camera_from_map: NDArray[np.float64], camera: Camera) -> float:
    """Return the share of a patch in the field of view of a camera, hidden or not."""
    if not len(patch.probes):
        return 0.0
    lens = camera.fx, camera.fy, camera.cx, camera.cy
    camera_from_patch = compose(camera_from_map, patch.map_from_camera)
    return float(_num_in_view(patch.probes, camera_from_patch, lens, camera.width, camera.height)) / len(patch.probes)


def align(image: SurfaceImage, patches: Sequence[Patch], prior: PosePrior) -> Aligned:
    """Return the most likely pose of a keyframe from its surface, the patches and the prior."""
    lens = image.camera.fx, image.camera.fy, image.camera.cx, image.camera.cy
    pose, off = prior.map_from_camera, np.zeros(6)
    counts, information = np.zeros(4, dtype=np.int64), np.zeros((6, 6))
    for step in range(_NUM_ITERATIONS):
        hessian, slope = np.zeros((6, 6)), np.zeros(6)
        counts[:] = 0
        camera_from_map, up = invert(pose), pose[2, :3].copy()
        # The scale is halved with every step until the last one.
        scale_m = float(max(_FIRST_SCALE_M / (1 << min(step, 30)), _LAST_SCALE_M))
        limits = (scale_m, _MIN_COSINE, _SURFACE_NOISE_M * _SURFACE_NOISE_M)
        for patch in patches:
            own = (patch.points, patch.normals, patch.sigma_m, compose(camera_from_map, patch.map_from_camera))
            seen = (image.points, image.normals, image.sigma_m, lens)
            _accumulate(*own, *seen, up, limits, hessian, slope, counts)
        # Neighbouring points err alike, and each point of the keyframe was compared with several patches.
        share = min(1.0, _NUM_INDEPENDENT / max(int(counts[0]), 1))
        turned = np.zeros((6, 6))
        turned[:3, :3] = turned[3:, 3:] = pose[:3, :3]
        whole = np.asarray(hessian + np.triu(hessian, 1).T)
        information = share * portable.matmul(portable.matmul(turned, whole), turned.T)
        slope = share * portable.matmul(turned, slope)
        total = information + prior.information
        slope = slope + portable.matmul(prior.information, off)
        for axis in (0, 1):
            total[axis, axis] += prior.tilt_information
            slope[axis] += prior.tilt_information * (prior.tilt[axis] + off[axis])
        pose = moved_by(pose, solved(total, -slope))
        turn = portable.matmul(pose[:3, :3], prior.map_from_camera[:3, :3].T)
        off = np.concatenate([rotation_vector(turn), pose[:3, 3] - prior.map_from_camera[:3, 3]])
    names = ("num_on", "num_through", "num_upright_on", "num_upright_through")
    numbers = dict(zip(names, counts.tolist(), strict=True))
    return Aligned(map_from_camera=pose, off=off, information=information, **numbers)


def solved(matrix: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return x of matrix x = right (n,)."""
    out = np.array(right, dtype=np.float64)
    solve_in_place(np.array(matrix, dtype=np.float64), out)
    return out


def inverse(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverse of a positive definite matrix (n, n), symmetric."""
    out = np.stack([solved(matrix, column) for column in np.eye(len(matrix))])
    return np.asarray(0.5 * (out + out.T))


def moved_by(pose: NDArray[np.float64], step: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a pose (4, 4) turned by a rotation vector about itself, then shifted: both (6,) along the map's axes."""
    rotation = portable.matmul(rotation_of_vector(step[:3]), pose[:3, :3])
    return from_rotation_translation(rotation, pose[:3, 3] + step[3:])


@kernel(error_model="numpy")
def _num_in_view(points, camera_from_patch, lens, width, height):
    fx, fy, cx, cy = lens
    m = camera_from_patch
    count = 0
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        pz = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        if pz < _NEAREST_M:
            continue
        u = fx * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / pz + cx
        v = fy * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / pz + cy
        count += (u > -0.5) & (v > -0.5) & (u < width - 0.5) & (v < height - 0.5)
    return count


@kernel(error_model="numpy")
def _accumulate(points, normals, sigma, m, at, facing, at_sigma, lens, up, limits, hessian, slope, counts):
    # Adds one patch to the upper half of `hessian` (6, 6), to `slope` (6,), and to the four `counts`. `m` is
    # camera_from_patch, `up` (3,) the map's vertical in the camera; `limits`: scale, least cosine, variance of
    # surfaces.
    height, width = at_sigma.shape
    fx, fy, cx, cy = lens
    scale_m, least_cosine, noise2 = limits
    row = np.empty(6)
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        pz = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        if pz < _NEAREST_M:
            continue
        px = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
        py = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
        u = np.int64(np.floor(fx * px / pz + cx + 0.5))
        v = np.int64(np.floor(fy * py / pz + cy + 0.5))
        if u < 0 or v < 0 or u >= width or v >= height or np.isnan(at_sigma[v, u]):
            continue
        x, y, z = normals[i, 0], normals[i, 1], normals[i, 2]
        nx = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z
        ny = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z
        nz = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z
        if nx * px + ny * py + nz * pz >= 0.0:
            continue  # its back
        is_upright = abs(nx * up[0] + ny * up[1] + nz * up[2]) < _LEVEL
        qx, qy, qz = at[v, u, 0], at[v, u, 1], at[v, u, 2]
        fnx, fny, fnz = facing[v, u, 0], facing[v, u, 1], facing[v, u, 2]
        variance = sigma[i] * sigma[i] + at_sigma[v, u] * at_sigma[v, u] + noise2
        reach_m = 3.0 * np.sqrt(variance)
        cosine = nx * fnx + ny * fny + nz * fnz
        nx, ny, nz = nx + fnx, ny + fny, nz + fnz
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        off = (nx * (qx - px) + ny * (qy - py) + nz * (qz - pz)) / length
        if cosine < least_cosine or abs(off) > 2.5 * scale_m + reach_m:
            if qz - pz > _THROUGH_M + reach_m:
                counts[1] += 1
                counts[3] += is_upright
            continue
        counts[0] += 1
        counts[2] += is_upright
        nx, ny, nz = nx / length, ny / length, nz / length
        width2 = scale_m * scale_m + 4.0 * variance
        weight = width2 / (width2 + off * off)
        weight = weight * weight / variance
        row[0], row[1], row[2] = qy * nz - qz * ny, qz * nx - qx * nz, qx * ny - qy * nx
        row[3], row[4], row[5] = nx, ny, nz
        for j in range(6):
            slope[j] += weight * off * row[j]
            for k in range(j, 6):
                hessian[j, k] += weight * row[j] * row[k]
