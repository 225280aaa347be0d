"""Layer 2 by a generator that knows neither place nor size: placed, judged, and joined with what was seen.

The embedded shape is always made. The generated one replaces it only where the views say that it is the object, where
it contradicts them no more, and where it foretold as much of what other views saw; the verdict has the numbers.
"""

from dataclasses import replace

import numpy as np

from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import apply, compose, invert
from hickory_stream.ports import (
    GeneratedMesh,
    MeshGenerator,
    MeshPlacement,
    NoShape,
    NotPlaced,
    PoseRefiner,
    Reconstruction,
    Reconstructor,
    ShapeInputs,
)
from hickory_stream.shapes.generated.blend import blended
from hickory_stream.shapes.generated.judgement import JudgementConfig, by_other_views, judged, replaces, shape_evidence
from hickory_stream.shapes.mesh_validation import usable
from hickory_stream.shapes.reconstruct.fused import VolumeConfig

_MIN_POINTS = 20


class GeneratedReconstructor:
    """Asks a generator, and falls back on the `embedded` reconstructor."""

    name = "external"

    def __init__(
        self,
        generator: MeshGenerator,
        *,
        embedded: Reconstructor,
        refiner: PoseRefiner,
        volume: VolumeConfig,
        judgement: JudgementConfig,
    ) -> None:
        self._generator = generator
        self._embedded = embedded
        self._refiner = refiner
        self._volume = volume
        self._judgement = judgement

    def reconstruct(self, inputs: ShapeInputs) -> Reconstruction | NoShape:
        """Return the generated shape where it earned its place, else the embedded one; or why there is neither."""
        embedded = self._embedded.reconstruct(inputs)
        if not inputs.crops or len(inputs.points_world) < _MIN_POINTS:
            return embedded
        made = self._generator.generate(inputs)
        if isinstance(made, NoShape):
            return self._kept(embedded, made.reason, hit_limit=made.hit_limit)
        placed = self._placed(made, inputs)
        if isinstance(placed, NoShape):
            return self._kept(embedded, placed.reason)
        evidence = shape_evidence(placed, inputs, made.num_views)
        if evidence is None:
            return self._kept(embedded, "no view measured the object")
        verdict = judged(evidence)
        if not verdict.is_accepted:
            return self._kept(embedded, verdict.reason)
        joined = blended(placed, inputs, self._volume)
        if isinstance(joined, NoShape):
            return self._kept(embedded, joined.reason)
        final = shape_evidence(joined, inputs, made.num_views)
        own = None
        if isinstance(embedded, Reconstruction):
            own = shape_evidence(embedded, inputs, len(inputs.crops))
        text = f"{self._generator.name}: {verdict.reason}, {placed.verdict}"
        if final is not None and own is not None:
            better = replaces(final, own, self._judgement)
            if not better.is_accepted:
                return self._kept(embedded, better.reason)
            text += f"; blended {better.reason}"
        foretold = by_other_views(placed, inputs, made.num_views, self._embedded)
        if foretold is not None:
            if not foretold.is_accepted and isinstance(embedded, Reconstruction):
                return self._kept(embedded, foretold.reason)
            text += f"; {foretold.reason}"
        return replace(joined, made_by=self._generator.name, verdict=text)

    def _kept(
        self, embedded: Reconstruction | NoShape, reason: str, *, hit_limit: bool = False
    ) -> Reconstruction | NoShape:
        reason = f"{self._generator.name}: {reason}"
        if isinstance(embedded, NoShape):
            return NoShape(reason=f"{embedded.reason}; {reason}", hit_limit=hit_limit)
        return replace(embedded, made_by=self._embedded.name, verdict=reason, hit_limit=hit_limit)

    def _placed(self, made: GeneratedMesh, inputs: ShapeInputs) -> Reconstruction | NoShape:
        try:
            mesh = usable(made.mesh)
        except ValueError as error:
            return NoShape(reason=str(error))
        guess = None
        if made.camera_from_mesh is not None:
            guess = compose(inputs.crops[0].world_from_camera, made.camera_from_mesh)
        placement = self._refiner.place(mesh, inputs, guess)
        if isinstance(placement, NotPlaced):
            return NoShape(reason=placement.reason)
        vertices = apply(placement.world_from_mesh, mesh.vertices.astype(np.float64))
        world_from_object = gravity_aligned_box(vertices, 1e-4).world_from_box
        own = Mesh(
            vertices=apply(invert(world_from_object), vertices),
            faces=mesh.faces,
            colors=mesh.colors,
            is_seen=np.zeros(len(vertices), bool),
        )
        return Reconstruction(mesh=own, world_from_object=world_from_object, verdict=placement_text(placement))


def placement_text(placement: MeshPlacement) -> str:
    """Return how a mesh was placed, for people."""
    stretch = float(placement.stretch.max() / placement.stretch.min())
    turned = ", symmetric" if placement.is_symmetric else ""
    stretched = f", stretched by {stretch:.2f}" if stretch > 1.001 else ""
    return (
        f"placed at {placement.scale:.3g} of its size{stretched}, +-{100 * placement.sigma_m:.1f} cm"
        f"{turned}, cost {placement.cost:.2f}"
    )
