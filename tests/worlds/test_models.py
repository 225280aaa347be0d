import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hickory_stream.geometry.mesh import is_closed, sha256_of, volume_m3
from hickory_stream.worlds import furniture, small_things
from hickory_stream.worlds.object_models import ellipsoid, lathe, model_mesh, rounded_box, tube
from hickory_stream.worlds.room import furnished_room
from hickory_stream.worlds.scene import part_boxes, shared_volume_m3
from hickory_stream.worlds.textures import Texture, colors_at
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
