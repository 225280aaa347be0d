import json
from dataclasses import dataclass, field, replace
from typing import Any
import numpy as np
import pytest
from hickory_stream.box_scene import SCENE_CAMERA, scene_pose
from hickory_stream.engine.shape_jobs.generators.refine import ExternalRefiner
from hickory_stream.engine.shape_jobs.generators.spec import check_licence, fingerprint, read_spec, refiner_of
from hickory_stream.errors import ConfigError, WorkerError
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import apply, yaw_rotation
from hickory_stream.ports import Crop, MeshPlacement, ShapeInputs

CORNERS = np.array([[0, 0, 0], [3, 0, 0], [0, 2, 0], [0, 0, 1]], np.float32)
MESH = Mesh(
    vertices=CORNERS, faces=np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32),
    colors=np.zeros((4, 3), np.uint8), is_seen=np.ones(4, bool),
)  # fmt: skip
FIRST = np.eye(4)
FIRST[:3, :3], FIRST[:3, 3] = 0.1 * np.diag([1.0, 1.2, 1.0]), (1.0, 2.0, 0.5)
TOLD = np.eye(4)
TOLD[:3, :3], TOLD[:3, 3] = yaw_rotation(0.3), (0.1, -0.2, 1.5)


@dataclass
class Embedded:
    """Believes a guess where `cost_of_guess` is below 1."""

    cost_of_guess: float
    guesses: list[Any] = field(default_factory=list)
    name: str = "embedded"

    def place(self, mesh, inputs, guess=None):
        del mesh, inputs
        self.guesses.append(guess)
        found = MeshPlacement(
            world_from_mesh=FIRST, scale=0.1, stretch=np.ones(3), stretch_axes=np.eye(3), cost=1.0, sigma_m=0.01,
            sigma_rad=0.01, sigma_scale=0.01, is_symmetric=False, margin=0.5,
        )  # fmt: skip
        return found if guess is None else replace(found, world_from_mesh=guess, cost=self.cost_of_guess)


@dataclass
class Program:
    """Answers with `said`, for the job that it was given, and keeps the model that it was shown."""

    said: dict[str, Any]
    model: Any = None
    colors: Any = None
    is_closed: bool = False
    name: str = "program"

    def ask(self, folder, job):
        with np.load(folder / "model.npz") as content:
            self.model, self.colors = content["vertices"], content["colors"]
        (folder / "result.json").write_text(json.dumps({"job": job, **self.said}))

    def close(self):
        self.is_closed = True


def given():
    depth = np.full((SCENE_CAMERA.height, SCENE_CAMERA.width), 2.0, np.float32)
    crop = Crop(
        rgb=np.zeros((*depth.shape, 3), np.uint8), depth_m=depth, mask=np.ones(depth.shape, bool), camera=SCENE_CAMERA,
        world_from_camera=scene_pose(3),
    )  # fmt: skip
    points = np.zeros((1, 3), np.float32)
    return ShapeInputs(
        crops=(crop,), points_world=points, colors=points.astype(np.uint8), box=gravity_aligned_box(CORNERS, 0.01),
        support_z_m=None,
    )  # fmt: skip


@pytest.mark.parametrize("cost", [0.5, 1.5])
def test_the_pose_that_is_contradicted_less_stays(cost):
    program, embedded = Program({"camera_from_mesh": TOLD.tolist()}), Embedded(cost)
    found = ExternalRefiner(program, embedded).place(MESH, given())
    placed = apply(FIRST, CORNERS.astype(np.float64))
    middle = (placed.min(axis=0) + placed.max(axis=0)) / 2
    # It is shown the mesh as large as it was placed, about its own middle.
    assert program.model == pytest.approx(placed - middle, abs=1e-6)
    assert np.array_equal(program.colors, MESH.colors)
    expected = apply(scene_pose(3) @ TOLD, placed - middle)
    assert embedded.guesses[0] is None
    assert apply(embedded.guesses[1], CORNERS.astype(np.float64)) == pytest.approx(expected, abs=1e-6)
    assert found.cost == min(cost, 1.0)


@pytest.mark.parametrize(
    "said", [{}, {"camera_from_mesh": (2 * TOLD).tolist()}, {"camera_from_mesh": TOLD.tolist(), "job": "another"}]
)
def test_an_answer_that_is_not_a_rigid_pose_changes_nothing(said):
    program, embedded = Program(said), Embedded(0.1)
    found = ExternalRefiner(program, embedded).place(MESH, given())
    assert (found.cost, len(embedded.guesses), program.is_closed) == (1.0, 1, True)


def test_a_program_that_crashes_leaves_the_embedded_placement(monkeypatch):
    program = Program({})

    def crash(folder, job):
        raise WorkerError(f"crashed over {job} in {folder}")

    monkeypatch.setattr(program, "ask", crash)
    assert ExternalRefiner(program, Embedded(0.1)).place(MESH, given()).cost == 1.0


def test_a_generators_refiner_counts_with_licence_and_content(tmp_path):
    generator, refiner = tmp_path / "g.toml", tmp_path / "r.toml"
    generator.write_text('name = "g"\ncommand = ["python"]\nacceptance = "one"\nrefiner = "r.toml"\n')
    refiner.write_text('name = "r"\ncommand = ["python"]\nacceptance = "two"\n')
    spec = read_spec(generator)
    before, found = fingerprint(spec), refiner_of(spec)
    for each in (spec, found):
        check_licence(each, "one; two")
    with pytest.raises(ConfigError, match=r'run\.accept_licence = "two"'):
        check_licence(found, "one")
    refiner.write_text('name = "r2"\ncommand = ["python"]\n')
    assert fingerprint(spec) != before
    refiner.write_text('name = "r"\ncommand = ["python"]\nrefiner = "g.toml"\n')
    with pytest.raises(ConfigError, match="it can have none"):
        refiner_of(spec)
