import numpy as np
import pytest
from hypothesis import given
from hickory_stream.geometry.camera import Camera
from hickory_stream.perception.coarse import cells_of, coarse_frame, enlarged_cells
from hickory_stream.perception.structure.detection import (
    HorizontalPlane,
    StructureConfig,
    floor_height_m,
    horizontal_planes,
    pixel_areas_m2,
)
from hickory_stream.perception.surface import SurfaceConfig, _reduce_depth, _without_flying_pixels, surface_of
from tests.perception.perception_scenes import CAMERA, Block, Cylinder, floor, looking, render
from tests.strategies import seeds

VIEW = looking((0.0, 0.0, 0.3), start=(-2.2, -0.3, 1.5))
BOX = Block(low=(-0.3, -0.3, 0.0), high=(0.3, 0.3, 0.5), color=(190, 40, 40))


def interior(mask, margin=5):
    inside = mask.copy()
    for axis in (0, 1):
        for step in range(-margin, margin + 1):
            inside &= np.roll(mask, step, axis=axis)
    return inside


def test_normals_of_a_box_and_a_floor_are_those_of_their_faces():
    frame, shown = render([floor(), BOX], VIEW)
    surface = surface_of(frame, SurfaceConfig(width_px=CAMERA.width))
    z = surface.points_world[..., 2]
    faces = {
        (0.0, 0.0, 1.0): (shown == 0) & (frame.depth_m < 4.0) | (shown == 1) & (z > 0.499),
        (-1.0, 0.0, 0.0): (shown == 1) & (surface.points_world[..., 0] < -0.299),
    }
    for normal, mask in faces.items():
        at = interior(mask)
        assert at.sum() > 200
        assert np.quantile(surface.normals_world[at] @ np.array(normal), 0.01) > np.cos(np.radians(2.0))


def test_points_lie_on_the_true_surface_at_any_working_size():
    frame, _ = render([floor()], VIEW)
    for width in (320, 160):
        surface = surface_of(frame, SurfaceConfig(width_px=width))
        valid = np.isfinite(surface.depth_m) & (surface.depth_m < 3.0)
        assert np.abs(surface.points_world[valid][:, 2]).max() < 0.03


def test_a_flying_pixel_goes_and_a_pole_of_two_pixels_stays():
    pole = Cylinder(foot=(0.0, 0.0, 0.0), radius=0.008, height=1.0, color=(90, 90, 90))
    frame, shown = render([floor(), pole], VIEW)
    depth = frame.depth_m.copy()
    depth[200, 40] *= 0.8
    cleaned = surface_of(
        type(frame)(index=0, stamp_ns=0, rgb=frame.rgb, depth_m=depth, camera=CAMERA, world_from_camera=VIEW),
        SurfaceConfig(width_px=CAMERA.width),
    )
    assert np.isnan(cleaned.depth_m[200, 40])
    assert np.isfinite(cleaned.depth_m[shown == 1]).mean() > 0.9


def test_planes_are_found_with_their_heights_and_areas():
    frame, _ = render([floor(), BOX], VIEW)
    surface = surface_of(frame, SurfaceConfig(width_px=CAMERA.width))
    planes = horizontal_planes(surface, pixel_areas_m2(surface), min_area_m2=0.05)
    assert [plane.z_m for plane in planes] == pytest.approx([0.0, 0.5], abs=0.01)
    assert planes[1].area_m2 == pytest.approx(0.36, rel=0.15)


def test_a_known_floor_is_replaced_by_a_lower_one_only():
    frame, _ = render([floor()], VIEW)
    surface = surface_of(frame, SurfaceConfig())
    planes = horizontal_planes(surface, pixel_areas_m2(surface), min_area_m2=0.05)
    heights = [floor_height_m(surface, planes, known, StructureConfig()) for known in (None, -0.7, 0.4)]
    assert heights == pytest.approx([0.0, -0.7, 0.0], abs=0.01)


def test_a_flank_of_the_floor_below_it_is_not_the_floor():
    frame, _ = render([floor(), BOX], VIEW)
    surface = surface_of(frame, SurfaceConfig(width_px=CAMERA.width))
    planes = [HorizontalPlane(z_m=z_m, area_m2=m2) for z_m, m2 in ((-0.04, 0.3), (0.0, 4.5), (0.5, 9.0))]
    heights = [floor_height_m(surface, planes, known, StructureConfig()) for known in (None, -0.04, 0.0)]
    assert heights == [0.0, 0.0, 0.0]


def test_another_storey_has_its_own_floor():
    table = Block(low=(-0.5, -0.5, 0.0), high=(0.5, 0.5, 0.7), color=(120, 60, 50))
    frame, _ = render([floor(), table], VIEW)
    surface = surface_of(frame, SurfaceConfig(width_px=CAMERA.width))
    planes = horizontal_planes(surface, pixel_areas_m2(surface), min_area_m2=0.05)
    eye_m = float(surface.world_from_camera[2, 3])
    assert floor_height_m(surface, planes, eye_m - 4.0, StructureConfig()) == pytest.approx(0.0, abs=0.01)
    assert floor_height_m(surface, planes[:1], 2.6, StructureConfig()) == 2.6


@pytest.mark.parametrize("factor", [1, 2, 3, 4])
@given(seed=seeds)
def test_a_working_pixel_has_the_lower_median_of_its_block(factor, seed):
    rng = np.random.default_rng(seed)
    depth = rng.choice(np.array([np.nan, 0.1, 1.0, 2.0, 3.0, 5.9, 7.0], dtype=np.float32), (4 * factor, 5 * factor))
    for (y, x), z in np.ndenumerate(_reduce_depth(depth, factor, 4, 5)):
        block = depth[y * factor : (y + 1) * factor, x * factor : (x + 1) * factor].ravel()
        valid = np.sort(block[block > 0])
        assert np.array_equal(z, valid[(len(valid) - 1) // 2] if len(valid) else np.float32(np.nan), equal_nan=True)


@given(seed=seeds)
def test_a_pixel_stays_with_two_or_three_that_agree(seed):
    depth = np.random.default_rng(seed).choice(np.array([np.nan, 1.0, 1.5], dtype=np.float32), (6, 7))
    kept = _without_flying_pixels(depth)
    for (y, x), z in np.ndenumerate(depth):
        around = depth[max(0, y - 1) : y + 2, max(0, x - 1) : x + 2]
        others = int((around == z).sum()) - 1
        stays = others >= 3 or (others >= 2 and not (around < z).any())
        assert np.array_equal(kept[y, x], z if stays else np.float32(np.nan), equal_nan=True)


VGA = Camera(width=640, height=480, fx=500.0, fy=500.0, cx=319.5, cy=239.5)


@pytest.mark.parametrize(("width", "height", "stride"), [(640, 480, 4), (64, 48, 1), (1920, 1080, 12), (161, 3, 2)])
def test_a_pixel_amid_a_cell_is_found_to_the_millimetre(width, height, stride):
    rng = np.random.default_rng(width)
    depth = rng.uniform(0.3, 6.0, (height, width)).astype(np.float32)
    structure = rng.random((height, width)) < 0.5
    coarse = coarse_frame(depth, structure, VGA)
    assert coarse.stride_px == stride
    rows, columns = (np.arange(min(stride // 2, size - 1), size, stride) for size in (height, width))
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    depth_m, is_structure = cells_of(coarse, pixels)
    np.testing.assert_allclose(depth_m, depth[pixels[:, 1], pixels[:, 0]], atol=0.00051)
    np.testing.assert_array_equal(is_structure, structure[pixels[:, 1], pixels[:, 0]])


def test_what_is_no_return_or_too_far_to_tell_is_none():
    depth = np.array([[np.nan, np.inf, -1.0, 70.0, 65.0]], dtype=np.float32)
    depth_m, _ = cells_of(coarse_frame(depth, np.zeros((1, 5), bool), VGA), np.array([[i, 0] for i in range(5)]))
    np.testing.assert_array_equal(depth_m, [np.nan, np.nan, np.nan, np.nan, 65.0])


def test_cells_are_enlarged_to_the_frame_that_they_are_of():
    structure = np.random.default_rng(0).random((7, 323)) < 0.5
    coarse = coarse_frame(np.ones(structure.shape, np.float32), structure, VGA)
    large = enlarged_cells(coarse.structure, coarse.stride_px, (323, 7))
    assert large.shape == structure.shape
    pixels = np.stack(np.meshgrid(np.arange(323), np.arange(7)), axis=-1).reshape(-1, 2)
    np.testing.assert_array_equal(large.ravel(), cells_of(coarse, pixels)[1])
