from dataclasses import replace
import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from hickory_stream.geometry.mesh import is_closed
from hickory_stream.geometry.rigid import apply
from hickory_stream.ports import Reconstruction
from hickory_stream.shapes.generated.blend import blended
from hickory_stream.shapes.generated.distance_field import even_samples
from hickory_stream.shapes.reconstruct.fused import VolumeConfig
from tests.shapes.shape_fixtures import shape_inputs
from tools.evaluation.shapes.spoiled_generator import plain_mesh

VOLUME = VolumeConfig(cells=32)


def body(size, at=(0, 0, 0)):
    return trimesh.creation.box(size).apply_translation((at[0], at[1], at[2] + size[2] / 2))


@pytest.fixture(scope="module")
def inputs():
    """A box of 0.4 x 0.3 x 0.5 m, seen from one side."""
    return shape_inputs(body((0.4, 0.3, 0.5)), 2, azimuths_rad=(0.3, 0.9), noise=0.002)


def joined(made, inputs):
    mesh = plain_mesh(np.asarray(made.vertices), np.asarray(made.faces))
    answer = blended(Reconstruction(mesh=mesh, world_from_object=np.eye(4)), inputs, VOLUME)
    return answer, apply(answer.world_from_object, answer.mesh.vertices.astype(np.float64))


def test_it_passes_through_what_was_measured_and_keeps_the_rest(inputs):
    # 3 cm too wide all round: the seen sides are drawn in, the unseen back stays.
    answer, vertices = joined(body((0.46, 0.36, 0.5)), inputs)
    assert is_closed(answer.mesh)
    seen = vertices[answer.mesh.is_seen]
    true, _ = even_samples(body((0.4, 0.3, 0.5)).vertices, body((0.4, 0.3, 0.5)).faces.astype(np.int32), 20_000)
    gaps, _ = cKDTree(true).query(seen)
    assert np.quantile(gaps, 0.9) < 0.02
    assert 0.3 < answer.mesh.is_seen.mean() < 0.9
    # Cameras look from +x and +y.
    assert vertices[:, 0].max() < 0.22
    # Two voxels of 17 mm at most.
    assert -0.27 < vertices[:, 0].min() < -0.215


def test_shape_in_free_space_or_under_the_support_is_cut(inputs):
    shelf = trimesh.util.concatenate([body((0.4, 0.3, 0.5)), body((0.3, 0.1, 0.1), at=(0.3, 0, 0.3))])
    _, vertices = joined(shelf, inputs)
    assert vertices[:, 0].max() < 0.25
    _, vertices = joined(body((0.4, 0.3, 0.6), at=(0, 0, -0.1)), inputs)
    assert vertices[:, 2].min() > -0.02
    _, vertices = joined(body((0.4, 0.3, 0.6), at=(0, 0, -0.1)), replace(inputs, support_z_m=None))
    assert vertices[:, 2].min() < -0.05
