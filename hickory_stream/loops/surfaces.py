"""Registration of two submaps by their surfaces, and what speaks for and against the result.

Generalised ICP (Segal, Haehnel and Thrun, RSS 2009) of the library small_gicp, on one thread, with gates that narrow.
It answers always; what there is to believe it is measured here: how much surface has met, and how much of it lies where
the other submap saw free space.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import cKDTree

from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import apply, compose, invert
from hickory_stream.geometry.voxels import contains, keys_of_points
from hickory_stream.poses.degeneracy import degenerate_directions, surfels_of, without_degenerate

if TYPE_CHECKING:
    from numpy.typing import NDArray

_NEIGHBORS = 12
_ITERATIONS = 30
_GATES_M = (0.3, 0.15)
_CORRELATED = 50.0
"""So many neighbouring points err alike: the share of the Hessian that counts as independent evidence."""

_FLOOR_RAD, _FLOOR_M = 0.002, 0.01
"""What two surfaces of one room differ by, however many points they have: noise of depth that does not average out."""

_UNKNOWN_VARIANCE = 100.0
"""That of a direction along which the surfaces say nothing, in m^2 and rad^2."""

_MET_M = 0.1
"""Surfaces that are nearer than this to each other have met."""

_FREE_M = 0.25
"""A point in free space counts against a fit only so far from all surface: at its rim both are seen."""

_TESTED_EVERY, _TESTED_NEIGHBORS = 8, 25
_STRONG_COSINE, _LEAST_STRONG = 0.7, 40.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """A submap's surface: `points` (N, 3) and the sorted keys of its `free` voxels, in its frame.

    `anchor` (4, 4) is the camera's first pose in it, the node of the pose graph. The trees are made when first asked.
    """

    points: NDArray[np.float64]
    free: NDArray[np.int64]
    voxel_m: float
    anchor: NDArray[np.float64]

    @cached_property
    def places(self) -> cKDTree:
        """The points, to be looked up."""
        return cKDTree(self.points)

    @cached_property
    def target(self) -> tuple[Any, Any]:
        """The points with the distributions of their neighbours, and their tree, as small_gicp wants them."""
        return _prepared(self.points)

    @cached_property
    def source(self) -> Any:
        """The same in the frame of the anchor, about which a registration turns them."""
        return _prepared(apply(invert(self.anchor), self.points))[0]

    @cached_property
    def degenerate(self) -> NDArray[np.float64]:
        """The directions (K, 6) along which the surface says nothing, rotation first, in the frame of the anchor."""
        import small_gicp

        points = np.ascontiguousarray(apply(invert(self.anchor), self.points))
        tree = small_gicp.KdTree(small_gicp.PointCloud(points))
        neighbors, _ = tree.batch_knn_search(points[::_TESTED_EVERY], _TESTED_NEIGHBORS, 1)
        surfels = surfels_of(points, neighbors, _TESTED_EVERY)
        return degenerate_directions(surfels, strong_cosine=_STRONG_COSINE, least_strong=_LEAST_STRONG)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SurfaceFit:
    """How a later submap lies in an earlier one by their surfaces, and how well.

    `earlier_from_later` (4, 4) is between their frames; `covariance` (6, 6) that of a small turn, then shift, in the
    frame of the later one's anchor. Of the `num_known` points of either of which the other one knows what is there,
    `num_met` have met a surface; the others lie in its free space.
    """

    earlier_from_later: NDArray[np.float64]
    covariance: NDArray[np.float64]
    num_met: int
    num_known: int

    @property
    def agreement(self) -> float:
        """The share of known points that have met."""
        return self.num_met / self.num_known if self.num_known else 0.0


def registered(earlier: Surface, later: Surface, predicted: NDArray[np.float64], reach_m: float) -> SurfaceFit:
    """Return how a later surface lies in an earlier one.

    Args:
        earlier: the surface that stays, with at least as many points as a distribution needs neighbours.
        later: the surface that is moved.
        predicted: (4, 4) earlier_from_later, where to start.
        reach_m: points up to this far apart are paired at first.
    """
    import small_gicp

    start = pose = compose(predicted, later.anchor)
    cloud, tree = earlier.target
    found: Any = None
    for gate_m in (*((reach_m,) if reach_m > _GATES_M[0] else ()), *_GATES_M):
        found = small_gicp.align(
            cloud,
            later.source,
            tree,
            init_T_target_source=pose,
            max_correspondence_distance=gate_m,
            num_threads=1,
            max_iterations=_ITERATIONS,
        )
        pose = found.T_target_source
    degenerate = later.degenerate
    pose = without_degenerate(_rigid(pose), start, degenerate)
    earlier_from_later = compose(pose, invert(later.anchor))
    return SurfaceFit(
        earlier_from_later=earlier_from_later,
        covariance=_covariance(found, degenerate),
        **_evidence(earlier, later, earlier_from_later),
    )


def _prepared(points: NDArray[np.float64]) -> tuple[Any, Any]:
    import small_gicp

    cloud = small_gicp.PointCloud(np.ascontiguousarray(points))
    tree = small_gicp.KdTree(cloud)
    small_gicp.estimate_normals_covariances(cloud, tree, _NEIGHBORS, 1)
    return cloud, tree


def _rigid(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a transform with an exact rotation."""
    return np.vstack(
        [np.column_stack([portable.nearest_orthogonal(matrix[None, :3, :3])[0], matrix[:3, 3]]), [0, 0, 0, 1]]
    )


def _evidence(earlier: Surface, later: Surface, earlier_from_later: NDArray[np.float64]) -> dict[str, int]:
    """Return how many points of either surface met the other one, and of how many it knows what is there."""
    there = apply(earlier_from_later, later.points)
    back = apply(invert(earlier_from_later), earlier.points)
    counts = [_met_and_against(earlier, there), _met_and_against(later, back)]
    met, against = (sum(count[i] for count in counts) for i in range(2))
    return {"num_met": met, "num_known": met + against}


def _met_and_against(surface: Surface, points: NDArray[np.float64]) -> tuple[int, int]:
    """Return how many points lie on a surface, and how many in its free space, away from all surface."""
    distance, _ = surface.places.query(points, distance_upper_bound=_FREE_M)
    is_free = contains(surface.free, keys_of_points(points, surface.voxel_m)) & ~np.isfinite(distance)
    return int((distance < _MET_M).sum()), int(is_free.sum())


def _covariance(found: Any, degenerate: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the covariance (6, 6) of a result: its Hessian in units of its residuals, wide where it is degenerate."""
    variance = max(2.0 * found.error / max(3 * found.num_inliers - 6, 1), 1e-12)
    information = np.asarray(found.H, dtype=np.float64) / (variance * _CORRELATED)
    values, vectors = portable.eigh(0.5 * (information + information.T))
    variances = 1.0 / np.maximum(values, 1.0 / _UNKNOWN_VARIANCE)
    covariance = portable.matmul(vectors * variances, vectors.T)
    covariance += np.diag([_FLOOR_RAD**2] * 3 + [_FLOOR_M**2] * 3)
    for direction in degenerate:
        covariance += _UNKNOWN_VARIANCE * np.outer(direction, direction)
    return np.asarray(covariance)
