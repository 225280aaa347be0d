"""Registration of two submaps by their surfaces, and the evidence for and against the result.

Iterated closest points, point to plane (Chen and Medioni 1992), with narrowing gates and a robust loss. Points pair
only if their normals, which look at the camera, agree (Pulli 1999): the two sides of a wall never pair. Evidence is how
much surface met, and how much lies in the free space of the other submap.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from hickory_stream.geometry import portable
from hickory_stream.geometry.portable_kernels import solve_in_place
from hickory_stream.geometry.rigid import apply, compose, from_rotation_translation, invert, rotation_of_vector
from hickory_stream.geometry.voxels import contains, keys_of_points
from hickory_stream.poses.degeneracy import Surfels, degenerate_directions, without_degenerate
from hickory_stream.records import SurveyedSubmap

# Metres of distance for a radian between normals: opposite sides are further apart than any gate.
_NORMAL_M = 0.4
_COARSE_GATES_M, _FINE_GATES_M = (0.3, 0.3, 0.2, 0.2, 0.15, 0.15), (0.12, 0.12, 0.12, 0.12)
_WIDE_ROUNDS = 4
# About so many points of the later surface, spread evenly, are paired while the gates are coarse.
_COARSE_POINTS = 1500
# So many neighbouring points err alike: the share of the Hessian that counts as independent evidence.
_CORRELATED = 30.0
# The least difference of two surfaces of one room, however many points they have: no submap is quite rigid.
_FLOOR = np.diag([0.004**2] * 3 + [0.02**2] * 3)
# Variance along directions that the surfaces leave open, in m^2 and rad^2.
_UNKNOWN_VARIANCE = 100.0
# Surfaces nearer than this to each other, across, have met.
_MET_M = 0.06
# The normal of an upright surface has a smaller part along the vertical.
_UPRIGHT = 0.7
# The reach, of place and normal together, of a search for the same side of a surface.
_SIDE_M = 0.25
# A point in free space counts against a fit only so far from all surface: at its rim both are seen.
_FREE_M = 0.12
_STRONG_COSINE, _LEAST_STRONG = 0.7, 40.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """A submap's surface in its frame: `points`, unit `normals` (N, 3), and the sorted keys of `free` voxels."""

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    free: NDArray[np.int64]
    voxel_m: float
    #: (4, 4) first camera pose in it, the node of the pose graph
    anchor: NDArray[np.float64]

    @cached_property
    def sides(self) -> "scipy.spatial.cKDTree":
        """The points with their normals, for a joint search; made on first use."""
        return scipy.spatial.cKDTree(_with_normals(self.points, self.normals))

    @cached_property
    def places(self) -> "scipy.spatial.cKDTree":
        """The points alone."""
        return scipy.spatial.cKDTree(self.points)


class Surfaces(dict[int, Surface]):
    """The surfaces of submaps by their ids, each made on first use: few are candidates of a search."""

    def __init__(self, submaps: Iterable[SurveyedSubmap]) -> None:
        super().__init__()
        self._submaps = {submap.id: submap for submap in submaps}

    def __missing__(self, submap_id: int) -> Surface:
        submap = self._submaps[submap_id]
        self[submap_id] = Surface(
            points=submap.points.astype(np.float64),
            normals=submap.normals.astype(np.float64),
            free=submap.free,
            voxel_m=submap.voxel_m,
            anchor=submap.anchor,
        )
        return self[submap_id]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SurfaceFit:
    """The place of a later submap in an earlier one by their surfaces.

    Only upright surface counts: floors and tops of things meet everywhere.
    """

    earlier_from_later: NDArray[np.float64]
    #: (6, 6) of a small turn, then shift, in the frame of the later one's anchor
    covariance: NDArray[np.float64]
    #: points of either that met a surface of the other
    num_met: int
    #: these and the points in the other's free space
    num_known: int

    @property
    def agreement(self) -> float:
        """The share of known points that have met."""
        return self.num_met / self.num_known if self.num_known else 0.0

    @property
    def support(self) -> int:
        """Points for it minus points against it."""
        return 2 * self.num_met - self.num_known


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Paired:
    # Points of the later surface in the frame of its anchor, the mean normals of pairs, and residuals.
    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    residuals_m: NDArray[np.float64]
    weights: NDArray[np.float64]


def approached(earlier: Surface, later: Surface, predicted: NDArray[np.float64], reach_m: float) -> NDArray[np.float64]:
    """Return the approximate result of `registered`, earlier_from_later: by the coarse gates and a few points."""
    points, normals = _from_anchor(later)
    stride = max(len(points) // _COARSE_POINTS, 1)
    wide = [reach_m] * _WIDE_ROUNDS if reach_m > _COARSE_GATES_M[0] else []
    start = compose(predicted, later.anchor)
    pose, _ = _narrowed(earlier, points[::stride], normals[::stride], start, (*wide, *_COARSE_GATES_M))
    return compose(pose, invert(later.anchor))


def registered(earlier: Surface, later: Surface, predicted: NDArray[np.float64], reach_m: float) -> SurfaceFit:
    """Return the fit of a later surface from `predicted` (4, 4) earlier_from_later; at first up to `reach_m` apart."""
    return refined(earlier, later, predicted, approached(earlier, later, predicted, reach_m))


def refined(earlier: Surface, later: Surface, predicted: NDArray[np.float64], near: NDArray[np.float64]) -> SurfaceFit:
    """Return the registration that continues from `near`, the result of `approached` from `predicted`."""
    points, normals = _from_anchor(later)
    pose, paired = _narrowed(earlier, points, normals, compose(near, later.anchor), _FINE_GATES_M)
    surfels = Surfels(points=paired.points, normals=paired.normals, weight=1.0)
    degenerate = degenerate_directions(surfels, strong_cosine=_STRONG_COSINE, least_strong=_LEAST_STRONG)
    start = compose(predicted, later.anchor)
    found = compose(without_degenerate(pose, start, degenerate), invert(later.anchor))
    counts = (_met_and_against(earlier, later, found), _met_and_against(later, earlier, invert(found)))
    met, against = (sum(count[i] for count in counts) for i in range(2))
    covariance = _covariance(paired, degenerate)
    return SurfaceFit(earlier_from_later=found, covariance=covariance, num_met=met, num_known=met + against)


def with_known_start(fit: SurfaceFit, covariance: NDArray[np.float64]) -> SurfaceFit:
    """Return a fit whose start had a `covariance` (6, 6) like the fit's: it counts where the surfaces say nothing."""
    joined = np.linalg.inv(np.linalg.inv(fit.covariance) + np.linalg.inv(covariance))
    return replace(fit, covariance=0.5 * (joined + joined.T) + _FLOOR)


def _from_anchor(later: Surface) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    node_from_later = invert(later.anchor)
    return apply(node_from_later, later.points), portable.matmul(later.normals, node_from_later[:3, :3].T)


def _narrowed(
    earlier: Surface,
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    pose: NDArray[np.float64],
    gates_m: Iterable[float],
) -> tuple[NDArray[np.float64], _Paired]:
    # The pose after a step with each gate, and the last pairs; it stops early if they are too few.
    for gate_m in gates_m:
        paired = _pairs(earlier, points, normals, pose, gate_m)
        step = _step(paired)
        if step is None:
            break
        pose = compose(pose, from_rotation_translation(rotation_of_vector(step[:3]), step[3:]))
    return pose, paired


def _with_normals(points: NDArray[np.float64], normals: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.concatenate([points, _NORMAL_M * normals], axis=1)


def _pairs(
    earlier: Surface,
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    pose: NDArray[np.float64],
    gate_m: float,
) -> _Paired:
    turn = pose[:3, :3]
    there, facing = apply(pose, points), portable.matmul(normals, turn.T)
    distance, at = earlier.sides.query(_with_normals(there, facing), distance_upper_bound=gate_m)
    is_paired = np.isfinite(distance)
    theirs = at[is_paired]
    # The plane between the two: symmetric ICP (Rusinkiewicz 2019).
    across = facing[is_paired] + earlier.normals[theirs]
    across /= np.sqrt((across * across).sum(axis=1))[:, None]
    residuals = (across * (earlier.points[theirs] - there[is_paired])).sum(axis=1)
    ratio = residuals / (gate_m / 3.0)
    weights, mean_normals = 1.0 / (1.0 + ratio * ratio), portable.matmul(across, turn)
    return _Paired(points=points[is_paired], normals=mean_normals, residuals_m=residuals, weights=weights)


def _normal_equations(paired: _Paired) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # Hessian (6, 6) and right side (6,) of a small turn, then shift, in the frame of the anchor.
    lever = np.cross(paired.points, paired.normals)
    rows = np.concatenate([lever, paired.normals], axis=1)
    weighted = rows * paired.weights[:, None]
    return portable.matmul(rows.T, weighted), (weighted * paired.residuals_m[:, None]).sum(axis=0)


def _step(paired: _Paired) -> NDArray[np.float64] | None:
    if len(paired.points) < _LEAST_STRONG:
        return None
    hessian, right = _normal_equations(paired)
    # Directions without evidence stay.
    hessian = np.ascontiguousarray(hessian + 1e-3 * np.eye(6))
    solve_in_place(hessian, right)
    return right


def _met_and_against(surface: Surface, other: Surface, here_from_other: NDArray[np.float64]) -> tuple[int, int]:
    # Numbers of upright points of `other` on a surface, and in its free space, off all surface.
    is_upright = np.abs(other.normals[:, 2]) < _UPRIGHT
    points = apply(here_from_other, other.points[is_upright])
    facing = portable.matmul(other.normals[is_upright], here_from_other[:3, :3].T)
    distance, at = surface.sides.query(_with_normals(points, facing), distance_upper_bound=_SIDE_M)
    is_near = np.isfinite(distance)
    off = (surface.normals[at[is_near]] * (surface.points[at[is_near]] - points[is_near])).sum(axis=1)
    away, _ = surface.places.query(points, distance_upper_bound=_FREE_M)
    is_free = contains(surface.free, keys_of_points(points, surface.voxel_m)) & ~np.isfinite(away)
    return int((np.abs(off) < _MET_M).sum()), int(is_free.sum())


def _covariance(paired: _Paired, degenerate: NDArray[np.float64]) -> NDArray[np.float64]:
    # (6, 6) the Hessian in units of its residuals, wide along degenerate directions.
    hessian, _ = _normal_equations(paired)
    total = float(paired.weights.sum())
    variance = max(float((paired.weights * paired.residuals_m**2).sum()) / max(total, 1.0), 1e-8)
    values, vectors = portable.eigh(hessian / (variance * _CORRELATED))
    variances = 1.0 / np.maximum(values, 1.0 / _UNKNOWN_VARIANCE)
    covariance = portable.matmul(vectors * variances, vectors.T)
    covariance += _FLOOR
    for direction in degenerate:
        covariance += _UNKNOWN_VARIANCE * np.outer(direction, direction)
    return np.asarray(covariance)
