"""The outcome for a generated shape: blended and fused surface beside the truth, and which of the two is kept."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hickory_stream.evaluation.exposed import exposed_samples
from hickory_stream.evaluation.surface_score import diameter_m
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import apply
from hickory_stream.ports import MeshPlacement, Reconstruction
from hickory_stream.shapes.generated.blend import blended
from hickory_stream.shapes.generated.distance_field import even_samples
from hickory_stream.shapes.generated.judgement import (
    JudgementConfig,
    ShapeEvidence,
    by_other_views,
    judged,
    replaces,
    shape_evidence,
)
from hickory_stream.shapes.reconstruct.fused import FusedConfig, FusedReconstructor, VolumeConfig
from tools.evaluation.shapes.spoiled_generator import Generated, Sighted, plain_mesh

_SAMPLES = 3000


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Row:
    """One trial: the generated mesh, its placement, and how near to the truth that is."""

    kind: str
    given: Generated
    placement: MeshPlacement | None
    adds: float
    scale_error: float
    seconds: float
    f1: float
    evidence: ShapeEvidence | None
    seen: Sighted

    @property
    def is_accepted(self) -> bool:
        return self.evidence is not None and judged(self.evidence, JudgementConfig()).is_accepted


@dataclass(frozen=True, kw_only=True, slots=True)
class Outcome:
    """F1 of both shapes of an object, and whether the blended one takes the place of the fused one."""

    blended: float
    fused: float
    is_kept: bool


def exposed(mesh: Mesh) -> NDArray[np.float64]:
    """Return (N, 3) samples of the surface of a mesh that is visible from outside: models have parts within others."""
    # A mesh that is made of a solid has none of the inner surface: with it in the truth, the F1 of a bed is at most
    # 0.87.
    return exposed_samples(mesh, 2 * _SAMPLES, np.random.default_rng(0))[0][:_SAMPLES].astype(np.float64)


def placed_mesh(mesh: Mesh, placement: MeshPlacement) -> Mesh:
    return plain_mesh(apply(placement.world_from_mesh, mesh.vertices.astype(np.float64)), mesh.faces)


def f1_at(true: NDArray[np.float64], found: NDArray[np.float64], reach_m: float) -> float:
    """Return F1 of two sets of (N, 3) surface samples at a distance."""
    recall = float((cKDTree(found).query(true)[0] <= reach_m).mean())
    precision = float((cKDTree(true).query(found)[0] <= reach_m).mean())
    return 2 * recall * precision / (recall + precision) if recall + precision > 0 else 0.0


def outcome_of(row: Row) -> Outcome | None:
    """Return the outcome for an object; None where the generated shape is refused, or either fails."""
    if row.placement is None or not row.is_accepted:
        return None
    config, inputs = JudgementConfig(), row.seen.made_from
    world = Reconstruction(mesh=placed_mesh(row.given.mesh, row.placement), world_from_object=np.eye(4))
    embedded = FusedReconstructor(FusedConfig())
    made, fused = blended(world, inputs, VolumeConfig()), embedded.reconstruct(inputs)
    if not (isinstance(made, Reconstruction) and isinstance(fused, Reconstruction)):
        return None
    final, own = shape_evidence(made, inputs, 1, config), shape_evidence(fused, inputs, len(inputs.crops), config)
    is_kept = final is None or own is None or replaces(final, own, config).is_accepted
    foretold = by_other_views(world, inputs, 1, embedded, config)
    is_kept &= foretold is None or foretold.is_accepted
    return Outcome(blended=_f1_of(made, row.seen), fused=_f1_of(fused, row.seen), is_kept=is_kept)


def _f1_of(shape: Reconstruction, seen: Sighted) -> float:
    found, _ = even_samples(shape.mesh.vertices, shape.mesh.faces, _SAMPLES)
    found = apply(shape.world_from_object, found)
    return f1_at(exposed(seen.mesh_world), found, 0.05 * diameter_m(seen.mesh_world.vertices))
