import subprocess
import tomllib
from contextlib import contextmanager
import numpy as np
import pytest
from hickory_stream.engine.shape_jobs.generators.exchange import read_answer, write_question
from hickory_stream.engine.shape_jobs.generators.spec import missing_of, read_spec
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.camera import Camera
from hickory_stream.ports import Crop, NoShape, ShapeInputs
from tools.generators.fakes import packages as adapter_fakes
from tools.generators.fakes.graphs import graph_fault
from tools.generators.fakes.packages import (
    ADAPTERS,
    COLORS,
    FACES,
    FOLDER,
    POINTS,
    REFINERS,
    K,
    adapter_fault,
    faked,
    refiner_fault,
    shown_view,
)


def alter(monkeypatch, change):
    """Change the module of every adapter that is made with fakes from now on."""
    real = adapter_fakes.faked

    @contextmanager
    def altered(name):
        with real(name) as module:
            change(module)
            yield module

    monkeypatch.setattr(adapter_fakes, "faked", altered)


@pytest.mark.parametrize(
    ("name", "constant", "axis"),
    [("triposr", "CAMERA_FROM_MESH", 0), ("sam3d", "_OPENCV_FROM_PYTORCH3D", 1), ("sam3d", "_Z_UP_FROM_Y_UP", 2)],
)
def test_one_wrong_axis_is_found(name, constant, axis, monkeypatch):
    def turn(module):
        table = np.array(getattr(module, constant))
        table[axis] *= -1
        setattr(module, constant, table)

    alter(monkeypatch, turn)
    assert adapter_fault(name) != ""


def _needs_of(name):
    if name == "foundationpose_onnx":
        pytest.importorskip("embreex", reason="it has no wheel for Linux on ARM")


@pytest.mark.parametrize("name", [*ADAPTERS, *REFINERS])
def test_the_known_object_comes_out_where_and_as_it_is(name):
    _needs_of(name)
    assert (adapter_fault if name in ADAPTERS else refiner_fault)(name) == ""


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_one_wrong_axis_of_a_refiner_is_found(axis, monkeypatch):
    def turn(module):
        module.CAMERA_FROM_OPENCV = np.diag([-1.0 if i == axis else 1.0 for i in range(3)])

    alter(monkeypatch, turn)
    assert "off its place" in refiner_fault("foundationpose")


def test_foundation_pose_is_refused_with_too_little_depth():
    with faked("foundationpose") as module:
        place, _ = module.load()
        view = shown_view(module)
        model = module.Model(vertices=POINTS, faces=FACES)
        empty = type(view)(rgb=view.rgb, mask=view.mask, depth_m=0 * view.depth_m, K=view.K, seed=1)
        with pytest.raises(module.NoShapeError, match="fewer than 4 pixels"):
            place(empty, model)
        # Its filters may leave less than was given: then the rotation is the identity, as here for the object itself.
        with pytest.raises(module.NoShapeError, match="too little depth"):
            place(view, module.Model(vertices=POINTS - POINTS.mean(axis=0), faces=FACES))


@pytest.mark.parametrize("exchanged", ["INPUTS", "MOVES", "TURN", "blue first", "y up"])
def test_exchanged_onnx_crops_and_answers_give_other_results(exchanged):
    _needs_of("foundationpose_onnx")
    with faked("foundationpose_onnx") as module:
        crop = module.six_channels
        others = {
            "INPUTS": module.INPUTS[::-1], "MOVES": module.MOVES[::-1], "TURN": -module.TURN,
            "blue first": lambda *given: crop(*given)[..., [2, 1, 0, 3, 4, 5]],
            "y up": lambda *given: crop(*given) * np.float32([1, 1, 1, 1, -1, 1]),
        }  # fmt: skip
        setattr(module, exchanged if exchanged.isupper() else "six_channels", others[exchanged])
        assert "off its place" in graph_fault(module)


def test_the_first_poses_of_the_onnx_files_look_from_everywhere():
    with faked("foundationpose_onnx") as module:
        turns = module.rotations()
        view = shown_view(module)
        poses = module.first_poses(view)
        empty = type(view)(rgb=view.rgb, mask=view.mask, depth_m=0 * view.depth_m, K=view.K, seed=1)
        with pytest.raises(module.NoShapeError, match="fewer than 4 pixels"):
            module.first_poses(empty)
    assert turns.shape == (252, 3, 3)
    assert np.allclose(turns @ turns.transpose(0, 2, 1), np.eye(3))
    cosines = (np.einsum("nij,mij->nm", turns, turns) - 1) / 2
    # NVIDIA's pipeline drops those within 30 degrees of another one: there are none.
    assert np.degrees(np.arccos(np.clip(cosines - 2 * np.eye(252), -1, 1).max())) > 30
    # The middle of the rectangle of `shown_view` is at column 59.5, row 34.5, and 2 m away.
    assert np.allclose(poses[:, :3, 3], [(59.5 - 40) / 100, (34.5 - 30) / 100, 2])


def test_a_crop_renders_as_observed_up_to_half_a_pixel():
    _needs_of("foundationpose_onnx")
    with faked("foundationpose_onnx") as module:
        # A wall of one colour, 2 m away; a radius of it is 1 m.
        wall = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]]) / np.sqrt(2)
        colors = np.full((4, 3), 100, np.uint8)
        faces = np.array([[0, 2, 1], [0, 3, 2]])
        subject = module.subject_of(module.Model(vertices=wall + np.array([5, 6, 7]), faces=faces, colors=colors))
        pose = np.eye(4)
        pose[:3, 3] = 0, 0, 2
        color, xyz = module._rendered(pose, subject, np.array([20, 10, 60, 50]), K)
    assert np.allclose(subject.middle, (5, 6, 7))
    assert subject.diameter_m == pytest.approx(2)
    # It faces the camera: lit by 0.8 + 0.5.
    assert np.allclose(color, 100 / 255 * 1.3)
    first, last = xyz[0, 0], xyz[-1, -1]
    left, right = 20 + 0.5 * 40 / 160 * 159 / 160, 20 + 159.5 * 40 / 160 * 159 / 160
    assert np.allclose(first, [(left - 40) / 100, (left - 10 - 30) / 100, 2], atol=1e-5)
    assert np.allclose(last, [(right - 40) / 100, (right - 10 - 30) / 100, 2], atol=1e-5)
    six = module.six_channels(color, xyz, pose, subject)
    assert six.dtype == np.float32
    assert np.allclose(six[0, 0, 3:], [*first[:2], 0], atol=1e-5)
    assert not module.six_channels(color, 0 * xyz, pose, subject)[..., 3:].any()
    pose[2, 3] = 4.5
    assert not module.six_channels(color, xyz, pose, subject)[..., 3:].any()


@pytest.mark.parametrize("name", [*ADAPTERS, *REFINERS])
def test_its_toml_describes_a_generator_and_what_is_missing(name):
    spec = read_spec(FOLDER / f"{name}.toml")
    assert spec.name == name
    assert "licence" in tomllib.loads((FOLDER / f"{name}.toml").read_text())
    assert any("program" in missing for missing in missing_of(spec))
    assert any("weights" in missing for missing in missing_of(spec))


def answered(folder, name, mask, depth_m, points, colors):
    """Return what an adapter makes of a job of one view."""
    camera = Camera(width=80, height=60, fx=200.0, fy=200.0, cx=40.0, cy=30.0)
    rgb = np.full((60, 80, 3), 40, np.uint8)
    crop = Crop(rgb=rgb, depth_m=depth_m, mask=mask, camera=camera, world_from_camera=np.eye(4))
    box = gravity_aligned_box(POINTS, 0.01)
    inputs = ShapeInputs(
        crops=(crop,), points_world=points.astype(np.float32), colors=colors, box=box, support_z_m=None
    )
    job = write_question(folder, inputs, 1)
    with faked(name) as module:
        make, _ = module.load()
        __import__("serving").answer(folder, make)
    return read_answer(folder, job, 1)


def test_a_job_goes_through_an_adapter_and_back(tmp_path):
    mask = np.zeros((60, 80), bool)
    mask[25:45, 45:75] = True
    found = answered(tmp_path, "sam3d", mask, np.where(mask, np.float32(2), np.float32(np.nan)), POINTS, COLORS)
    placed = found.mesh.vertices @ found.camera_from_mesh[:3, :3].T + found.camera_from_mesh[:3, 3]
    assert np.allclose(placed, POINTS, atol=1e-5)
    assert np.array_equal(found.mesh.colors, COLORS)


def test_a_view_without_depth_is_no_shape_with_a_reason(tmp_path):
    nothing, none = np.full((60, 80), np.nan, np.float32), np.zeros((0, 3), np.uint8)
    found = answered(tmp_path, "triposr", np.ones((60, 80), bool), nothing, none, none)
    assert found == NoShape(reason="no depth within the mask")


def test_the_installation_of_each_adapter_is_a_script():
    script = FOLDER / "install"
    assert subprocess.run(["bash", "-n", script], check=False).returncode == 0
    said = subprocess.run(["bash", script, "another"], capture_output=True, text=True, check=False)
    assert said.returncode == 2
    assert said.stderr.strip().endswith("triposr|trellis|sam3d|foundationpose|foundationpose_onnx")
    assert set(said.stderr.split()[-1].split("|")) == {*ADAPTERS, *REFINERS}
