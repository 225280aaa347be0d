"""The adapters of generators, against fakes of their packages: one wrong axis fails."""

from __future__ import annotations

import tomllib
from typing import TYPE_CHECKING

import numpy as np
import pytest

from hickory_stream.engine.generators.exchange import read_answer, write_question
from hickory_stream.engine.generators.spec import missing_of, read_spec
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.camera import Camera
from hickory_stream.ports import Crop, GeneratedMesh, NoShape, ShapeInputs
from tools.benchmarks import adapter_fakes
from tools.benchmarks.adapter_fakes import ADAPTERS, COLORS, FOLDER, POINTS, adapter_fault, faked

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("name", ADAPTERS)
def test_the_known_object_comes_out_where_and_as_it_is(name: str) -> None:
    assert adapter_fault(name) == ""


@pytest.mark.parametrize(
    ("name", "constant", "axis"),
    [("triposr", "CAMERA_FROM_MESH", 0), ("sam3d", "_OPENCV_FROM_PYTORCH3D", 1), ("sam3d", "_Z_UP_FROM_Y_UP", 2)],
)
def test_one_wrong_axis_is_found(name: str, constant: str, axis: int, monkeypatch: pytest.MonkeyPatch) -> None:
    real = adapter_fakes.faked

    def altered(which: str):  # type: ignore[no-untyped-def]
        context = real(which)
        module = context.__enter__()
        table = np.array(getattr(module, constant))
        table[axis] *= -1
        setattr(module, constant, table)
        return _Entered(context, module)

    monkeypatch.setattr(adapter_fakes, "faked", altered)
    assert adapter_fault(name) != ""


class _Entered:
    def __init__(self, context: object, module: object) -> None:
        self._context, self._module = context, module

    def __enter__(self) -> object:
        return self._module

    def __exit__(self, *error: object) -> None:
        self._context.__exit__(*error)  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", ADAPTERS)
def test_its_toml_describes_a_generator_and_says_what_is_missing_here(name: str) -> None:
    spec = read_spec(FOLDER / f"{name}.toml")
    assert spec.name == name
    assert "licence" in tomllib.loads((FOLDER / f"{name}.toml").read_text())
    assert any("program" in missing for missing in missing_of(spec))
    assert any("weights" in missing for missing in missing_of(spec))


def test_a_job_goes_through_an_adapter_and_back(tmp_path: Path) -> None:
    camera = Camera(width=80, height=60, fx=200.0, fy=200.0, cx=40.0, cy=30.0)
    mask = np.zeros((60, 80), bool)
    mask[25:45, 45:75] = True
    depth = np.where(mask, np.float32(2), np.float32(np.nan))
    rgb = np.full((60, 80, 3), 40, np.uint8)
    crop = Crop(rgb=rgb, depth_m=depth, mask=mask, camera=camera, world_from_camera=np.eye(4))
    inputs = ShapeInputs(
        crops=(crop,),
        points_world=POINTS.astype(np.float32),
        colors=COLORS,
        box=gravity_aligned_box(POINTS, 0.01),
        support_z_m=None,
    )
    job = write_question(tmp_path, inputs, 1)
    with faked("sam3d") as module:
        make, _ = module.load()
        module.answer = __import__("serving").answer
        module.answer(tmp_path, make)
    found = read_answer(tmp_path, job, 1)
    assert isinstance(found, GeneratedMesh)
    assert found.camera_from_mesh is not None
    placed = found.mesh.vertices @ found.camera_from_mesh[:3, :3].T + found.camera_from_mesh[:3, 3]
    assert np.allclose(placed, POINTS, atol=1e-5)
    assert np.array_equal(found.mesh.colors, COLORS)


def test_a_view_without_depth_is_no_shape_with_a_reason(tmp_path: Path) -> None:
    camera = Camera(width=80, height=60, fx=200.0, fy=200.0, cx=40.0, cy=30.0)
    nothing = np.full((60, 80), np.nan, np.float32)
    crop = Crop(
        rgb=np.zeros((60, 80, 3), np.uint8),
        depth_m=nothing,
        mask=np.ones((60, 80), bool),
        camera=camera,
        world_from_camera=np.eye(4),
    )
    inputs = ShapeInputs(
        crops=(crop,),
        points_world=np.zeros((0, 3), np.float32),
        colors=np.zeros((0, 3), np.uint8),
        box=gravity_aligned_box(POINTS, 0.01),
        support_z_m=None,
    )
    job = write_question(tmp_path, inputs, 1)
    with faked("triposr") as module:
        make, _ = module.load()
        __import__("serving").answer(tmp_path, make)
    found = read_answer(tmp_path, job, 1)
    assert found == NoShape(reason="no depth within the mask")
