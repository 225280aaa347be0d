"""One object of `tools/bench shapes`: its layers 3 and 4 beside the truth, in figures."""

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from hickory_stream.geometry.superquadric import Superquadrics
from hickory_stream.records import FitKind
from hickory_stream.shapes.fit.marching_primitives import FitConfig, Fitted, fitted_shape
from hickory_stream.shapes.inflate.inflation import InflateConfig, Inflated, inflated
from tools.benchmarks.common.figures import Options
from tools.benchmarks.common.processes import best_s
from tools.evaluation.shapes.meshes import test_mesh
from tools.evaluation.shapes.solids import Solid, grown_volume_ratio, sampled_iou, surface_distance_pct, volumetric_iou
from tools.evaluation.shapes.spoiled_generator import plain_mesh

MARGIN_M = 0.05
_NOISE, _STRETCH = 0.005, (0.02, 0.03)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Row:
    """One object as it was measured."""

    name: str
    fitted: Superquadrics
    kind: FitKind
    grown: Inflated
    fit_seconds: float
    inflate_seconds: float
    iou: float
    distance_pct: float
    volume_ratio: float

    @property
    def state(self) -> str:
        return "box" if self.grown.is_fallback else "certified" if self.grown.certificate.holds else "NOT COVERED"


def row_of(
    name: str, upright: trimesh.Trimesh, turn: NDArray[np.float64], options: Options, *, is_thin: bool = False
) -> Row:
    """Measure an object and print a line; the overlap of a thin object is sampled, not counted in cells."""
    mesh = turned(upright, turn)
    started = time.process_time()
    found = fit(mesh)
    fit_seconds, fitted = time.process_time() - started, found.primitives
    grown = _inflated(mesh, fitted)
    solid = Solid(mesh)
    row = Row(
        name=name, fitted=fitted, kind=found.kind, grown=grown, fit_seconds=fit_seconds,
        inflate_seconds=best_s(lambda: _inflated(mesh, fitted), 2 if options.quick else 4),
        iou=sampled_iou(solid, fitted) if is_thin else volumetric_iou(solid, fitted),
        distance_pct=math.nan if is_thin else surface_distance_pct(solid, fitted),
        volume_ratio=grown_volume_ratio(solid, grown.primitives, MARGIN_M, cells=56 if options.quick else 96),
    )  # fmt: skip
    print(
        f"{name:<20} {fit_seconds:6.2f} s  K {len(fitted):2d} {found.kind:<8}  IoU {row.iou:.3f}  "
        f"distance {row.distance_pct:.2f} %  "
        f"inflated {1e3 * row.inflate_seconds:5.1f} ms, {row.volume_ratio:.2f} x, {row.state}"
    )
    return row


def fit(mesh: trimesh.Trimesh) -> Fitted:
    return fitted_shape(plain_mesh(mesh.vertices, mesh.faces), FitConfig())


def _inflated(mesh: trimesh.Trimesh, fitted: Superquadrics) -> Inflated:
    vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int32)
    return inflated(fitted, vertices, faces, np.empty((0, 3)), InflateConfig(r_safe_m=MARGIN_M))


def warm_up() -> None:
    """Load the compiled kernels: the work is measured, not the first call."""
    mesh = test_mesh("monitor")
    _inflated(mesh, fit(mesh).primitives)
    fit(test_mesh("torus"))


def rotation(rng: np.random.Generator) -> NDArray[np.float64]:
    return np.asarray(trimesh.transformations.random_rotation_matrix(rng.random(3)))


def turned(mesh: trimesh.Trimesh, turn: NDArray[np.float64]) -> trimesh.Trimesh:
    return mesh.copy().apply_transform(turn)


def of_diameter_one(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return a copy of a mesh, scaled to a diagonal of 1."""
    return mesh.copy().apply_scale(1 / float(np.linalg.norm(np.ptp(mesh.vertices, axis=0))))


def disturbed(mesh: trimesh.Trimesh, rng: np.random.Generator) -> Iterator[tuple[str, trimesh.Trimesh]]:
    yield "self_rotation", turned(mesh, rotation(rng))
    # Noise on a mesh of eight vertices would be another shape: edges of at most a twentieth first.
    vertices, faces = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, 0.05, max_iter=30)
    noise = trimesh.Trimesh(vertices, faces)
    noise.vertices = noise.vertices + rng.normal(size=noise.vertices.shape) * _NOISE
    yield "self_noise", noise
    yield "self_scale", mesh.copy().apply_scale(1 + rng.uniform(*_STRETCH, 3) * rng.choice([-1, 1], 3))
