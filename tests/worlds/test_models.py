import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hickory_stream.geometry.mesh import is_closed, sha256_of, volume_m3
from hickory_stream.geometry.rigid import is_rigid
from hickory_stream.worlds import furniture, small_things
from hickory_stream.worlds.object_models import ellipsoid, lathe, model_mesh, rounded_box, tube
from hickory_stream.worlds.room import furnished_room
from hickory_stream.worlds.scene import part_boxes, shared_volume_m3
from hickory_stream.worlds.textures import Texture, colors_at
from hickory_stream.worlds.trajectory import WalkConfig, camera_rotation, walk_round
from tests.shapes.shape_fixtures import as_mesh

GREY = Texture(pattern="plain", first=(0.5, 0.5, 0.5), second=(0.5, 0.5, 0.5), grain=0.0)
MAKERS = [
    furniture.table, furniture.desk, furniture.chair, furniture.sofa, furniture.shelf, furniture.lamp, furniture.plant,
    furniture.bin_, small_things.monitor, small_things.box, small_things.small_box, small_things.mug,
    small_things.bottle, small_things.bowl, small_things.book_stack, small_things.book_row,
]  # fmt: skip


@pytest.mark.parametrize("maker", MAKERS)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_every_part_of_every_kind_is_a_closed_solid_on_its_base(maker, seed):
    model = maker(np.random.default_rng(seed))
    for part in model.parts:
        assert is_closed(as_mesh(part))
        assert volume_m3(as_mesh(part)) > 0
    assert model.bounds_m()[0, 2] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("maker", MAKERS)
def test_equal_generators_make_equal_models_and_others_differ(maker):
    first, same, other = (sha256_of(model_mesh(maker(np.random.default_rng(seed)))) for seed in (3, 3, 4))
    assert first == same != other


def test_primitives_have_the_volume_of_their_formulas():
    box = rounded_box((0.3, 0.2, 0.1), GREY, radius_m=0.001)
    assert volume_m3(as_mesh(box)) == pytest.approx(0.3 * 0.2 * 0.1, rel=0.01)
    cylinder = lathe([(0, 0), (0.1, 0), (0.1, 0.5), (0, 0.5)], GREY, segments=64)
    assert volume_m3(as_mesh(cylinder)) == pytest.approx(np.pi * 0.1**2 * 0.5, rel=0.01)
    bar = tube([(0, 0, 0), (0.5, 0, 0), (1, 0, 0)], 0.05, GREY, segments=64)
    assert volume_m3(as_mesh(bar)) == pytest.approx(np.pi * 0.05**2, rel=0.01)
    ball = ellipsoid((0.1, 0.2, 0.3), GREY)
    assert volume_m3(as_mesh(ball)) == pytest.approx(4 / 3 * np.pi * 0.1 * 0.2 * 0.3, rel=0.1)


@settings(max_examples=6)
@given(st.integers(0, 10_000))
def test_no_two_objects_of_a_room_cut_into_one_another(seed):
    boxes = [part_boxes(item.model, item.world_from_object) for item in furnished_room(seed).objects]
    for i, one in enumerate(boxes):
        for other in boxes[:i]:
            assert shared_volume_m3(one, other) == 0.0


@settings(max_examples=6)
@given(st.integers(0, 10_000))
def test_a_room_has_objects_of_enough_kinds_and_none_floats(seed):
    world = furnished_room(seed)
    assert [item.id for item in world.objects] == list(range(1, len(world.objects) + 1))
    assert 17 <= len(world.objects) <= 22
    assert len({item.model.kind for item in world.objects}) >= 9
    supports = [0.0] + [
        item.world_from_object[2, 3] + surface.center_m[2] for item in world.objects for surface in item.model.surfaces
    ]
    for item in world.objects:
        base = item.world_from_object[2, 3] + item.model.bounds_m()[0, 2]
        assert min(abs(base - support) for support in supports) < 0.001


def test_objects_are_inside_the_walls():
    world = furnished_room(11)
    x0, y0, x1, y1 = world.interior_m
    for item in world.objects:
        vertices = np.concatenate([part.vertices for part in item.model.parts])
        points = vertices @ item.world_from_object[:3, :3].T + item.world_from_object[:3, 3]
        assert (points[:, :2] > (x0, y0)).all()
        assert (points[:, :2] < (x1, y1)).all()


def test_stripes_change_colour_at_half_their_period():
    texture = Texture(pattern="stripes", first=(1, 0, 0), second=(0, 0, 1), period_m=0.2, axis=0, grain=0.0)
    points = np.array([[0.05, 0.0, 0.0], [0.05, 0.3, 0.7], [0.15, 0.0, 0.0], [0.25, 0.0, 0.0]])
    # The first half of a period shows the second colour.
    assert colors_at(texture, points).tolist() == [[0, 0, 255], [0, 0, 255], [255, 0, 0], [0, 0, 255]]


@pytest.fixture(scope="module", params=[0, 1, 2])
def walk(request):
    world = furnished_room(request.param)
    return world, walk_round(world, 20.0, WalkConfig(clearance_m=0.25), np.random.default_rng(request.param))


def test_the_walk_keeps_its_speed_and_turns_slowly(walk):
    _, trajectory = walk
    step_s = np.diff(trajectory.times_s)
    poses = trajectory.world_from_camera
    speed = np.linalg.norm(np.diff(poses[:, :2, 3], axis=0), axis=1) / step_s
    assert speed.min() > 0.4
    assert speed.max() < 0.6
    cosine = (np.einsum("nij,nij->n", poses[1:, :3, :3], poses[:-1, :3, :3]) - 1) / 2
    assert (np.degrees(np.arccos(np.clip(cosine, -1, 1))) / step_s).max() < 45


def test_the_camera_stays_at_eye_height_and_clear_of_every_part(walk):
    world, trajectory = walk
    eyes = trajectory.world_from_camera[:, :3, 3]
    assert eyes[:, 2].min() > 1.2
    assert eyes[:, 2].max() < 1.5
    for item in world.objects:
        for box in part_boxes(item.model, item.world_from_object):
            level = np.column_stack([eyes[:, :2], np.full(len(eyes), box.center[2])])
            assert not box.contains(level, margin_m=0.15).any()


def test_every_pose_is_rigid_and_looks_slightly_down(walk):
    _, trajectory = walk
    for world_from_camera in trajectory.world_from_camera[::50]:
        assert is_rigid(world_from_camera)
        assert -0.6 < world_from_camera[2, 2] < 0.0
        assert world_from_camera[2, 1] < -0.8


def test_a_room_without_enough_clearance_has_no_walk():
    answer = walk_round(furnished_room(0), 5.0, WalkConfig(clearance_m=5.0), np.random.default_rng(0))
    assert 0.0 <= answer.clearance_m < 5.0


def test_a_level_camera_of_yaw_zero_looks_along_x_with_y_down():
    expected = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    assert camera_rotation(0.0, 0.0, 0.0) == pytest.approx(expected)
