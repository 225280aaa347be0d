"""A shape job: from the kept views and points of an object to its layers 2, 3 and 4."""

import time
from dataclasses import dataclass, field, replace
from typing import Literal, assert_never

import numpy as np
import scipy
from numpy.typing import NDArray

from hickory_stream.errors import ConfigError
from hickory_stream.geometry.lattice import MESH_STEPS_PER_M, on_steps
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.superquadric import Superquadrics, moved
from hickory_stream.geometry.superquadric_surface import surface_points
from hickory_stream.ports import (
    BuiltShape,
    MeshGenerator,
    NoShape,
    PoseRefiner,
    Reconstruction,
    Reconstructor,
    ShapeInputs,
)
from hickory_stream.shapes.fit.marching_primitives import FitConfig, fitted_shape
from hickory_stream.shapes.generated.judgement import JudgementConfig
from hickory_stream.shapes.generated.placement import EmbeddedPlacement, PlacementConfig
from hickory_stream.shapes.generated.reconstructor import GeneratedReconstructor
from hickory_stream.shapes.inflate.inflation import InflateConfig, inflate
from hickory_stream.shapes.mesh_validation import usable
from hickory_stream.shapes.reconstruct.fused import FusedConfig, FusedReconstructor
from hickory_stream.shapes.reconstruct.single_view import SingleViewConfig, SingleViewReconstructor

ReconstructorName = Literal["fused", "single_view", "external"]

_SURFACE_POINTS = 500


@dataclass(frozen=True, kw_only=True, slots=True)
class ShapeConfig:
    """`reconstructor` makes layer 2, "fused", "single_view" or "external"; the others configure the steps.

    "external" is the generator that `run.generator` names; `placement` and `judgement` are for its shapes.
    """

    reconstructor: ReconstructorName = "fused"
    fused: FusedConfig = field(default_factory=FusedConfig)
    single_view: SingleViewConfig = field(default_factory=SingleViewConfig)
    placement: PlacementConfig = field(default_factory=PlacementConfig)
    judgement: JudgementConfig = field(default_factory=JudgementConfig)
    # A reconstruction is accurate to about a centimetre; a finer grid would fit its noise and take longer.
    fit: FitConfig = field(default_factory=lambda: FitConfig(cells=40))
    inflate: InflateConfig = field(default_factory=InflateConfig)


def make_reconstructor(
    name: ReconstructorName,
    config: ShapeConfig,
    generator: MeshGenerator | None = None,
    refiner: PoseRefiner | None = None,
) -> Reconstructor:
    """Return the reconstructor of that name; "external" asks `generator`, and `refiner`, if any, for its place.

    Raises:
        ConfigError: "external" without a generator.
    """
    if name == "fused":
        return FusedReconstructor(config.fused)
    if name == "single_view":
        return SingleViewReconstructor(config.single_view)
    if name == "external":
        if generator is None:
            raise ConfigError("shapes.reconstructor is external, which needs a generator: name it in run.generator")
        return GeneratedReconstructor(
            generator,
            embedded=FusedReconstructor(config.fused),
            refiner=refiner or EmbeddedPlacement(config.placement),
            volume=config.fused.volume,
            judgement=config.judgement,
        )
    assert_never(name)


def build_shape(inputs: ShapeInputs, reconstructor: Reconstructor, config: ShapeConfig) -> BuiltShape | NoShape:
    """Return layers 2 to 4 of an object, or the reason why one of the steps failed."""
    started = time.perf_counter()
    reconstruction = reconstructor.reconstruct(inputs)
    if isinstance(reconstruction, NoShape):
        return replace(reconstruction, reason=f"{reconstructor.name}: {reconstruction.reason}")
    try:
        reconstruction = _usable(reconstruction)
    except ValueError as error:
        return NoShape(reason=f"{reconstructor.name}: {error}")
    meshed = time.perf_counter()
    try:
        fit = fitted_shape(reconstruction.mesh, config.fit)
        fitted = moved(fit.primitives, reconstruction.world_from_object)
    except ValueError as error:
        return NoShape(reason=f"fit: {error}")
    found = time.perf_counter()
    try:
        inflated, containment = inflate(fitted, reconstruction, inputs.points_world, config.inflate)
    except ValueError as error:
        return NoShape(reason=f"inflate: {error}")
    ended = time.perf_counter()
    return BuiltShape(
        reconstruction=reconstruction,
        fitted=fitted,
        inflated=inflated,
        seen_share=seen_shares(fitted, reconstruction),
        containment=containment,
        timings_s={"reconstruct": meshed - started, "fit": found - meshed, "inflate": ended - found},
        fit_kind=fit.kind,
    )


def _usable(reconstruction: Reconstruction) -> Reconstruction:
    # Vertices are put on steps first: the certificate is of the mesh that is stored.
    if not np.isfinite(reconstruction.world_from_object).all():
        raise ValueError("a mesh whose place is not finite")
    mesh = replace(reconstruction.mesh, vertices=on_steps(reconstruction.mesh.vertices, MESH_STEPS_PER_M))
    return replace(reconstruction, mesh=usable(mesh))


def seen_shares(primitives: Superquadrics, reconstruction: Reconstruction) -> NDArray[np.float64]:
    """Return (N,) the share of each primitive's surface, in the world, whose nearest vertex of the mesh was seen."""
    mesh = reconstruction.mesh
    tree = scipy.spatial.cKDTree(apply(reconstruction.world_from_object, mesh.vertices.astype(np.float64)))
    shares = np.empty(len(primitives))
    for i in range(len(primitives)):
        _, nearest = tree.query(surface_points(primitives, i, _SURFACE_POINTS))
        shares[i] = mesh.is_seen[nearest].mean()
    return shares
