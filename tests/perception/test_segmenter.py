from dataclasses import replace
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import label
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.voxels import contains, keys_of_points
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.perception.fragments.over_segmentation import _label_level
from hickory_stream.perception.masks import enlarged, enlarged_mask
from hickory_stream.perception.perceive import PerceptionConfig
from hickory_stream.perception.space import SpaceConfig, observe_space
from hickory_stream.records import MapPrior, ObservedSpace
from tests.perception.perception_scenes import CAMERA, Block, Cylinder, best_iou, floor, looking, render
from tests.strategies import seeds

VIEW = looking((0.0, 0.0, 0.3), start=(-2.2, -0.3, 1.5))
RED, BLUE, GREEN, WOOD, WHITE = (190, 40, 40), (40, 60, 190), (40, 150, 60), (170, 130, 80), (225, 225, 220)


def segment(frame, prior=None):
    return make_segmenter(PerceptionConfig()).segment(frame, prior)


def block(x0, y0, x1, y1, top, color, foot=0.0):
    return Block(low=(x0, y0, foot), high=(x1, y1, top), color=color)


PILLAR = block(-0.3, -0.08, -0.1, 0.08, 0.9, RED)
TABLE = [
    block(-0.4, -0.6, 0.4, 0.6, 0.73, WOOD, foot=0.69),
    *(block(x - 0.03, y - 0.03, x + 0.03, y + 0.03, 0.69, WOOD) for x in (-0.35, 0.35) for y in (-0.55, 0.55)),
]
CHAIR = [
    block(-0.2, -0.2, 0.2, 0.2, 0.46, GREEN, foot=0.42),
    *(
        block(x - 0.018, y - 0.018, x + 0.018, y + 0.018, top, WOOD)
        for x, top in ((-0.182, 0.43), (0.182, 0.88))
        for y in (-0.182, 0.182)
    ),
    *(block(0.172, -0.18, 0.192, 0.18, z + 0.06, WOOD, foot=z) for z in (0.58, 0.7, 0.82)),
]
BOX = block(-0.15, 0.15, 0.15, 0.45, 0.35, RED)
# The parts of each thing, the least IoU of its mask, and where one looks from.
SCENES = {
    "two boxes": ([[BOX], [block(-0.15, -0.45, 0.15, -0.15, 0.35, BLUE)]], [0.8, 0.8], VIEW),
    "two alike": ([[BOX], [block(-0.15, -0.45, 0.15, -0.15, 0.35, RED)]], [0.8, 0.8], VIEW),
    "one before a larger one of its colour": (
        [[block(0.1, -0.3, 0.5, 0.3, 0.5, WOOD)], [block(-0.35, -0.15, -0.05, 0.15, 0.25, WOOD)]], [0.7, 0.7], VIEW
    ),
    "a mug and its table": (
        [[Cylinder(foot=(-0.1, 0.1, 0.73), radius=0.045, height=0.1, color=WHITE)], TABLE], [0.7, 0.8],
        looking((0.0, 0.0, 0.6), start=(-1.6, -0.2, 1.5)),
    ),
    "a chair of two colours": ([CHAIR], [0.6], looking((0.0, 0.0, 0.4), start=(-1.8, -0.7, 1.4))),
    "the chair from its other side": ([CHAIR], [0.6], looking((0.0, 0.0, 0.4), start=(1.8, -0.7, 1.4))),
    "one behind a pillar": ([[block(0.2, -0.4, 0.5, 0.4, 0.3, BLUE)], [PILLAR]], [0.8, 0.0], VIEW),
    "two of other depths behind a pillar": (
        [[block(0.2, 0.0, 0.5, 0.4, 0.3, BLUE)], [block(0.6, -0.5, 0.9, 0.0, 0.38, BLUE)], [PILLAR]], [0, 0, 0], VIEW
    ),
    "one on another of its colour": (
        [[block(-0.25, -0.25, 0.25, 0.25, 0.08, WOOD)], [block(-0.06, -0.08, 0.06, 0.08, 0.3, WOOD, foot=0.08)]],
        [0.7, 0.7], looking((0.0, 0.0, 0.1), start=(-0.9, -0.3, 0.8)),
    ),
}  # fmt: skip


@pytest.mark.parametrize("scene", SCENES)
def test_each_thing_of_a_scene_is_an_instance_of_its_own(scene):
    things, least, view = SCENES[scene]
    frame, shown = render([floor(), *(part for parts in things for part in parts)], view)
    owners = np.repeat(np.arange(len(things)), [len(parts) for parts in things])
    instances = segment(frame).instances
    found = [best_iou(instances, (shown > 0) & (owners[shown - 1] == i)) for i in range(len(things))]
    assert all(iou > bound for (iou, _), bound in zip(found, least, strict=True))
    assert len({label for _, label in found}) == len(things)


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
    result = segment(replace(frame, depth_m=np.full_like(frame.depth_m, np.nan)))
    assert result.instances.max() == 0
    assert not result.structure.any()
    assert result.floor_z_m is None


def test_an_image_of_one_pixel_is_segmented():
    one = Camera(width=1, height=1, fx=1.0, fy=1.0, cx=0.0, cy=0.0)
    result = segment(render([floor()], VIEW, one)[0])
    assert result.instances.shape == (1, 1)
    assert result.instances.max() == 0


@given(st.integers(1, 4), st.integers(0, 3), st.integers(0, 3), st.integers(0, 2**32 - 1))
def test_what_is_enlarged_repeats_pixels_and_is_nothing_beyond(factor, more_x, more_y, seed):
    labels = np.random.default_rng(seed).integers(0, 3, (4, 5)).astype(np.int32)
    size = (5 * factor + min(more_x, factor - 1), 4 * factor + min(more_y, factor - 1))
    expected = np.zeros((size[1], size[0]), dtype=np.int32)
    expected[: 4 * factor, : 5 * factor] = labels.repeat(factor, axis=0).repeat(factor, axis=1)
    assert np.array_equal(enlarged(labels, factor, size), expected)
    assert np.array_equal(enlarged_mask(labels == 1, factor, size), expected == 1)


@given(seeds)
def test_large_unlabelled_regions_of_a_level_get_its_label(seed):
    rng = np.random.default_rng(seed)
    shape = (14, 19)
    points, normals = np.zeros((2, *shape, 3), dtype=np.float32)
    points[..., 2] = np.where(rng.random(shape) < 0.6, 0.5, 0.6)
    normals[..., 2] = np.where(rng.random(shape) < 0.9, 1.0, np.nan)
    slack = np.full(shape, 0.02, dtype=np.float32)
    labels = np.where(rng.random(shape) < 0.1, 7, 0).astype(np.int32)
    regions, _ = label((points[..., 2] < 0.55) & (normals[..., 2] > 0.85))
    is_large = np.bincount(regions.ravel()) >= 5
    is_large[0] = False
    expected = np.where(is_large[regions] & (labels == 0), 2, labels)
    _label_level(points, normals, slack, 0.5, 5, 2, labels)
    assert np.array_equal(labels, expected)
