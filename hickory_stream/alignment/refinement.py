"""Refinement of an alignment: the surfaces of matched objects are registered (point to plane).

Only partners' points are paired, with a robust loss, since each map saw other sides of an object. Centroids remain as
priors. The result is kept only if a larger share of the surfaces coincides than before.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from hickory_stream.alignment.contradiction import thinned
from hickory_stream.alignment.object_map import ObjectMap
from hickory_stream.alignment.registration import moved_about
from hickory_stream.base.ranges import Ranged, number
from hickory_stream.geometry.rigid import apply, invert

_MAX_POINTS = 400


@dataclass(frozen=True, kw_only=True, slots=True)
class RefinementConfig(Ranged):
    """How surfaces are registered.

    Attributes:
        rounds: maximum number of rounds, in each of which points are paired anew.
        first_m, last_m: distance at which a residual has half weight, in the first and in the last round.
        surface_m: standard deviation of a surface estimated from many points: the error that does not average out.
        min_points: objects with fewer points are not used.
        neighbors: number of points from which a normal is estimated.
        common_m, common_up_m: standard deviation, level and vertical, of what all objects of a map err in common: it
            saw them from one height, and along one way.
        alike_m: over about this distance objects are displaced alike where a map drifts.
    """

    rounds: int = number(12, 0, 1000, "rounds")
    first_m: float = number(0.08, 0.0001, 10, "m")
    last_m: float = number(0.015, 0.0001, 10, "m")
    surface_m: float = number(0.01, 0, 1, "m")
    min_points: int = number(30, 3, 1_000_000, "points")
    neighbors: int = number(12, 3, 1000, "points")
    common_m: float = number(0.004, 0.00001, 1, "m")
    common_up_m: float = number(0.008, 0.00001, 1, "m")
    alike_m: float = number(2.0, 0.001, 1000, "m")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Refined:
    """A refined transform and its covariance (6, 6) about the pairs' centroid in a."""

    a_from_b: NDArray[np.float64]
    covariance: NDArray[np.float64]


def refined(
    map_a: ObjectMap,
    map_b: ObjectMap,
    pairs: NDArray[np.int64],
    start: NDArray[np.float64],
    *,
    mean: NDArray[np.float64],
    prior: NDArray[np.float64],
    config: RefinementConfig,
) -> Refined | None:
    """Return the refined transform; None if there are too few points, or fewer of them coincide afterwards.

    The search begins at `start` (4, 4); `mean` (4, 4) is the best by centroids alone, `prior` (6, 6) its information.
    """
    surfaces = _surfaces(map_a, map_b, pairs, config)
    if not surfaces:
        return None
    center_a = map_a.centroids[pairs[:, 0]].mean(axis=0)
    current = start
    met_before = _met(surfaces, start, config)
    for scale_m in np.geomspace(config.first_m, config.last_m, config.rounds):
        own, gains = _normal_equations(surfaces, current, center_a, float(scale_m), config)
        gain = gains.sum(axis=0) - prior @ _twist(current, mean, center_a)
        current = moved_about(current, np.asarray(np.linalg.solve(prior + own, gain), dtype=np.float64), center_a)
    if _met(surfaces, current, config) <= met_before:
        return None
    own, gains = _normal_equations(surfaces, current, center_a, config.last_m, config)
    covariance = _covariance(prior + own, gains, np.array([s.center for s in surfaces]), config.alike_m)
    return Refined(a_from_b=current, covariance=covariance)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Surface:
    # Points (P, 3) with normals in a, (Q, 3) with normals in b, and trees of both.
    points_a: NDArray[np.float64]
    normals_a: NDArray[np.float64]
    points_b: NDArray[np.float64]
    normals_b: NDArray[np.float64]
    tree_a: cKDTree
    tree_b: cKDTree

    @property
    def center(self) -> NDArray[np.float64]:
        """The middle (3,) of the object, in a."""
        return np.asarray(self.points_a.mean(axis=0))

    def residuals(
        self, a_from_b: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return for the points of both, in frame a: positions, point-to-plane distances, normals, point distances."""
        moved = apply(a_from_b, self.points_b)
        gaps_b, nearest_a = self.tree_a.query(moved)
        gaps_a, nearest_b = self.tree_b.query(apply(invert(a_from_b), self.points_a))
        normals = np.concatenate([self.normals_a[nearest_a], self.normals_b[nearest_b] @ a_from_b[:3, :3].T])
        offsets = np.concatenate([self.points_a[nearest_a] - moved, self.points_a - moved[nearest_b]])
        places = np.concatenate([moved, moved[nearest_b]])
        return places, np.einsum("nc,nc->n", offsets, normals), normals, np.concatenate([gaps_b, gaps_a])

    def normal_equations(
        self, a_from_b: NDArray[np.float64], center_a: NDArray[np.float64], scale_m: float, config: RefinementConfig
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the normal matrix (6, 6) and the right side (6,) for a rotation about the centre and a translation."""
        places, distances, normals, gaps = self.residuals(a_from_b)
        # Geman and McClure (1987): the weight is a quarter at a distance of `scale_m`, and tends to 0.
        weights = 1.0 / (1.0 + (gaps / scale_m) ** 2) ** 2
        rows = np.hstack([np.cross(places - center_a, normals), normals])
        # The errors of a surface's points are correlated: many points weigh as much as a few.
        weights = weights * min(1.0, 100.0 / len(gaps)) / (config.surface_m**2 + (scale_m / 3) ** 2)
        return (rows * weights[:, None]).T @ rows, (rows * weights[:, None]).T @ distances


def _normal_equations(
    surfaces: list[_Surface],
    a_from_b: NDArray[np.float64],
    center_a: NDArray[np.float64],
    scale_m: float,
    config: RefinementConfig,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # (6, 6) of all surfaces together, and the right side (K, 6) of each.
    parts = [surface.normal_equations(a_from_b, center_a, scale_m, config) for surface in surfaces]
    return np.sum([own for own, _ in parts], axis=0), np.array([gain for _, gain in parts])


def _covariance(
    total: NDArray[np.float64], gains: NDArray[np.float64], places: NDArray[np.float64], alike_m: float
) -> NDArray[np.float64]:
    # Sandwich estimator (6, 6) with an object as one observation, since its points err together; objects near one
    # another are displaced alike (Conley 1999, with a normal kernel).
    bread = np.linalg.inv(total)
    squares = ((places[:, None] - places[None]) ** 2).sum(axis=2)
    kernel = np.exp(-squares / (2 * alike_m**2))
    # So many independent ones there are, of which three shifts are fitted.
    count = len(gains) ** 2 / kernel.sum()
    meat = gains.T @ kernel @ gains * count / max(count - 3, 1)
    return np.asarray(bread + bread @ meat @ bread)


def _surfaces(map_a: ObjectMap, map_b: ObjectMap, pairs: NDArray[np.int64], config: RefinementConfig) -> list[_Surface]:
    surfaces = []
    for i, j in pairs:
        points_a, points_b = map_a.points[i], map_b.points[j]
        if points_a is None or points_b is None or min(len(points_a), len(points_b)) < config.min_points:
            continue
        tree_a, tree_b = cKDTree(points_a.astype(np.float64)), cKDTree(points_b.astype(np.float64))
        thin_a, thin_b = (
            thinned(points_a, _MAX_POINTS).astype(np.float64),
            thinned(points_b, _MAX_POINTS).astype(np.float64),
        )
        surfaces.append(
            _Surface(
                points_a=thin_a,
                normals_a=_normals(thin_a, tree_a, config.neighbors),
                points_b=thin_b,
                normals_b=_normals(thin_b, tree_b, config.neighbors),
                tree_a=cKDTree(thin_a),
                tree_b=cKDTree(thin_b),
            )
        )
    return surfaces


def _normals(points: NDArray[np.float64], tree: cKDTree, count: int) -> NDArray[np.float64]:
    _, indices = tree.query(points, k=min(count, tree.n))
    around = tree.data[indices]
    offsets = around - around.mean(axis=1, keepdims=True)
    return np.asarray(np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))[1][:, :, 0])


def _met(surfaces: list[_Surface], a_from_b: NDArray[np.float64], config: RefinementConfig) -> float:
    shares = []
    for surface in surfaces:
        _, distances, _, gaps = surface.residuals(a_from_b)
        shares.append(
            float(np.exp(-0.5 * (distances / config.last_m) ** 2)[gaps < 2 * config.first_m].sum()) / len(gaps)
        )
    return float(np.mean(shares))


def _twist(
    a_from_b: NDArray[np.float64], start: NDArray[np.float64], center_a: NDArray[np.float64]
) -> NDArray[np.float64]:
    now_from_start = a_from_b @ invert(start)
    shift = apply(now_from_start, center_a) - center_a
    return np.concatenate([Rotation.from_matrix(now_from_start[:3, :3]).as_rotvec(), shift])
