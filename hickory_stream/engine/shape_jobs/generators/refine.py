"""A pose refiner that is any program, such as FoundationPose, beside the embedded placement.

The program needs a mesh of true size, which the embedded placement finds first. The program's pose in the best view is
another start of the embedded placement. The result with the lower cost stays.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hickory_stream.engine.shape_jobs.generators.exchange import read_pose, write_question
from hickory_stream.engine.shape_jobs.generators.process import GeneratorProcess
from hickory_stream.errors import WorkerError
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import apply, compose, from_rotation_translation
from hickory_stream.ports import MeshPlacement, NoShape, NotPlaced, PoseRefiner, ShapeInputs


class ExternalRefiner:
    """A `PoseRefiner` that asks a program; without an answer, the `embedded` one decides alone."""

    def __init__(self, process: GeneratorProcess, embedded: PoseRefiner) -> None:
        self.name = process.name
        self._embedded = embedded
        self._process = process

    def place(
        self, mesh: Mesh, inputs: ShapeInputs, guess: NDArray[np.float64] | None = None
    ) -> MeshPlacement | NotPlaced:
        """Return the mesh's pose in the world, or why it is unknown."""
        first = self._embedded.place(mesh, inputs, guess)
        if isinstance(first, NotPlaced):
            return first
        # Of true size and upright, about its own middle: what is left to say is a rotation and a place.
        placed = apply(first.world_from_mesh, mesh.vertices.astype(np.float64))
        middle = from_rotation_translation(np.eye(3), (placed.min(axis=0) + placed.max(axis=0)) / 2)
        model = replace(mesh, vertices=(placed - middle[:3, 3]).astype(np.float32))
        camera_from_model = self._asked(model, inputs)
        if camera_from_model is None:
            return first
        model_from_mesh = compose(from_rotation_translation(np.eye(3), -middle[:3, 3]), first.world_from_mesh)
        world_from_model = compose(inputs.crops[0].world_from_camera, camera_from_model)
        second = self._embedded.place(mesh, inputs, compose(world_from_model, model_from_mesh))
        return second if not isinstance(second, NotPlaced) and second.cost < first.cost else first

    def _asked(self, model: Mesh, inputs: ShapeInputs) -> NDArray[np.float64] | None:
        with tempfile.TemporaryDirectory(prefix="hickory-refiner-") as temporary:
            folder = Path(temporary).resolve()
            job = write_question(folder, inputs, 1, model)
            try:
                self._process.ask(folder, job)
                found = read_pose(folder, job)
            except WorkerError:
                # Its next answer may belong to the failed job.
                self._process.close()
                return None
        return None if isinstance(found, NoShape) else found
