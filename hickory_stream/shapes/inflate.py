"""Layer 4: primitives grown until they contain the object and a margin.

The paper's rule: points of the object, moved outwards from its centroid by the margin, are assigned to their closest
primitive, which grows until G <= g for all of its points. The paper's single factor per primitive makes a huge block of
a thin plate; by default each semi-axis grows on its own. In the logarithms of the semi-axes ln G is convex and that of
the volume is linear, so that the smallest growth is a convex problem in three unknowns, solved on the few points that
bind; the paper's factor then takes up what numerical slack is left.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, assert_never

import numpy as np
from scipy.optimize import minimize

from hickory_stream.geometry.mesh import sample_surface
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.geometry.superquadric import (
    Superquadrics,
    centroid_world,
    implicit_value,
    log_implicit_value,
    radial_distance_m,
    sorted_by_volume,
)
from hickory_stream.records import Containment

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray

    from hickory_stream.ports import Reconstruction


@dataclass(frozen=True, kw_only=True, slots=True)
class InflateConfig:
    """How layer 4 is made.

    `rule` is "per_axis" or the paper's "single_factor". `r_safe_m` is the margin; `g` in 0..1 is the value of G that no
    point may exceed. `num_samples` surface points are covered, besides all vertices and the points of layer 1, and
    `num_checks` others are checked; `num_rounds` times as many more are looked for what was missed.
    """

    rule: Literal["per_axis", "single_factor"] = "per_axis"
    r_safe_m: float = 0.02
    g: float = 1.0
    num_samples: int = 4000
    num_rounds: int = 3
    num_checks: int = 4000


def inflate(
    fitted: Superquadrics, reconstruction: Reconstruction, points_world: NDArray[np.float32], config: InflateConfig
) -> tuple[Superquadrics, Containment]:
    """Return the inflated primitives in the world, largest first, and how well they contain the object.

    `fitted` in the world; `points_world` (N, 3) are those of layer 1. No primitive ever shrinks. The containment is
    measured on other samples of the surface than those that were covered.
    """
    mesh, pose = reconstruction.mesh, reconstruction.world_from_object
    rng = np.random.default_rng(0)
    surface = np.concatenate([sample_surface(mesh, config.num_samples, rng)[0], mesh.vertices])
    points = np.concatenate([apply(pose, surface.astype(np.float64)), points_world.astype(np.float64)])
    center = centroid_world(fitted)
    # The surface itself too: of an object that is not convex, moving outwards need not cover where it came from.
    inflated = inflate_to_cover(
        fitted, np.concatenate([points, moved_outwards(points, center, config.r_safe_m)]), config
    )
    # Between the samples, at the seams of two primitives, a sliver may be left: further samples find it.
    for _ in range(config.num_rounds):
        more = apply(pose, sample_surface(mesh, config.num_samples, rng)[0].astype(np.float64))
        outside = more[lowest_value(inflated, more) > config.g]
        if len(outside):
            inflated = inflate_to_cover(inflated, outside, config)
    checks, _ = sample_surface(mesh, config.num_checks, np.random.default_rng(1))
    checked = np.concatenate([apply(pose, checks.astype(np.float64)), points_world.astype(np.float64)])
    return sorted_by_volume(inflated), containment_of(inflated, checked)


def inflate_to_cover(fitted: Superquadrics, points_world: NDArray[Any], config: InflateConfig) -> Superquadrics:
    """Return the primitives grown so that each of (N, 3) points has G <= g in the primitive closest to it."""
    owner = closest_primitive(fitted, points_world)
    semi_axes = fitted.semi_axes_m.copy()
    for i in range(len(fitted)):
        own = points_world[owner == i]
        if len(own) == 0:
            continue
        if config.rule == "per_axis":
            semi_axes[i] = _grown_axes(fitted, i, own, config.g)
        elif config.rule != "single_factor":
            assert_never(config.rule)
        grown = _with_axes(fitted, semi_axes)
        semi_axes[i] *= max(_factor(grown, i, own, config.g), 1.0)
    return _with_axes(fitted, semi_axes)


def closest_primitive(primitives: Superquadrics, points_world: NDArray[Any]) -> NDArray[np.int64]:
    """Return (N,) the primitive with the smallest radial distance to each point; the first of equal ones."""
    distances = np.stack([radial_distance_m(primitives, i, points_world) for i in range(len(primitives))])
    return np.asarray(np.argmin(distances, axis=0))


def moved_outwards(
    points_world: NDArray[np.float64], center_world: NDArray[np.float64], margin_m: float
) -> NDArray[np.float64]:
    """Return the points moved away from the centre by `margin_m`; a point at the centre stays."""
    offsets = points_world - center_world
    lengths = np.linalg.norm(offsets, axis=1, keepdims=True)
    return points_world + offsets * (margin_m / np.maximum(lengths, 1e-12))


def containment_of(primitives: Superquadrics, points_world: NDArray[Any]) -> Containment:
    """Return how the union of the primitives contains (N, 3) points; a point may lie in any of them."""
    lowest = lowest_value(primitives, points_world)
    return Containment(
        num_checked=len(points_world), num_outside=int((lowest > 1.0 + 1e-6).sum()), max_g=float(lowest.max())
    )


def lowest_value(primitives: Superquadrics, points_world: NDArray[Any]) -> NDArray[np.float64]:
    """Return (N,) the smallest G of any primitive at each point: at most 1 inside their union."""
    return np.asarray(np.min([implicit_value(primitives, i, points_world) for i in range(len(primitives))], axis=0))


def _factor(primitives: Superquadrics, index: int, points: NDArray[np.float64], g: float) -> float:
    """Return the paper's gamma = (G_max / g)^(e1 / 2), a hair larger so that rounding leaves no point outside."""
    log_max = float(log_implicit_value(primitives, index, points).max())
    return float(np.exp(primitives.exponents[index, 0] / 2 * (log_max - np.log(g)))) * (1 + 1e-9)


def _grown_axes(primitives: Superquadrics, index: int, points: NDArray[np.float64], g: float) -> NDArray[np.float64]:
    """Return the (3,) semi-axes of least volume, none shorter than before, for which G <= g (up to a small slack).

    Constraints are added as they are violated; few of the points ever bind.
    """
    e1, e2 = primitives.exponents[index]
    logs = np.log(np.maximum(np.abs(apply(invert(primitives.world_from_local[index]), points)), 1e-9))
    before = np.log(primitives.semi_axes_m[index])
    limit = e1 / 2 * float(np.log(g))
    value, _ = _log_gauge(logs, before, e1, e2)
    if value.max() <= limit:
        return np.exp(before)
    logs, value = logs[value > limit], value[value > limit]
    axes = before + (value.max() - limit)
    active = np.array([int(np.argmax(value))])
    for _ in range(12):
        axes = _least_growth(logs[active], before, axes, (e1, e2), limit)
        value, _ = _log_gauge(logs, axes, e1, e2)
        worst = np.argsort(-value, kind="stable")[:8]
        worst = worst[value[worst] > limit + 1e-4]
        if len(worst) == 0:
            break
        active = np.union1d(active, worst)
        axes = axes + max(float(value.max()) - limit, 0.0)
    return np.exp(np.maximum(axes, before))


def _least_growth(
    logs: NDArray[np.float64],
    before: NDArray[np.float64],
    start: NDArray[np.float64],
    exponents: tuple[float, float],
    limit: float,
) -> NDArray[np.float64]:
    """Return the (3,) log semi-axes of least sum with ln h <= limit at all of `logs`."""
    solution = minimize(
        lambda axes: float(axes.sum()),
        start,
        jac=lambda axes: np.ones(3),
        bounds=[(b, None) for b in before],
        constraints={
            "type": "ineq",
            "fun": lambda axes: limit - _log_gauge(logs, axes, *exponents)[0],
            "jac": lambda axes: -_log_gauge(logs, axes, *exponents)[1],
        },
        method="SLSQP",
        options={"maxiter": 40, "ftol": 1e-5},
    )
    return np.asarray(np.maximum(solution.x, before)) if np.isfinite(solution.x).all() else start


def _log_gauge(
    logs: NDArray[np.float64], axes: NDArray[np.float64], e1: float, e2: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (N,) ln h = e1/2 ln G at points with log coordinates (N, 3), and its (N, 3) gradient in the log axes."""
    u = logs - axes
    log_rho = e2 / 2 * np.logaddexp(2 / e2 * u[:, 0], 2 / e2 * u[:, 1])
    value = e1 / 2 * np.logaddexp(2 / e1 * log_rho, 2 / e1 * u[:, 2])
    share_rho = np.exp(2 / e1 * (log_rho - value))
    share_x = np.exp(2 / e2 * (u[:, 0] - log_rho))
    gradient = -np.stack([share_rho * share_x, share_rho * (1 - share_x), 1 - share_rho], axis=1)
    return value, gradient


def _with_axes(primitives: Superquadrics, semi_axes_m: NDArray[np.float64]) -> Superquadrics:
    return Superquadrics(
        exponents=primitives.exponents, semi_axes_m=semi_axes_m, world_from_local=primitives.world_from_local
    )
