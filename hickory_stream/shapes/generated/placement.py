"""Placement: a mesh in a frame and scale of its own is put into the world, where views and layer 1 saw the object.

Rotations all over SO(3), each with the sizes at which the mesh covers the seen surface, are ranked by a coarse cost,
and the best descend. The evidence is the measured surface, silhouettes and free space of all views, and the support.
Then the mesh may be stretched along its own axes, within bounds, if that explains clearly more.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.base.ranges import Ranged, number
from hickory_stream.geometry import portable
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import rotation_from_quaternion
from hickory_stream.ports import MeshPlacement, NotPlaced, ShapeInputs
from hickory_stream.shapes.generated.distance_field import distance_field, even_samples, field_at
from hickory_stream.shapes.generated.placement_evidence import Evidence, evidence_of
from hickory_stream.shapes.generated.placement_fit import cost_of, descend, residuals

_MIN_SURFACE = 12
# Poses whose meshes are nearer to one another than this share of the object's size are the same surface.
_SAME_SURFACE = 0.03
_OTHER_TURN_COSINE = 0.94
# Deviations of this share of the object's size count half: with the coarse evidence, and with all of it.
_COARSE_SHARE = 0.06
_FINE_SHARE = 0.02
# Weights of free space and of the support against the measured surface.
_FREE_WEIGHT = 1.0
_SUPPORT_WEIGHT = 0.1
# The mesh is stretched if the cost falls by this share.
_STRETCH_GAIN = 0.1
# The resolution of distances, and the numbers of points that are compared.
_DISTANCE_CELLS = 40
_SURFACE_POINTS = 400
_MESH_POINTS = 400


@dataclass(frozen=True, kw_only=True, slots=True)
class PlacementConfig(Ranged):
    """How a generated mesh is placed."""

    #: Number of rotations over SO(3) that are tried.
    rotations: int = number(500, 1, 100_000, "rotations")
    #: Number of the best of them that are refined with the coarse evidence.
    descents: int = number(40, 1, 10_000, "poses")
    #: Number of the best of those that are refined with all of it.
    finalists: int = number(6, 1, 1000, "poses")
    #: Maximum stretch of the mesh: the largest factor over the smallest; 1: none.
    most_stretch: float = number(1.6, 1, 10, "ratio")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Model:
    # Of diagonal 1 about the origin: mesh point = `center` + `size` * `axes` @ point.
    center: NDArray[np.float64]
    size: float
    axes: NDArray[np.float64]
    samples: NDArray[np.float64]
    field: NDArray[np.float32]
    origin: NDArray[np.float64]
    cell: float


@dataclass(frozen=True, slots=True, eq=False)
class _Pose:
    # World point = `rotation` @ (`factors` * point) + `shift`.
    rotation: NDArray[np.float64]
    shift: NDArray[np.float64]
    factors: NDArray[np.float64]
    cost: float
    normal: NDArray[np.float64]


class EmbeddedPlacement:
    """The `PoseRefiner` without a network."""

    name = "embedded"

    def __init__(self, config: PlacementConfig) -> None:
        self._config = config

    def place(
        self, mesh: Mesh, inputs: ShapeInputs, guess: NDArray[np.float64] | None = None
    ) -> MeshPlacement | NotPlaced:
        """Return where the mesh lies in the world, or why that is unknown."""
        evidence = evidence_of(inputs)
        if evidence is None or len(evidence.surface) < _MIN_SURFACE:
            return NotPlaced(reason="too little of the object's surface was measured to place a mesh on it")
        try:
            model = _model_of(mesh)
        except ValueError as error:
            return NotPlaced(reason=str(error))
        return _placed(model, evidence, guess, self._config)


def _placed(
    model: _Model, evidence: Evidence, guess: NDArray[np.float64] | None, config: PlacementConfig
) -> MeshPlacement | NotPlaced:
    coarse = _Stage(model, evidence, config, share=_COARSE_SHARE, thinning=4)
    fine = _Stage(model, evidence, config, share=_FINE_SHARE, thinning=1)
    starts = _starts(model, evidence, _rotations(config.rotations))
    if guess is not None:
        starts = [_pose_of_guess(model, guess), *starts]
    ranked = coarse.ranked(starts)[: config.descents]
    descended = sorted((coarse.descended(pose, rounds=8) for pose in ranked), key=lambda pose: pose.cost)
    finalists = [fine.descended(pose, rounds=20) for pose in _distinct(descended, model)[: config.finalists]]
    finalists.sort(key=lambda pose: pose.cost)
    stretched = [fine.descended(pose, rounds=20, is_stretched=True) for pose in finalists[:3]]
    stretched.sort(key=lambda pose: pose.cost)
    best = finalists[0]
    if stretched[0].cost < (1 - _STRETCH_GAIN) * best.cost:
        best = stretched[0]
    if not np.isfinite(best.cost):
        return NotPlaced(reason="no pose of the mesh has a finite cost")
    return _answer(best, finalists, model, evidence)


def _model_of(mesh: Mesh) -> _Model:
    samples, _ = even_samples(mesh.vertices, mesh.faces, 20 * _MESH_POINTS)
    centered = samples - samples.mean(axis=0)
    _, axes = portable.eigh(portable.matmul(centered.T, centered) / len(centered))
    if portable.det3(axes) < 0:
        axes[:, 0] = -axes[:, 0]
    along = portable.matmul(mesh.vertices.astype(np.float64), axes)
    low, high = along.min(axis=0), along.max(axis=0)
    size = float(np.sqrt(np.square(high - low).sum()))
    own = (along - (low + high) / 2) / size
    field = distance_field(own, mesh.faces, _DISTANCE_CELLS)
    picked, _ = even_samples(own, mesh.faces, _MESH_POINTS)
    return _Model(
        center=portable.matmul(axes, (low + high) / 2),
        size=size,
        axes=axes,
        samples=picked,
        field=field.distance,
        origin=field.origin,
        cell=field.cell,
    )


def _pose_of_guess(model: _Model, world_from_mesh: NDArray[np.float64]) -> _Pose:
    turned = portable.matmul(world_from_mesh[:3, :3], model.axes)
    scale = float(portable.cbrt([abs(portable.det3(turned))])[0])
    rotation = portable.nearest_orthogonal(turned[None] / max(scale, 1e-12))[0]
    shift = portable.matmul(world_from_mesh[:3, :3], model.center) + world_from_mesh[:3, 3]
    return _Pose(rotation, shift, np.full(3, max(scale, 1e-12) * model.size), np.inf, np.zeros((7, 7)))


def _rotations(count: int) -> NDArray[np.float64]:
    # Super-Fibonacci spirals over SO(3) (Alexa, CVPR 2022).
    s = np.arange(count) + 0.5
    alpha, beta = 2 * np.pi * s / 1.4142135623730951, 2 * np.pi * s / 1.533751168755204288
    r, q = np.sqrt(s / count), np.sqrt(1 - s / count)
    quaternions = [r * portable.sin(alpha), r * portable.cos(alpha), q * portable.sin(beta), q * portable.cos(beta)]
    return np.array(
        [rotation_from_quaternion(*(float(part) for part in row)) for row in zip(*quaternions, strict=True)]
    )


def _starts(model: _Model, evidence: Evidence, rotations: NDArray[np.float64]) -> list[_Pose]:
    # The mesh covers the seen surface, across the first view and along it.
    axes = evidence.camera_from_world[0, :3, :3] if len(evidence.depth) else np.eye(3)
    seen = portable.matmul(evidence.surface, axes.T)
    seen_low, seen_high = np.quantile(seen, [0.02, 0.98], axis=0)
    seen_size = np.maximum(seen_high - seen_low, 1e-3 * evidence.size_m)
    poses = []
    for rotation in rotations:
        turned = portable.matmul(model.samples, portable.matmul(axes, rotation).T)
        low, high = turned.min(axis=0), turned.max(axis=0)
        ratios = seen_size / np.maximum(high - low, 1e-3)
        across = float(np.sqrt(ratios[0] * ratios[1]))
        for factor in sorted({across, max(across, float(ratios[2])), float(max(ratios[0], ratios[1]))}):
            place = (seen_low + seen_high) / 2 - factor * (low + high) / 2
            # What was seen is the front; where the views go around the object the depth decides alike.
            place[2] = seen_low[2] - factor * low[2]
            shift = portable.matmul(axes.T, place)
            poses.append(_Pose(rotation, shift, np.full(3, factor), np.inf, np.zeros((7, 7))))
    return poses


class _Stage:
    def __init__(
        self, model: _Model, evidence: Evidence, config: PlacementConfig, *, share: float, thinning: int
    ) -> None:
        surface = _thinned(evidence.surface, _SURFACE_POINTS // thinning)
        samples = _thinned(model.samples, _MESH_POINTS // thinning)
        views = slice(None, None, max(1, len(evidence.depth) // 4)) if thinning > 1 else slice(None)
        self._model = (surface, samples, model.field, model.origin, model.cell)
        self._views = (
            evidence.depth[views], evidence.beside[views], evidence.sizes[views], evidence.intrinsics[views],
            evidence.camera_from_world[views], evidence.is_cut[views], evidence.noise_m, evidence.support_z_m,
        )  # fmt: skip
        self._weights = np.array([1.0, _FREE_WEIGHT, _SUPPORT_WEIGHT])
        self._tolerance = max(share * evidence.size_m, evidence.noise_m)
        self._size = evidence.size_m
        self._most = config.most_stretch

    def ranked(self, poses: list[_Pose]) -> list[_Pose]:
        """Return the poses by their cost."""
        rotations = np.array([pose.rotation for pose in poses])
        shifts, factors = np.array([pose.shift for pose in poses]), np.array([pose.factors for pose in poses])
        costs = _costs(rotations, shifts, factors, self._model, self._views, self._weights, self._tolerance)
        return [poses[i] for i in np.argsort(costs, kind="stable")]

    def descended(self, pose: _Pose, *, rounds: int, is_stretched: bool = False) -> _Pose:
        """Return the pose that is reached from another one."""
        rotation, shift, factors = pose.rotation.copy(), pose.shift.copy(), pose.factors.copy()
        cost, normal = descend(
            rotation, shift, factors, self._model, self._views, self._weights,
            self._tolerance, self._size, 9 if is_stretched else 7, self._most, rounds,
        )  # fmt: skip
        return _Pose(rotation, shift, factors, float(cost), normal)


def _thinned(points: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    if len(points) <= count:
        return np.ascontiguousarray(points)
    return np.ascontiguousarray(points[(np.arange(count) * len(points)) // count])


def _distinct(poses: list[_Pose], model: _Model) -> list[_Pose]:
    kept: list[_Pose] = []
    for pose in poses:
        if all(_apart(pose, other, model) > 0.1 for other in kept):
            kept.append(pose)
    return kept


def _apart(a: _Pose, b: _Pose, model: _Model) -> float:
    # The mean distance of corresponding points, as a share of the size of the second.
    points = model.samples[::8]
    moved = [portable.matmul(points * pose.factors, pose.rotation.T) + pose.shift for pose in (a, b)]
    return float(np.sqrt(np.square(moved[0] - moved[1]).sum(axis=1)).mean() / b.factors.max())


def _surface_apart(a: _Pose, b: _Pose, model: _Model) -> float:
    # From the mesh at one pose to its surface at another, as a share of its size.
    points = model.samples[::4]
    world = portable.matmul(points * a.factors, a.rotation.T) + a.shift
    own = portable.matmul(world - b.shift, b.rotation) / b.factors
    return float(_distances(own, model.field, model.origin, model.cell).mean())


@kernel
def _distances(points, field, origin, cell):
    out = np.empty(len(points))
    for i in range(len(points)):
        out[i] = field_at(field, origin, cell, points[i, 0], points[i, 1], points[i, 2])
    return out


@kernel
def _costs(rotations, shifts, factors, model, views, weights, tolerance):
    out = np.empty(len(rotations))
    values = np.empty(len(model[0]) + len(model[1]) + 1)
    for i in range(len(rotations)):
        residuals(rotations[i], shifts[i], factors[i], model, views, weights, values)
        out[i] = cost_of(values, len(model[0]), tolerance, weights)
    return out


def _answer(best: _Pose, finalists: list[_Pose], model: _Model, evidence: Evidence) -> MeshPlacement:
    linear = portable.matmul(best.rotation * (best.factors / model.size), model.axes.T)
    world_from_mesh = np.eye(4)
    world_from_mesh[:3, :3] = linear
    world_from_mesh[:3, 3] = best.shift - portable.matmul(linear, model.center)
    mean = float(portable.cbrt([best.factors.prod()])[0])
    sigma_m, sigma_rad, sigma_scale = _sigmas(best, evidence)
    is_symmetric, margin = False, 1.0
    for other in finalists:
        if _surface_apart(other, best, model) < _SAME_SURFACE:
            cosine = (portable.matmul(other.rotation.T, best.rotation).trace() - 1) / 2
            is_symmetric |= bool(cosine < _OTHER_TURN_COSINE)
        else:
            margin = min(margin, 1 - best.cost / max(other.cost, 1e-12))
    return MeshPlacement(
        world_from_mesh=world_from_mesh,
        scale=mean / model.size,
        stretch=best.factors / mean,
        stretch_axes=model.axes,
        cost=best.cost,
        sigma_m=sigma_m,
        sigma_rad=sigma_rad,
        sigma_scale=sigma_scale,
        is_symmetric=is_symmetric,
        margin=max(margin, 0.0),
    )


def _sigmas(pose: _Pose, evidence: Evidence) -> tuple[float, float, float]:
    # Of place (m), rotation (rad) and size (share), by the cost's curvature. The cost is a mean of as many independent
    # terms as the surface has points.
    normal = pose.normal[:7, :7] * max(len(evidence.surface), 1)
    values, vectors = portable.eigh(normal)
    # What the evidence does not say at all is as uncertain as the object is large.
    variances = np.minimum(1 / np.maximum(values, 1e-12), evidence.size_m * evidence.size_m)
    covariance = portable.matmul(vectors * variances, vectors.T)
    diagonal = np.sqrt(np.maximum(np.diagonal(covariance), 0.0) * max(pose.cost, 1e-3))
    turn, place = np.sqrt(np.square(diagonal[:3]).sum()), np.sqrt(np.square(diagonal[3:6]).sum())
    return float(place), float(turn / evidence.size_m), float(diagonal[6] / evidence.size_m)
