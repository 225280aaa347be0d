from dataclasses import replace
from typing import get_args
import numpy as np
import pytest
from scipy.spatial import cKDTree
from hickory_stream.box_scene import SCENE_BOXES
from hickory_stream.geometry.camera import backproject
from hickory_stream.geometry.mesh import is_closed, mesh_of_glb, sha256_of, volume_m3, write_glb
from hickory_stream.geometry.rigid import apply, is_rigid
from hickory_stream.map_folder.views import read_crop
from hickory_stream.ports import NoShape, Reconstruction, ShapeInputs
from hickory_stream.shapes.build import ReconstructorName, ShapeConfig, make_reconstructor
from hickory_stream.testing import BoxReconstructor
from tests.engine.run_fixtures import scene_request
from tests.examples.generators import box_generator
from tests.examples.hull_reconstructor import HullReconstructor

# The last of the boxes: which one the inputs are of.
TRUTH = SCENE_BOXES[-1]
TRUE_VOLUME_M3 = float(np.prod(np.array(TRUTH.high) - np.array(TRUTH.low)))


def reconstructors():
    ours = {name: make_reconstructor(name, ShapeConfig()) for name in ("fused", "single_view")}
    # One process of the generator serves all of them.
    ours["external"] = make_reconstructor("external", ShapeConfig(), box_generator())
    # A reconstructor of one's own adds its line here.
    return {**ours, "box": BoxReconstructor(), "hull": HullReconstructor()}


@pytest.fixture(scope="module", params=sorted(reconstructors()))
def reconstructor(request):
    return reconstructors()[request.param]


@pytest.fixture(scope="module", params=[1, 8])
def inputs(request, tmp_path_factory):
    """A box seen from one place, or from eight along an arc."""
    views = tmp_path_factory.mktemp("views")
    asked = scene_request(views, num_views=request.param)
    return ShapeInputs(
        crops=tuple(read_crop(views, view.name) for view in asked.views), points_world=asked.points_world,
        colors=asked.colors, box=asked.box, support_z_m=asked.support_z_m,
    )  # fmt: skip


@pytest.fixture(scope="module")
def answer(reconstructor, inputs):
    return made(reconstructor, inputs)


def made(reconstructor, inputs):
    answer = reconstructor.reconstruct(inputs)
    assert isinstance(answer, Reconstruction), answer
    return answer


def test_its_name_is_the_one_the_configuration_chooses_it_by():
    assert {name: reconstructor.name for name, reconstructor in reconstructors().items()} == {
        name: name for name in (*get_args(ReconstructorName), "box", "hull")
    }


def test_the_mesh_is_closed_coloured_and_says_what_was_seen(answer):
    mesh = answer.mesh
    assert is_closed(mesh)
    assert np.isfinite(mesh.vertices).all()
    assert mesh.faces.min() >= 0
    assert mesh.faces.max() < len(mesh.vertices)
    assert volume_m3(mesh) > 0
    assert mesh.colors.shape == (len(mesh.vertices), 3)
    assert mesh.is_seen.shape == (len(mesh.vertices),)
    # Nobody saw the bottom of a box on the floor, and everybody saw its front.
    assert 0 < mesh.is_seen.sum() < len(mesh.vertices)


def test_the_shape_has_the_place_and_size_of_the_object(answer):
    assert is_rigid(answer.world_from_object)
    vertices_world = apply(answer.world_from_object, answer.mesh.vertices.astype(np.float64))
    assert (vertices_world.min(axis=0) > np.array(TRUTH.low) - 0.08).all()
    assert (vertices_world.max(axis=0) < np.array(TRUTH.high) + 0.08).all()
    assert 0.4 * TRUE_VOLUME_M3 < volume_m3(answer.mesh) < 1.6 * TRUE_VOLUME_M3


def test_what_was_seen_lies_where_a_view_or_layer_1_has_a_point(answer, inputs):
    measured = np.concatenate([inputs.points_world, *(points_of(crop) for crop in inputs.crops)])
    seen_world = apply(answer.world_from_object, answer.mesh.vertices[answer.mesh.is_seen].astype(np.float64))
    distances_m, _ = cKDTree(measured).query(seen_world)
    assert np.quantile(distances_m, 0.95) < 0.03


def points_of(crop):
    """Return the (N, 3) points of the mask in the world."""
    points_camera = backproject(crop.depth_m, crop.camera)[crop.mask & np.isfinite(crop.depth_m)]
    return np.asarray(apply(crop.world_from_camera, points_camera))


def test_the_same_inputs_give_the_same_file_which_keeps_all(reconstructor, inputs, answer, tmp_path):
    again = made(reconstructors()[reconstructor.name], inputs)
    for name, made_shape in (("a", answer), ("b", again)):
        write_glb(made_shape.mesh, tmp_path / f"{name}.glb")
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()
    assert answer.world_from_object.tobytes() == again.world_from_object.tobytes()
    read, twice = (mesh_of_glb((tmp_path / "a.glb").read_bytes()) for _ in range(2))
    assert is_closed(read)
    assert read.is_seen.sum() == answer.mesh.is_seen.sum()
    assert sha256_of(read) == sha256_of(twice)


@pytest.mark.parametrize("crops", ["none", "blind"])
def test_a_hopeless_input_is_no_shape_with_a_reason(reconstructor, inputs, crops):
    blind = tuple(replace(crop, depth_m=np.full_like(crop.depth_m, np.nan)) for crop in inputs.crops)
    nothing = replace(
        inputs, crops=() if crops == "none" else blind, points_world=np.zeros((0, 3), np.float32),
        colors=np.zeros((0, 3), np.uint8),
    )  # fmt: skip
    answer = reconstructor.reconstruct(nothing)
    assert isinstance(answer, NoShape) and answer.reason
