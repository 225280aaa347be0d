import numpy as np
import pytest
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.voxels import contains, keys_of_points
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.perception.perceive import PerceptionConfig
from hickory_stream.perception.space import SpaceConfig, observe_space
from hickory_stream.records import Frame, MapPrior, ObservedSpace
from tests.perception.perception_scenes import CAMERA, Block, Cylinder, best_iou, floor, looking, render

VIEW = looking((0.0, 0.0, 0.3), start=(-2.2, -0.3, 1.5))
RED, BLUE, GREEN, WOOD, WHITE = (190, 40, 40), (40, 60, 190), (40, 150, 60), (170, 130, 80), (225, 225, 220)


def segment(frame, prior=None):
    return make_segmenter(PerceptionConfig()).segment(frame, prior)


def test_a_box_on_a_floor_is_one_instance():
    frame, shown = render([floor(), Block(low=(-0.2, -0.2, 0.0), high=(0.2, 0.2, 0.4), color=RED)], VIEW)
    result = segment(frame)
    assert best_iou(result.instances, shown == 1)[0] > 0.85
    assert result.instances.max() == 1
    assert result.structure[(shown == 0) & (frame.depth_m < 5.5)].mean() > 0.95
    assert result.floor_z_m == pytest.approx(0.0, abs=0.01)


def test_known_structure_is_structure_and_no_new_evidence():
    frame, shown = render([floor(), Block(low=(-0.2, -0.2, 0.0), high=(0.2, 0.2, 0.4), color=RED)], VIEW)
    v, u = np.argwhere(shown == 1).T
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(len(u))], axis=1)
    points = apply(frame.world_from_camera, rays * frame.depth_m[v, u][:, None].astype(np.float64))
    keys = np.unique(keys_of_points(points, 0.05))
    space = ObservedSpace(voxel_m=0.05, free=keys[:0], structure=keys, floor_z_m=0.0)
    prior = MapPrior(space=space, objects=(), points_m=0.02)
    result = segment(frame, prior)
    assert result.structure[shown == 1].mean() > 0.9
    assert result.structure_shown[shown == 1].mean() < 0.1
    space = observe_space(frame, result, SpaceConfig(), Lattice())
    assert contains(space.structure_keys, keys).mean() < 0.3
    assert contains(space.surface_keys, keys).mean() > 0.2


@pytest.mark.parametrize("color", [BLUE, RED], ids=["unlike", "alike"])
def test_two_boxes_apart_on_a_floor_are_two_instances(color):
    left = Block(low=(-0.15, 0.15, 0.0), high=(0.15, 0.45, 0.35), color=RED)
    right = Block(low=(-0.15, -0.45, 0.0), high=(0.15, -0.15, 0.35), color=color)
    frame, shown = render([floor(), left, right], VIEW)
    instances = segment(frame).instances
    (iou_left, label_left), (iou_right, label_right) = (best_iou(instances, shown == i) for i in (1, 2))
    assert min(iou_left, iou_right) > 0.8
    assert label_left != label_right


def test_a_box_before_a_larger_one_of_its_colour_stays_its_own():
    back = Block(low=(0.1, -0.3, 0.0), high=(0.5, 0.3, 0.5), color=WOOD)
    front = Block(low=(-0.35, -0.15, 0.0), high=(-0.05, 0.15, 0.25), color=WOOD)
    frame, shown = render([floor(), back, front], VIEW)
    instances = segment(frame).instances
    (iou_back, label_back), (iou_front, label_front) = (best_iou(instances, shown == i) for i in (1, 2))
    assert min(iou_back, iou_front) > 0.7
    assert label_back != label_front


def test_a_mug_on_a_table_and_the_table_are_two_instances():
    table = Block(low=(-0.4, -0.6, 0.69), high=(0.4, 0.6, 0.73), color=WOOD)
    legs = [
        Block(low=(x - 0.03, y - 0.03, 0.0), high=(x + 0.03, y + 0.03, 0.69), color=WOOD)
        for x in (-0.35, 0.35)
        for y in (-0.55, 0.55)
    ]
    mug = Cylinder(foot=(-0.1, 0.1, 0.73), radius=0.045, height=0.1, color=WHITE)
    frame, shown = render([floor(), mug, table, *legs], looking((0.0, 0.0, 0.6), start=(-1.6, -0.2, 1.5)))
    instances = segment(frame).instances
    (iou_mug, label_mug), (iou_table, label_table) = (best_iou(instances, m) for m in (shown == 1, shown >= 2))
    assert iou_mug > 0.7
    assert iou_table > 0.8
    assert label_mug != label_table


def test_a_chair_of_two_colours_is_one_instance():
    seat = Block(low=(-0.2, -0.2, 0.42), high=(0.2, 0.2, 0.46), color=GREEN)
    posts = [
        Block(low=(x - 0.018, y - 0.018, 0.0), high=(x + 0.018, y + 0.018, top), color=WOOD)
        for x, top in ((-0.182, 0.43), (0.182, 0.88))
        for y in (-0.182, 0.182)
    ]
    slats = [Block(low=(0.172, -0.18, z), high=(0.192, 0.18, z + 0.06), color=WOOD) for z in (0.58, 0.7, 0.82)]
    for start in ((-1.8, -0.7, 1.4), (1.8, -0.7, 1.4)):
        frame, shown = render([floor(), seat, *posts, *slats], looking((0.0, 0.0, 0.4), start=start))
        assert best_iou(segment(frame).instances, shown >= 1)[0] > 0.6


def test_a_shade_over_a_pole_is_one_lamp():
    pole = Cylinder(foot=(0.0, 0.0, 0.0), radius=0.02, height=1.2, color=(90, 90, 95))
    shade = Cylinder(foot=(0.0, 0.0, 1.12), radius=0.16, height=0.25, color=(215, 205, 185))
    wall = Block(low=(1.0, -20.0, 0.0), high=(1.2, 20.0, 5.0), color=WHITE)
    frame, shown = render([floor(), pole, shade, wall], looking((0.0, 0.0, 0.7), start=(-2.2, 0.0, 1.2)))
    instances = segment(frame).instances
    label = best_iou(instances, shown == 2)[1]
    assert label > 0
    assert (instances[shown == 1] == label).mean() > 0.5


def test_leaves_in_the_air_join_into_one_plant():
    rng = np.random.default_rng(5)
    leaves = [
        Block(low=tuple(c - 0.03), high=tuple(c + 0.03), color=GREEN)
        for c in rng.uniform((-0.12, -0.12, 0.42), (0.12, 0.12, 0.6), (12, 3))
    ]
    pot = Cylinder(foot=(0.0, 0.0, 0.0), radius=0.12, height=0.3, color=RED)
    frame, shown = render([floor(), pot, *leaves], VIEW)
    instances = segment(frame).instances
    label = best_iou(instances, shown >= 2)[1]
    assert label > 0
    assert (instances[shown >= 2] == label).mean() > 0.8


def test_a_wall_and_a_floor_are_structure_and_no_instance():
    wall = Block(low=(1.0, -20.0, 0.0), high=(1.2, 20.0, 5.0), color=WHITE)
    frame, shown = render([floor(), wall], VIEW)
    result = segment(frame)
    assert result.instances.max() == 0
    assert result.structure[(shown >= 0) & (frame.depth_m < 5.5)].mean() > 0.95


def test_no_pixel_is_structure_and_instance_and_labels_are_dense():
    things = [
        floor(),
        *(Cylinder(foot=(0.3 * i, 0.4 * i, 0.0), radius=0.1, height=0.3, color=BLUE) for i in (-1, 0, 1)),
    ]
    result = segment(render(things, VIEW)[0])
    assert not (result.structure & (result.instances > 0)).any()
    assert set(np.unique(result.instances)) == set(range(int(result.instances.max()) + 1))


def test_the_same_frame_gives_the_same_labels():
    frame, _ = render([floor(), Block(low=(-0.2, -0.2, 0.0), high=(0.2, 0.2, 0.4), color=RED)], VIEW)
    first, second = segment(frame), segment(frame)
    assert first.instances.tobytes() == second.instances.tobytes()
    assert first.structure.tobytes() == second.structure.tobytes()


def test_a_frame_without_depth_has_no_instances_and_no_floor():
    frame, _ = render([floor()], VIEW)
    blind = Frame(
        index=0, stamp_ns=0, rgb=frame.rgb, depth_m=np.full_like(frame.depth_m, np.nan), camera=CAMERA,
        world_from_camera=VIEW,
    )  # fmt: skip
    result = segment(blind)
    assert result.instances.max() == 0
    assert not result.structure.any()
    assert result.floor_z_m is None


def test_an_image_of_one_pixel_is_segmented():
    one = Camera(width=1, height=1, fx=1.0, fy=1.0, cx=0.0, cy=0.0)
    result = segment(render([floor()], VIEW, one)[0])
    assert result.instances.shape == (1, 1)
    assert result.instances.max() == 0


def test_a_box_behind_a_pillar_is_one_instance():
    box = Block(low=(0.2, -0.4, 0.0), high=(0.5, 0.4, 0.3), color=BLUE)
    pillar = Block(low=(-0.3, -0.08, 0.0), high=(-0.1, 0.08, 0.9), color=RED)
    frame, shown = render([floor(), box, pillar], VIEW)
    instances = segment(frame).instances
    iou, label = best_iou(instances, shown == 1)
    assert iou > 0.8
    assert best_iou(instances, shown == 2)[1] != label


def test_boxes_of_two_depths_behind_a_pillar_are_two_instances():
    left = Block(low=(0.2, 0.0, 0.0), high=(0.5, 0.4, 0.3), color=BLUE)
    right = Block(low=(0.6, -0.5, 0.0), high=(0.9, 0.0, 0.38), color=BLUE)
    pillar = Block(low=(-0.3, -0.08, 0.0), high=(-0.1, 0.08, 0.9), color=RED)
    frame, shown = render([floor(), left, right, pillar], VIEW)
    instances = segment(frame).instances
    (_, label_left), (_, label_right) = (best_iou(instances, shown == i) for i in (1, 2))
    assert label_left != label_right
    assert min(label_left, label_right) > 0


def test_a_box_put_on_a_box_of_its_colour_is_another_one():
    lower = Block(low=(-0.25, -0.25, 0.0), high=(0.25, 0.25, 0.08), color=WOOD)
    upper = Block(low=(-0.06, -0.08, 0.08), high=(0.06, 0.08, 0.3), color=WOOD)
    frame, shown = render([floor(), lower, upper], looking((0.0, 0.0, 0.1), start=(-0.9, -0.3, 0.8)))
    instances = segment(frame).instances
    (iou_lower, label_lower), (iou_upper, label_upper) = (best_iou(instances, shown == i) for i in (1, 2))
    assert min(iou_lower, iou_upper) > 0.7
    assert label_lower != label_upper
