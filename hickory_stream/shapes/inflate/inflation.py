"""Layer 4: primitives grown until they provably contain the object and a margin.

They contain the Minkowski sum of surface and layer 1 with a ball of the margin's radius, and the interior of a closed
mesh. Each primitive grows to the least volume around its part of the surface (`surface_partition`, `cover`); residuals
of the fit, such as leaves, get boxes of their own (`residual_boxes`) if that takes clearly less volume. Independent
code checks the result (`certify`); if that fails, a box around everything replaces the primitives.

The paper grows all three axes by one factor, which turns a thin plate into a huge block: by default each semi-axis
grows separately, and edges may become rounder, like those of the Minkowski sum.
"""

from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import Any, Literal, assert_never

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.geometry import portable
from hickory_stream.geometry.portable_kernels import exp, log, power
from hickory_stream.geometry.rigid import apply, from_rotation_translation
from hickory_stream.geometry.superquadric import MIN_EXPONENT, Superquadrics, joined, volumes_m3
from hickory_stream.ports import Reconstruction
from hickory_stream.records import Containment
from hickory_stream.shapes.certify import Certificate, Inside, certify, inside_of, uncovered_cells
from hickory_stream.shapes.fit.quadric_lm import rows_in
from hickory_stream.shapes.fit.surface_partition import owned_pieces, owners_of
from hickory_stream.shapes.inflate.cover import extremes, least_axes, local_abs, undominated, with_net, worst_balls
from hickory_stream.shapes.inflate.residual_boxes import boxes_around

_UNIT_CELLS = 64
# Exponents below these may be raised to them: the rounder candidate is used if it has less volume.
_ROUNDINGS = (0.25, 0.4)
# By how much growth stays below the limit of ln h, as a reserve for the rounding error of the certificate.
_SLACK = 1e-7
_ROUNDS = 6
_WORST = 12
# Residuals get boxes only if they make a primitive grow to this multiple of its volume without them.
_OVERGROWN = 1.1
# Boxes around residuals are kept if the total volume of all primitives then decreases by at least this share.
_LEAST_GAIN = 0.05
# Half the thickness of a box around residuals in one plane.
_THINNEST = 0.01
# A triangle that protrudes from all primitives by more than this share of the object's diagonal is bisected.
_TOLERANCE = 0.01


@dataclass(frozen=True, kw_only=True, slots=True)
class InflateConfig(Ranged):
    """How layer 4 is made."""

    #: "per_axis", or the paper's "single_factor".
    rule: Literal["per_axis", "single_factor"] = "per_axis"
    #: The safety margin.
    r_safe_m: float = number(0.02, 0, 2, "m")
    #: Maximum value of G over the contained set.
    g: float = number(1.0, 0.01, 1, "value of G")
    #: Maximum number of boxes for residuals; "single_factor" adds none.
    most_added: int = number(8, 0, 100, "boxes")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Inflated:
    """The inflated primitives in the world, fitted ones first, then boxes around residuals, or one box for all."""

    primitives: Superquadrics
    certificate: Certificate
    is_fallback: bool


def inflate(
    fitted: Superquadrics, reconstruction: Reconstruction, points_world: NDArray[np.float32], config: InflateConfig
) -> tuple[Superquadrics, Containment]:
    """Return the inflated primitives, those fitted first, and the record of their certificate, all in the world."""
    vertices = apply(reconstruction.world_from_object, reconstruction.mesh.vertices.astype(np.float64))
    found = inflated(fitted, vertices, reconstruction.mesh.faces, points_world.astype(np.float64), config)
    certificate = found.certificate
    return found.primitives, Containment(
        num_checked=certificate.num_pieces + certificate.num_points + certificate.num_cells,
        num_outside=certificate.uncovered_triangles + certificate.uncovered_points + certificate.uncovered_cells,
        max_g=certificate.max_g,
        is_certified=certificate.holds,
        is_fallback=found.is_fallback,
        margin_m=config.r_safe_m,
        shell_m=certificate.shell_m,
    )


def inflated(
    fitted: Superquadrics,
    vertices_world: NDArray[np.float64],
    faces: NDArray[np.int32],
    points_world: NDArray[np.float64],
    config: InflateConfig,
) -> Inflated:
    """Return the primitives grown around the vertices of a `usable` mesh and (N, 3) points, and their certificate.

    Raises:
        ValueError: vertices or points are not finite, or there are none of either.
    """
    everything = np.concatenate([vertices_world, points_world])
    if len(everything) == 0 or not np.isfinite(everything).all():
        raise ValueError(
            f"{len(vertices_world)} vertices of faces and {len(points_world)} points, "
            f"{int((~np.isfinite(everything)).any(axis=1).sum())} of them not finite: nothing can be contained"
        )
    inside = inside_of(vertices_world, faces, r_safe_m=config.r_safe_m)
    checked = {"r_safe_m": config.r_safe_m, "g": config.g}
    if len(fitted):
        for grown in _growths(_Share.of(fitted, vertices_world, faces, points_world, config), inside):
            certificate = certify(grown, vertices_world, faces, points_world, inside, **checked)
            if certificate.holds:
                return Inflated(primitives=grown, certificate=certificate, is_fallback=False)
    box = box_around(everything, config)
    certificate = certify(box, vertices_world, faces, points_world, inside, **checked)
    return Inflated(primitives=box, certificate=certificate, is_fallback=True)


def box_around(points_world: NDArray[np.float64], config: InflateConfig) -> Superquadrics:
    """Return one box-like superquadric with G <= g on the axis-aligned box of (N, 3) points and its margin."""
    low, high = points_world.min(axis=0) - config.r_safe_m, points_world.max(axis=0) + config.r_safe_m
    half = (high - low) / 2
    # Of non-zero thickness, and wide enough for the corners, where G = 3 (1 / s)^(2 / e).
    half = np.maximum(half, 1e-3 * max(float(half.max()), 1e-9))
    axes = half * power(3.0 / config.g, MIN_EXPONENT / 2) * (1 + 1e-7)
    return Superquadrics(
        exponents=np.full((1, 2), MIN_EXPONENT),
        semi_axes_m=axes[None],
        world_from_local=from_rotation_translation(np.eye(3), (low + high) / 2)[None],
    )


def inflate_to_cover(fitted: Superquadrics, points_world: NDArray[Any], config: InflateConfig) -> Superquadrics:
    """Return the primitives grown so that the ball around each of (N, 3) points lies in the nearest primitive."""
    points = np.asarray(points_world, dtype=np.float64)
    return _Share.of(fitted, np.empty((0, 3)), np.empty((0, 3), np.int32), points, config).grown()


def _growths(share: "_Share", inside: Inside) -> list[Superquadrics]:
    # In order of preference: with boxes for residuals if these take clearly less volume.
    grown = share.grown()
    whole = share.grown_over(inside, grown)
    if share.config.rule == "single_factor" or share.config.most_added == 0:
        return [whole]
    tight = share.with_residuals_boxed(grown)
    if tight is None:
        return [whole]
    boxed = tight.grown_over(inside, tight.grown_from(share, grown))
    is_worth_it = volumes_m3(boxed).sum() < (1 - _LEAST_GAIN) * volumes_m3(whole).sum()
    return [boxed, whole] if is_worth_it else [whole]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Share:
    # The set that each primitive has to contain: balls around (N, 3) points, in units of 1/64 of the object's size
    # (tolerances do not depend on scale), off the mean (precision far from the origin). `items` (M, 3) are corners of
    # triangles, or one point three times; `owners` (M,) their primitives, `distances` (M,) how far they protrude.
    primitives: Superquadrics
    unit_m: float
    offset_m: NDArray[np.float64]
    points: NDArray[np.float64]
    radii: NDArray[np.float64]
    items: NDArray[np.int64]
    owners: NDArray[np.int64]
    distances: NDArray[np.float64]
    config: InflateConfig

    @classmethod
    def of(
        cls,
        fitted: Superquadrics,
        vertices_world: NDArray[np.float64],
        faces: NDArray[np.int32],
        points_world: NDArray[np.float64],
        config: InflateConfig,
    ) -> "_Share":
        everything = np.concatenate([vertices_world, points_world])
        offset = everything.mean(axis=0)
        diagonal = portable.norm(np.ptp(everything, axis=0))
        unit = max(diagonal, float(fitted.semi_axes_m.max())) / _UNIT_CELLS
        rows = rows_in(fitted, unit, offset)
        tolerance = _TOLERANCE * _UNIT_CELLS
        vertices, pieces, owners, distances = owned_pieces(
            (vertices_world - offset) / unit, faces.astype(np.int64), rows, tolerance, 2 * tolerance
        )
        points = (points_world - offset) / unit
        owners_of_points, distances_of_points = owners_of(points, rows)
        everything = np.concatenate([vertices, points])
        return cls(
            primitives=fitted,
            unit_m=unit,
            offset_m=offset,
            points=everything,
            radii=np.full(len(everything), config.r_safe_m / unit),
            items=np.concatenate([pieces, _alone(len(vertices), len(points))]),
            owners=np.concatenate([owners, owners_of_points]),
            distances=np.concatenate([distances, distances_of_points]),
            config=config,
        )

    def with_balls(self, centers_world: NDArray[np.float64], radii_m: NDArray[np.float64]) -> "_Share":
        centers = (centers_world - self.offset_m) / self.unit_m
        bodies = self.primitives
        gauges = np.stack(
            [
                _log_gauges(local_abs(centers_world, pose), axes, *exponents)
                for exponents, axes, pose in zip(
                    bodies.exponents, bodies.semi_axes_m, bodies.world_from_local, strict=True
                )
            ]
        )
        return replace(
            self,
            points=np.concatenate([self.points, centers]),
            radii=np.concatenate([self.radii, radii_m / self.unit_m]),
            items=np.concatenate([self.items, _alone(len(self.points), len(centers))]),
            owners=np.concatenate([self.owners, np.argmin(gauges, axis=0)]),
            # These balls are all inside the object, so that they are not residuals.
            distances=np.concatenate([self.distances, np.zeros(len(centers))]),
        )

    def with_residuals_boxed(self, grown: Superquadrics) -> "_Share | None":
        # None if no residual makes a primitive grow much; residuals lie clearly outside of all primitives.
        is_residual = self.distances > _TOLERANCE * _UNIT_CELLS
        have_residuals = np.unique(self.owners[is_residual])
        # Their extreme points are enough to tell how large they would be: this is not a result.
        without = self._of_items(~is_residual).grown(have_residuals, by_extremes=True)
        is_residual &= (volumes_m3(grown) > _OVERGROWN * volumes_m3(without))[self.owners]
        if not is_residual.any():
            return None
        residuals = np.flatnonzero(is_residual)
        largest = int(np.argmax(volumes_m3(self.primitives)))
        boxes = boxes_around(
            self.points[self.items[residuals]],
            self.primitives.world_from_local[largest, :3, :3],
            margin=self.config.r_safe_m / self.unit_m,
            most=self.config.most_added,
        )
        owners = self.owners.copy()
        for n, box in enumerate(boxes):
            owners[residuals[box.held]] = len(self.primitives) + n
        added = Superquadrics(
            exponents=np.full((len(boxes), 2), MIN_EXPONENT),
            semi_axes_m=np.stack([np.maximum(box.half_extents, _THINNEST) for box in boxes]) * self.unit_m,
            world_from_local=np.stack(
                [from_rotation_translation(box.axes, self.offset_m + self.unit_m * box.center) for box in boxes]
            ),
        )
        return replace(self, primitives=joined([self.primitives, added]), owners=owners)

    def grown_over(self, inside: Inside, grown: Superquadrics) -> Superquadrics:
        # Until the primitives also contain the interior, from `grown`, which are grown over this share.
        share = self
        for _ in range(_ROUNDS):
            out = uncovered_cells(grown, inside, self.config.g)
            if len(out) == 0:
                break
            more = share.with_balls(out[:, :3], out[:, 3] * np.sqrt(3))
            # The other primitives are unchanged.
            which = np.unique(more.owners[len(share.owners) :])
            share, grown = more, _replaced(grown, more.grown(which), which)
        return grown

    def grown(self, which: NDArray[np.int64] | None = None, *, by_extremes: bool = False) -> Superquadrics:
        # `which` (M,): only these; `by_extremes`: by the extreme points alone, which nearly determine the result.
        exponents, axes = self.primitives.exponents.copy(), self.primitives.semi_axes_m.copy()
        for i in range(len(self.primitives)) if which is None else which:
            own = np.zeros(len(self.points), bool)
            own[self.items[self.owners == i]] = True
            if own.any():
                exponents[i], in_units = self._grown_one(i, own, by_extremes=by_extremes)
                axes[i] = in_units * self.unit_m
        return Superquadrics(exponents=exponents, semi_axes_m=axes, world_from_local=self.primitives.world_from_local)

    def grown_from(self, before: "_Share", grown: Superquadrics) -> Superquadrics:
        # Reuses the result `grown` of a share `before` with fewer primitives.
        num_before = len(before.primitives)
        changed = self.owners != before.owners
        touched = np.unique(np.concatenate([self.owners[changed], before.owners[changed]]))
        which = np.union1d(touched, np.arange(num_before, len(self.primitives)))
        kept = np.setdiff1d(np.arange(num_before), which)
        return _replaced(self.grown(which), grown, kept)

    def _of_items(self, are_in: NDArray[np.bool_]) -> "_Share":
        return replace(self, items=self.items[are_in], owners=self.owners[are_in], distances=self.distances[are_in])

    def _grown_one(
        self, index: int, own: NDArray[np.bool_], *, by_extremes: bool
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        pose = self.primitives.world_from_local[index].copy()
        pose[:3, 3] = (pose[:3, 3] - self.offset_m) / self.unit_m
        points, radii = _deciding(local_abs(self.points[own], pose), self.radii[own])
        before = self.primitives.semi_axes_m[index] / self.unit_m
        exponents = self.primitives.exponents[index]
        if self.config.rule == "single_factor":
            return exponents, _by_one_factor(points, radii, before, exponents, self.config.g)
        if self.config.rule != "per_axis":
            assert_never(self.config.rule)
        # The extreme points in many directions nearly determine the result.
        scale = np.maximum(points.max(axis=0) + radii.max(), before)
        far = extremes(points / scale, _octant_directions())
        binding = with_net(points[far], radii[far])
        binding = binding[extremes(binding / scale, _octant_directions())]
        candidates = _candidates(exponents)
        axes = [_least_around(binding, before, rounder, self.config.g) for rounder in candidates]
        sizes = [
            float(portable.log(own).sum()) + _log_share(*e.tolist()) for own, e in zip(axes, candidates, strict=True)
        ]
        best = int(np.argmin(sizes))
        if by_extremes:
            return candidates[best], axes[best]
        return candidates[best], _axes_around(
            points, radii, binding, before, candidates[best], self.config.g, first=axes[best]
        )


def _replaced(primitives: Superquadrics, others: Superquadrics, which: NDArray[np.int64]) -> Superquadrics:
    exponents, axes = primitives.exponents.copy(), primitives.semi_axes_m.copy()
    exponents[which], axes[which] = others.exponents[which], others.semi_axes_m[which]
    return Superquadrics(exponents=exponents, semi_axes_m=axes, world_from_local=primitives.world_from_local)


def _deciding(
    points: NDArray[np.float64], radii: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    kept = np.zeros(len(points), bool)
    for radius in np.unique(radii):
        alike = np.flatnonzero(radii == radius)
        kept[alike[undominated(points[alike])]] = True
    return points[kept], radii[kept]


def _candidates(exponents: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    # The given ones first, then rounder edges, then a round cross-section about z.
    rounder = [np.maximum(exponents, rounding) for rounding in _ROUNDINGS]
    round_along = np.array([exponents[0], max(exponents[1], 1.0)])
    tried: list[NDArray[np.float64]] = []
    for candidate in [exponents, *rounder, round_along]:
        if not any(np.array_equal(candidate, other) for other in tried):
            tried.append(candidate)
    return tried


def _alone(first: int, count: int) -> NDArray[np.int64]:
    return np.repeat(np.arange(first, first + count)[:, None], 3, axis=1)


def _least_around(
    binding: NDArray[np.float64], before: NDArray[np.float64], exponents: NDArray[np.float64], g: float
) -> NDArray[np.float64]:
    e1, e2 = float(exponents[0]), float(exponents[1])
    return least_axes(binding, before, e1, e2, e1 / 2 * float(log(g)) - _SLACK)


def _axes_around(
    points: NDArray[np.float64],
    radii: NDArray[np.float64],
    binding: NDArray[np.float64],
    before: NDArray[np.float64],
    exponents: NDArray[np.float64],
    g: float,
    *,
    first: NDArray[np.float64],
) -> NDArray[np.float64]:
    # Protruding balls are added to `binding` round by round; `first` are the semi-axes around `binding`.
    e1, e2 = float(exponents[0]), float(exponents[1])
    limit = e1 / 2 * float(log(g)) - _SLACK
    axes = first
    for _ in range(_ROUNDS):
        worst = worst_balls(points, radii, axes, e1, e2, limit + _SLACK / 2, _WORST)
        if len(worst) == 0:
            return axes
        binding = np.concatenate([binding, with_net(points[worst], radii[worst])])
        axes = _least_around(binding, before, exponents, g)
    return _by_one_factor(points, radii, axes, exponents, g)


def _by_one_factor(
    points: NDArray[np.float64],
    radii: NDArray[np.float64],
    axes: NDArray[np.float64],
    exponents: NDArray[np.float64],
    g: float,
) -> NDArray[np.float64]:
    # The paper's gamma = (G_max / g)^(e1 / 2), at least 1, over all balls.
    e1, e2 = float(exponents[0]), float(exponents[1])
    limit = e1 / 2 * float(log(g)) - _SLACK
    worst = float(_log_gauges(with_net(points, radii), axes, e1, e2).max())
    return np.asarray(np.maximum(axes * exp(worst - limit), axes))


def _log_gauges(points: NDArray[np.float64], axes: NDArray[np.float64], e1: float, e2: float) -> NDArray[np.float64]:
    logs = portable.log(np.maximum(points / axes, 1e-200))
    log_rho = e2 / 2 * portable.logaddexp(2 / e2 * logs[:, 0], 2 / e2 * logs[:, 1])
    return np.asarray(e1 / 2 * portable.logaddexp(2 / e1 * log_rho, 2 / e1 * logs[:, 2]))


@lru_cache(maxsize=1024)
def _log_share(e1: float, e2: float) -> float:
    # Of the product of the semi-axes.
    unit = Superquadrics(exponents=np.array([[e1, e2]]), semi_axes_m=np.ones((1, 3)), world_from_local=np.eye(4)[None])
    return float(log(volumes_m3(unit)[0]))


@cache
def _octant_directions() -> NDArray[np.float64]:
    steps = np.linspace(0, np.pi / 2, 8)
    a, b = np.meshgrid(steps, steps, indexing="ij")
    (cos_a, sin_a), (cos_b, sin_b) = ((portable.cos(angle), portable.sin(angle)) for angle in (a, b))
    directions = np.stack([cos_a * cos_b, sin_a * cos_b, sin_b], axis=-1).reshape(-1, 3)
    return np.unique(np.round(directions, 12), axis=0)
