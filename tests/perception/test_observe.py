from dataclasses import replace
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.box_scene import SceneBox, cast_scene
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.lattice import STEPS_PER_M, Lattice, packed_points
from hickory_stream.geometry.voxels import centers_of_keys, contains, keys_of_cells, keys_of_points
from hickory_stream.perception.observe import mask_area_of, observe, voxel_means
from hickory_stream.perception.space import SpaceConfig, _free_keys, observe_space
from hickory_stream.records import Frame, Segmentation
from hickory_stream.worlds.depth_camera import DepthCameraConfig, sensed_depth
from tests.perception.perception_scenes import CAMERA, Block, floor, looking, render
from tests.strategies import seeds

VIEW = looking((0.0, 0.0, 0.3), start=(-2.2, -0.3, 1.5))
BOX = Block(low=(-0.2, -0.2, 0.0), high=(0.2, 0.2, 0.4), color=(190, 40, 40))


def observed(frame, mask):
    """The observations, and the rejected masks, of a frame whose segmenter finds one mask."""
    segmentation = Segmentation(instances=mask.astype(np.int32), structure=~mask, floor_z_m=0.0)
    return observe(frame, segmentation, Lattice())


def space_of(frame, shown):
    segmentation = Segmentation(instances=(shown == 1).astype(np.int32), structure=shown == 0, floor_z_m=0.0)
    return observe_space(frame, segmentation, SpaceConfig(), Lattice())


def distance_to_box(points, block):
    outside = np.maximum(np.array(block.low) - points, points - np.array(block.high)).max(axis=1)
    return np.abs(outside)


def test_lifted_points_lie_on_the_true_surface():
    frame, shown = render([floor(), BOX], VIEW)
    observations, rejected = observed(frame, shown == 1)
    assert rejected == ()
    # A voxel's mean at an edge lies inside by at most a voxel.
    assert distance_to_box(observations[0].points_world, BOX).max() < 0.01
    assert (observations[0].colors == BOX.color).all()


def test_of_a_wide_image_every_second_pixel_is_lifted():
    frame, shown = render([floor(), BOX], VIEW)
    found = []
    for times in (2, 4):  # 640 and 1280 columns
        rgb, depth, mask = (i.repeat(times, 0).repeat(times, 1) for i in (frame.rgb, frame.depth_m, shown == 1))
        camera = Camera(**{name: times * getattr(CAMERA, name) for name in CAMERA.__slots__})
        found += observed(replace(frame, rgb=rgb, depth_m=depth, camera=camera), mask)[0]
    narrow, wide = found
    assert (wide.mask.sum(), wide.drawn) == (4 * narrow.mask.sum(), narrow.drawn)
    np.testing.assert_array_equal(wide.points_world, narrow.points_world)
    np.testing.assert_array_equal(wide.colors, narrow.colors)


def test_the_factors_of_a_view_are_shares_of_image_and_mask():
    frame, shown = render([floor(), BOX], VIEW)
    depth = frame.depth_m.copy()
    lost = (shown == 1) & (np.arange(CAMERA.width) % 4 == 0)
    depth[lost] = np.nan
    observation = observed(replace(frame, depth_m=depth), shown == 1)[0][0]
    pixels = int((shown == 1).sum())
    assert observation.r_area == pixels / (CAMERA.width * CAMERA.height)
    assert observation.r_depth == pytest.approx(1 - lost.sum() / pixels)
    assert mask_area_of(CAMERA) == 320 * 240


@pytest.mark.parametrize(("color", "drawn"), [((190, 40, 40), 1.0), ((118, 112, 100), 0.1)])
def test_an_outline_is_drawn_by_returns_or_colour(color, drawn):
    box = Block(low=BOX.low, high=BOX.high, color=color)
    frame, shown = render([floor(), box], VIEW)
    seen = observed(frame, shown == 1)[0][0]
    alone = replace(frame, depth_m=np.where(shown == 1, frame.depth_m, np.float32(np.nan)))
    lost = observed(alone, shown == 1)[0][0]
    assert seen.drawn == 1.0
    assert lost.drawn == pytest.approx(drawn, abs=0.1)


def test_only_what_touches_the_border_is_cut():
    inside = render([floor(), BOX], VIEW)
    outside = render([floor(), BOX], looking((0.0, 1.35, 0.3), start=(-2.2, -0.3, 1.5)))
    assert (outside[1][:, [0, -1]] == 1).any()
    cut = [observed(frame, shown == 1)[0][0].is_cut for frame, shown in (inside, outside)]
    assert cut == [False, True]


def test_a_thin_leg_is_lifted_with_the_top_it_carries():
    top = Block(low=(-0.2, -0.2, 0.4), high=(0.2, 0.2, 0.5), color=(1, 2, 3))
    leg = Block(low=(-0.19, -0.01, 0.0), high=(-0.17, 0.01, 0.4), color=(1, 2, 3))
    fine = Camera(width=640, height=480, fx=580.0, fy=580.0, cx=319.5, cy=239.5)
    frame, shown = render([floor(), top, leg], VIEW, fine)
    box = observed(frame, shown >= 1)[0][0].box
    assert box.center[2] - box.half_extents_m[2] < 0.05


def test_a_mask_without_depth_is_rejected_with_its_reason():
    frame, shown = render([floor(), BOX], VIEW)
    depth = np.where(shown == 1, np.nan, frame.depth_m).astype(np.float32)
    observations, rejected = observed(replace(frame, depth_m=depth), shown == 1)
    assert observations == ()
    assert [r.reason for r in rejected] == ["no reliable depth in the mask"]


def test_an_image_without_depth_says_nothing_of_space():
    frame, shown = render([floor()], VIEW)
    space = space_of(replace(frame, depth_m=np.full_like(frame.depth_m, np.nan)), shown)
    assert len(space.free_keys) == len(space.structure_keys) == 0


@given(height=st.floats(0.8, 2.0), aim=st.floats(-0.5, 0.5))
def test_free_voxels_hold_no_return_and_structure_is_the_floor(height, aim):
    frame, shown = render([floor(), BOX], looking((0.0, aim, 0.2), start=(-2.0, 0.0, height)))
    lattice = Lattice()
    space = space_of(frame, shown)
    u, v = np.meshgrid(np.arange(0, CAMERA.width, 3), np.arange(0, CAMERA.height, 3))
    z = frame.depth_m[::3, ::3].astype(np.float64)
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], axis=-1)
    world = (rays * z[..., None])[z < 5.0] @ frame.world_from_camera[:3, :3].T + frame.world_from_camera[:3, 3]
    assert not contains(space.free_keys, keys_of_points(world, lattice.space_m)).any()
    assert (np.diff(space.free_keys) > 0).all()
    assert (np.diff(space.structure_keys) > 0).all()
    assert (np.diff(space.surface_keys) > 0).all()
    assert not contains(space.structure_keys, space.surface_keys).any()
    heights = centers_of_keys(space.structure_keys, lattice.space_m)[:, 2]
    assert len(heights) > 50
    assert np.abs(heights).max() < lattice.space_m


@given(st.integers(0, 2**32 - 1), st.integers(1, 200))
def test_a_voxels_mean_is_that_of_its_points_in_key_order(seed, count):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.03, 0.03, (count, 3)).astype(np.float32)
    colors = rng.integers(0, 256, (count, 3)).astype(np.uint8)
    means, shades, counts = voxel_means(points, colors, 0.01)
    keys = keys_of_points(points, 0.01)
    for i, key in enumerate(np.unique(keys)):
        own = keys == key
        assert counts[i] == own.sum()
        assert np.allclose(means[i], points[own].mean(axis=0), atol=0.5 / STEPS_PER_M + 1e-7)
        assert np.array_equal(shades[i], np.rint(colors[own].mean(axis=0)))
    assert len(means) == len(np.unique(keys))
    assert packed_points(means) is not None


ZED = Camera(width=640, height=480, fx=350.0, fy=350.0, cx=319.5, cy=239.5)


def can_at(distance_m):
    """Return a frame of a can of 10 x 10 x 14 cm so far away, as a stereo camera sees it, and where it shows."""
    can = SceneBox(low=(distance_m, -0.05, 0.93), high=(distance_m + 0.1, 0.05, 1.07), rgb=(160, 40, 40))
    wall = SceneBox(low=(distance_m + 0.8, -5.0, 0.0), high=(distance_m + 1.0, 5.0, 4.0), rgb=(220, 220, 210))
    pose = np.eye(4)
    pose[:3, :3] = [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    pose[2, 3] = 1.0
    rgb, depth_m, shown = cast_scene([can, wall], ZED, pose)
    config = DepthCameraConfig(dropout_share=0.0)
    noisy = sensed_depth(depth_m, np.ones_like(depth_m), ZED.fx, config, np.random.default_rng(3))
    return Frame(index=0, stamp_ns=0, rgb=rgb, depth_m=noisy, camera=ZED, world_from_camera=pose), shown == 1


@pytest.mark.parametrize("distance_m", [1.0, 2.0, 3.0, 4.0])
def test_a_can_has_its_true_size_at_any_distance(distance_m):
    frame, mask = can_at(distance_m)
    observations, rejected = observed(frame, mask)
    assert rejected == ()
    size = np.ptp(observations[0].points_world, axis=0)
    # To a pixel on each side and two voxels; edges of stereo images are lost.
    slack_m = 2 * distance_m / ZED.fx + 0.02
    assert size[1:] == pytest.approx([0.10, 0.14], abs=slack_m)


def test_the_rim_of_a_mask_that_shows_the_wall_is_left_out():
    frame, mask = can_at(2.0)
    wide = cv2.dilate(mask.astype(np.uint8), np.ones((5, 5), np.uint8))
    points = observed(frame, wide > 0)[0][0].points_world
    assert points[:, 0].max() < 2.0 + 5 * float(frame.sensor.sigma_m(np.array([2.0], dtype=np.float32))[0])


def test_returns_of_which_no_two_agree_are_no_thing():
    frame, mask = can_at(2.0)
    depth = frame.depth_m.copy()
    depth[mask] = np.random.default_rng(0).uniform(1.0, 4.0, int(mask.sum())).astype(np.float32)
    observations, rejected = observed(replace(frame, depth_m=depth), mask)
    assert observations == ()
    assert "sure returns, fewer than 24" in rejected[0].reason


def walked(origin, ends, returns, voxel_m):
    cells = [np.empty((0, 3), dtype=np.int64)]
    for end in ends:
        ray = (end - origin) / voxel_m
        length = np.sqrt((ray**2).sum())
        steps = np.arange(1, max(int((length - 1) / 0.7), 1))
        cells.append(np.floor(origin / voxel_m + steps[:, None] * 0.7 * ray / max(length, 1e-9)).astype(np.int64))
    keys = np.unique(keys_of_cells(np.concatenate(cells)))
    return keys[~np.isin(keys, keys_of_points(returns, voxel_m))]


@given(seeds, st.integers(0, 40), st.sampled_from([0.05, 0.11]), st.sampled_from([0.3, 2.0]))
def test_free_voxels_are_those_that_a_walk_along_the_rays_meets(seed, count, voxel_m, reach_m):
    rng = np.random.default_rng(seed)
    origin = rng.uniform(-3, 3, 3)
    ends = origin + rng.uniform(-reach_m, reach_m, (count, 3))
    returns = origin + rng.uniform(-1.5 * reach_m, 1.5 * reach_m, (300, 3))
    assert np.array_equal(_free_keys(origin, ends, returns, voxel_m), walked(origin, ends, returns, voxel_m))


def test_no_ray_frees_nothing():
    assert len(_free_keys(np.zeros(3), np.empty((0, 3)), np.empty((0, 3)), 0.05)) == 0
