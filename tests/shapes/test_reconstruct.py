from dataclasses import replace
from functools import cache
import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.lattice import MESH_STEPS_PER_M, packed_points
from hickory_stream.geometry.mesh import Mesh, is_closed, sha256_of, volume_m3
from hickory_stream.geometry.rigid import apply, from_rotation_translation
from hickory_stream.ports import NoShape, Reconstruction, ShapeInputs
from hickory_stream.shapes.build import ShapeConfig, build_shape, make_reconstructor, seen_shares
from hickory_stream.shapes.generated.blend import blended
from hickory_stream.shapes.generated.distance_field import even_samples
from hickory_stream.shapes.reconstruct.fused import VolumeConfig
from tests.shapes.shape_fixtures import occupancy_iou, shape_inputs, test_mesh
from tests.strategies import quadric
from tools.evaluation.shapes.spoiled_generator import plain_mesh

CONFIG = ShapeConfig()


@cache
def seen(name, num_views):
    return shape_inputs(test_mesh(name), num_views)


@cache
def made_of(reconstructor, name, num_views):
    return reconstructed(reconstructor, seen(name, num_views))


def reconstructed(name, inputs):
    return make_reconstructor(name, CONFIG).reconstruct(inputs)


def vertices_world(made):
    return apply(made.world_from_object, made.mesh.vertices.astype(np.float64))


@pytest.mark.parametrize(
    ("name", "iou"),
    [("box", 0.93), ("cylinder", 0.93), ("sphere", 0.9), ("mug", 0.85), ("chair", 0.65), ("table", 0.65)],
)
def test_eight_views_give_a_closed_mesh_close_to_the_truth(name, iou):
    made = made_of("fused", name, 8)
    assert is_closed(made.mesh)
    assert volume_m3(made.mesh) > 0
    assert len(made.mesh.faces) <= 30_000
    assert occupancy_iou(test_mesh(name), vertices_world(made), made.mesh.faces) >= iou


@pytest.mark.parametrize(
    ("name", "iou"), [("box", 0.6), ("cylinder", 0.7), ("sphere", 0.65), ("mug", 0.65), ("chair", 0.5)]
)
def test_one_view_gives_a_closed_mesh_of_about_the_right_shape(name, iou):
    made = made_of("single_view", name, 1)
    assert is_closed(made.mesh)
    assert occupancy_iou(test_mesh(name), vertices_world(made), made.mesh.faces) >= iou


def test_a_chair_seen_from_one_side_does_not_become_a_block():
    chair = test_mesh("chair")
    made = reconstructed("fused", shape_inputs(chair, 3, azimuths_rad=(0.3, 1.5)))
    truth = sum(part.volume for part in chair.split())
    assert volume_m3(made.mesh) < 2 * truth


@pytest.mark.parametrize("name", ["cylinder", "bottle"])
def test_what_is_round_and_seen_from_one_side_is_completed(name):
    made = reconstructed("fused", shape_inputs(test_mesh(name), 2, azimuths_rad=(0.3, 0.5), elevation_rad=0.2))
    assert is_closed(made.mesh)
    assert occupancy_iou(test_mesh(name), vertices_world(made), made.mesh.faces) >= 0.8


def test_the_unseen_bottom_is_generated_and_the_seen_top_is_seen():
    made = made_of("fused", "box", 8)
    z = vertices_world(made)[:, 2]
    assert made.mesh.is_seen[z > 0.25].mean() > 0.95
    inner_bottom = (z < 0.01) & (np.abs(vertices_world(made)[:, :2]) < 0.1).all(axis=1)
    assert not made.mesh.is_seen[inner_bottom].any()


def test_seen_vertices_have_the_colour_of_the_object():
    made = made_of("fused", "sphere", 8)
    assert np.abs(made.mesh.colors.astype(int) - (200, 120, 40)).max() <= 2


def test_the_object_frame_is_centred_in_the_meshs_box():
    made = made_of("fused", "shelf", 4)
    low, high = made.mesh.vertices.min(axis=0), made.mesh.vertices.max(axis=0)
    assert low + high == pytest.approx(np.zeros(3), abs=1e-4)
    assert made.world_from_object[:3, 2] == pytest.approx([0, 0, 1])


def test_single_view_uses_nothing_but_the_best_view():
    all_views = shape_inputs(test_mesh("cylinder"), 4)
    alone = ShapeInputs(
        crops=all_views.crops[:1], points_world=all_views.points_world[:1], colors=all_views.colors[:1],
        box=gravity_aligned_box(all_views.points_world[:1], 0.1), support_z_m=all_views.support_z_m,
    )  # fmt: skip
    first, second = reconstructed("single_view", all_views), reconstructed("single_view", alone)
    assert sha256_of(first.mesh) == sha256_of(second.mesh)


def test_points_alone_still_make_a_shape():
    box = seen("box", 8)
    inputs = ShapeInputs(crops=(), points_world=box.points_world, colors=box.colors, box=box.box, support_z_m=0.0)
    assert is_closed(reconstructed("fused", inputs).mesh)


@pytest.mark.parametrize("reconstructor", ["fused", "single_view"])
def test_too_little_is_no_shape_and_says_why(reconstructor):
    inputs = ShapeInputs(
        crops=(), points_world=np.zeros((3, 3)), colors=np.zeros((3, 3)),
        box=gravity_aligned_box(np.zeros((3, 3)), 0.1), support_z_m=None,
    )  # fmt: skip
    assert build_shape(inputs, make_reconstructor(reconstructor, CONFIG), CONFIG).reason.startswith(reconstructor)


@pytest.mark.parametrize("reconstructor", ["fused", "single_view"])
def test_a_build_has_all_layers_and_contains_the_object(reconstructor):
    built = build_shape(shape_inputs(test_mesh("monitor"), 4), make_reconstructor(reconstructor, CONFIG), CONFIG)
    assert not isinstance(built, NoShape)
    assert 1 <= len(built.seen_share) == len(built.fitted) <= len(built.inflated)
    assert ((built.seen_share >= 0) & (built.seen_share <= 1)).all()
    assert built.containment.num_outside <= 0.001 * built.containment.num_checked
    assert set(built.timings_s) == {"reconstruct", "fit", "inflate"}
    # What was certified is what is stored, in half of the bytes.
    assert packed_points(built.reconstruction.mesh.vertices, MESH_STEPS_PER_M) is not None


@pytest.mark.parametrize(("cut", "share"), [(-1.0, 1.0), (0.0, 0.5), (0.25, 0.25), (1.0, 0.0)])
def test_the_seen_share_is_that_of_the_area(cut, share):
    # Of a ball, the area above a height is proportional to what is left of the diameter.
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    place = from_rotation_translation(np.eye(3), np.array([2.0, -1.0, 0.5]))
    reconstruction = Reconstruction(
        mesh=Mesh(
            vertices=ball.vertices.astype(np.float32), faces=ball.faces.astype(np.int32),
            colors=np.zeros((len(ball.vertices), 3), np.uint8), is_seen=np.asarray(ball.vertices[:, 2] > cut),
        ),
        world_from_object=place,
    )  # fmt: skip
    fitted = quadric((1.0, 1.0), (0.5, 0.5, 0.5), place)
    assert seen_shares(fitted, reconstruction) == pytest.approx([share], abs=0.02)


VOLUME = VolumeConfig(cells=32)


def body(size, at=(0, 0, 0)):
    return trimesh.creation.box(size).apply_translation((at[0], at[1], at[2] + size[2] / 2))


@pytest.fixture(scope="module")
def seen_box():
    """A box of 0.4 x 0.3 x 0.5 m, seen from one side."""
    return shape_inputs(body((0.4, 0.3, 0.5)), 2, azimuths_rad=(0.3, 0.9), noise=0.002)


def joined(made, seen_box):
    mesh = plain_mesh(np.asarray(made.vertices), np.asarray(made.faces))
    answer = blended(Reconstruction(mesh=mesh, world_from_object=np.eye(4)), seen_box, VOLUME)
    return answer, apply(answer.world_from_object, answer.mesh.vertices.astype(np.float64))


def test_it_passes_through_what_was_measured_and_keeps_the_rest(seen_box):
    # 3 cm too wide all round: the seen sides are drawn in, the unseen back stays.
    answer, vertices = joined(body((0.46, 0.36, 0.5)), seen_box)
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


def test_shape_in_free_space_or_under_the_support_is_cut(seen_box):
    shelf = trimesh.util.concatenate([body((0.4, 0.3, 0.5)), body((0.3, 0.1, 0.1), at=(0.3, 0, 0.3))])
    _, vertices = joined(shelf, seen_box)
    assert vertices[:, 0].max() < 0.25
    _, vertices = joined(body((0.4, 0.3, 0.6), at=(0, 0, -0.1)), seen_box)
    assert vertices[:, 2].min() > -0.02
    _, vertices = joined(body((0.4, 0.3, 0.6), at=(0, 0, -0.1)), replace(seen_box, support_z_m=None))
    assert vertices[:, 2].min() < -0.05
